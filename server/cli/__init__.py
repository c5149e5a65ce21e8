"""The command line: serve, lift, types, token, dump, load."""
