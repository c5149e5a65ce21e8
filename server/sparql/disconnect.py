"""Detection of client disconnects."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import TypeAlias

from starlette.types import Receive

Disconnected: TypeAlias = Callable[[], Awaitable[None]]
"""Coroutine function that returns when the client has disconnected."""


def disconnection_of(receive: Receive) -> Disconnected:
    """Return the disconnect waiter of a request whose remaining body is not needed: it is discarded."""

    async def disconnected() -> None:
        while (await receive())["type"] != "http.disconnect":
            pass

    return disconnected
