"""The HTTP server process: sockets, connection limits, TLS, signals and the lifespan."""
