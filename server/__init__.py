"""How the web sees a robot: the layers of the server, each of which imports only from those below it."""
