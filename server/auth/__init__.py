"""Authentication and authorization: agents, their rights, and the file that declares both (WAC, RFC 6750)."""
