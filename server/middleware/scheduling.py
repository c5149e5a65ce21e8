"""Scheduling: few requests begin in one turn of the loop, so that the stop never waits for long."""

from __future__ import annotations

from starlette.responses import Response

from rosld.server.middleware.handler import Handler
from rosld.server.rest.exchange import Exchange
from rosld.server.runtime.scheduler import RequestScheduler


class Scheduling:
    """Has requests wait for their turn, all but the stop, whose path is `stop`."""

    def __init__(self, next: Handler, stop: bytes) -> None:
        self._next = next
        self._stop = stop
        self._turns = RequestScheduler()

    async def __call__(self, exchange: Exchange) -> Response:
        """Answer as the next handler does, in turn."""
        if exchange.request.scope["raw_path"] != self._stop:
            await self._turns.wait()
        return await self._next(exchange)
