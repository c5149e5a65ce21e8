"""What is in force: documents that people keep and that this server acts on."""
