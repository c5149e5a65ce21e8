"""Receipts: what was asked of the server that would change something, by whom, and what became of it."""
