"""Waiting for conditions that no event reports."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import httpx

PATIENCE = 60.0


def until(true: Callable[[], Any], what: str, timeout: float = PATIENCE) -> Any:
    """Wait for a condition on a robot; return its value."""
    end = time.monotonic() + timeout
    while not (found := true()):
        assert time.monotonic() < end, f"never came: {what}"
        time.sleep(0.02)
    return found


def once_started(ask: Callable[[], httpx.Response]) -> httpx.Response:
    """Return the result of a query, repeated while the query process has not started or the robot is being read."""

    def answer() -> httpx.Response | None:
        found = ask()
        return None if found.status_code == 503 and found.json().get("reason") in ("starting", "incomplete") else found

    found: httpx.Response = until(answer, "a query that began")
    return found
