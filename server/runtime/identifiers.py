"""Unguessable identifiers of receipts, calls, goals and holds."""

from __future__ import annotations

import secrets


def new_identifier() -> str:
    """Return 72 random bits in 12 characters that need no escaping in a URL."""
    return secrets.token_urlsafe(9)
