"""Documents of clients that affect this server: limits, stored queries and mappings."""
