"""Routing of paths to resources, and of requests to their methods."""
