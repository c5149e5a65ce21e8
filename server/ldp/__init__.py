"""Linked Data Platform: what a resource is to the web, and what the verbs do with one."""
