"""Receipts: each write that was requested, by whom, and its outcome."""
