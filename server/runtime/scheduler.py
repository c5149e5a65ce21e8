"""Request scheduler: how many requests begin in one iteration of the loop, so that urgent ones never wait for long."""

from __future__ import annotations

import asyncio
from collections import deque

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
