"""Scheduling: few requests begin in one iteration of the loop, so that the stop never waits for long."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable

from starlette.responses import Response

from rosld.server.middleware.handler import Handler
from rosld.server.rest.exchange import Exchange

MAX_STARTS = 4
"""Requests begun in a turn. One takes about half a millisecond, so that a turn is over in a few."""


class RequestScheduler:
    """Starts the first requests of an iteration at once, and the others in the following ones, in their order.

    Belongs to one loop.
    """

    def __init__(self, limit: int = MAX_STARTS) -> None:
        self._limit = limit
        self._begun = 0
        self._waiting: deque[asyncio.Future[None]] = deque()
        self._loop: asyncio.AbstractEventLoop | None = None

    def try_start(self) -> bool:
        """Begin in this turn, unless as many have begun in it as may: then `wait` for one's turn."""
        loop = self._loop = self._loop or asyncio.get_running_loop()  # the latter is a system call before Python 3.12
        if self._begun == 0:
            loop.call_soon(self._next)
        if self._begun < self._limit and not self._waiting:
            self._begun += 1
            return True
        return False

    async def wait_turn(self) -> None:
        """Wait until it is one's turn."""
        if self.try_start():
            return
        turn = asyncio.get_running_loop().create_future()
        self._waiting.append(turn)
        await turn

    def _next(self) -> None:
        self._begun = 0
        while self._waiting and self._begun < self._limit:
            turn = self._waiting.popleft()
            if not turn.done():  # who has gone has cancelled it
                turn.set_result(None)
                self._begun += 1
        if self._begun and self._loop is not None:
            self._loop.call_soon(self._next)


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
