"""Who asks, and what they may do: agents, rights, the file that says both (Web Access Control, RFC 6750)."""
