"""Identifiers that nobody guesses: of receipts, calls, goals and holds."""

from __future__ import annotations

import os
from base64 import urlsafe_b64encode
from collections import deque

_BYTES = 9
_DRAWN = 256
"""Identifiers drawn at a time: asking the system for each would take 5 % of a small write."""

_pool: deque[bytes] = deque()


def new_identifier() -> str:
    """72 random bits in 12 characters that stand in a URL as they are; in any thread."""
    try:
        bits = _pool.popleft()
    except IndexError:
        drawn = os.urandom(_BYTES * _DRAWN)
        _pool.extend(drawn[start : start + _BYTES] for start in range(_BYTES, len(drawn), _BYTES))
        bits = drawn[:_BYTES]
    return urlsafe_b64encode(bits).decode("ascii")
