"""Routing of paths to resources, and of methods to their verbs."""
