"""Scheduling: few requests begin in one iteration of the loop, so that the stop never waits for long."""

from __future__ import annotations

from collections.abc import Awaitable

from starlette.responses import Response

from rosld.server.middleware.handler import Handler
from rosld.server.rest.exchange import Exchange
from rosld.server.runtime.scheduler import RequestScheduler


class Scheduling:
    """Schedules requests, all but the stop, whose path is `stop`."""

    def __init__(self, next: Handler, stop: bytes) -> None:
        self._next = next
        self._stop = stop
        self._turns = RequestScheduler()

    def __call__(self, exchange: Exchange) -> Awaitable[Response]:
        """Answer as the next handler does, in turn."""
        if exchange.request.scope["raw_path"] == self._stop or self._turns.try_start():
            return self._next(exchange)
        return self._later(exchange)

    async def _later(self, exchange: Exchange) -> Response:
        await self._turns.wait_turn()
        return await self._next(exchange)
