"""What may be written: SHACL shapes of message types, and the reports of what was refused."""
