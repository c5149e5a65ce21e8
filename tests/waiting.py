"""Waiting for what no event tells of."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

PATIENCE = 60.0


def until(true: Callable[[], Any], what: str, timeout: float = PATIENCE) -> Any:
    """Wait for something about a robot; what it came to."""
    end = time.monotonic() + timeout
    while not (found := true()):
        assert time.monotonic() < end, f"never came: {what}"
        time.sleep(0.02)
    return found
