"""The HTTP server process: sockets, limits of connections, TLS, signals, the lifespan."""
