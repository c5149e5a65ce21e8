"""Documents of clients that this server acts on: limits, stored queries and mappings."""
