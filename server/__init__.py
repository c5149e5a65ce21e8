"""The web server: layers, each of which imports only from those below it."""
