"""Receipts: every requested write, with its agent and its outcome."""
