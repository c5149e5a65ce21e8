"""ASGI middleware between the HTTP server and the resources: one concern a file, composed in `app.py`."""
