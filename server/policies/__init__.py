"""What is in force: limits, stored queries and mappings that people keep and this server acts on."""
