"""SHACL shapes of message types, and reports of violations."""
