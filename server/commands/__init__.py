"""What the command line does: serve, lift, types. Here are the effects: sockets, files, signals, the event loop."""
