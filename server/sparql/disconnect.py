"""Noticing that a client has hung up."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import TypeAlias

from starlette.types import Receive

Disconnected: TypeAlias = Callable[[], Awaitable[None]]
"""Returns when the client has hung up."""


def disconnection_of(receive: Receive) -> Disconnected:
    """The hang-up of a request whose body was read, or will not be: what is left of it is thrown away."""

    async def disconnected() -> None:
        while (await receive())["type"] != "http.disconnect":
            pass

    return disconnected
