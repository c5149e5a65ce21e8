"""Limits on requests: rate per client (429), and starts per iteration of the event loop. The stop is exempt."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable

from starlette.responses import Response

from rosld.server.auth.rate_limit import ClientLimiter, RateLimitExceeded
from rosld.server.auth.rules import ANONYMOUS
from rosld.server.middleware import Handler
from rosld.server.rest.exchange import Exchange


class Admission:
    """Rate limits of clients; the stop of the robot (POST to the path `stop`) is exempt."""

    def __init__(self, clients: ClientLimiter, stop: bytes) -> None:
        self._clients = clients
        self._stop = stop

    def admit(self, exchange: Exchange) -> None:
        """Count a request. Raises a 429 Problem for a client at its limit."""
        scope = exchange.request.scope
        if scope["raw_path"] != self._stop or exchange.method != "POST":
            client = scope["client"]
            exchange.client = self._clients.acquire(exchange.agent, client[0] if client else None)

    def is_urgent(self, method: bytes, path: bytes) -> bool:
        """Whether a request is exempt from all limits because it stops the robot."""
        return method == b"POST" and path == self._stop

    def count_refused(self, exchange: Exchange, error: Exception) -> Exception:
        """Count a request that was refused before it was admitted, and return its error, or the 429 Problem."""
        if exchange.client is None and not isinstance(error, RateLimitExceeded):
            try:
                self.admit(exchange)
            except RateLimitExceeded as too_much:
                return too_much
        return error

    def admit_websocket(self, address: str | None) -> bool:
        """Whether a client may open a WebSocket now; it counts as a request."""
        try:
            self._clients.release(self._clients.acquire(ANONYMOUS, address))
        except RateLimitExceeded:
            return False
        return True


class RateLimits:
    """Refusal of requests above the limits of a client (429)."""

    def __init__(self, next: Handler, admission: Admission) -> None:
        self._next = next
        self._admission = admission

    def __call__(self, exchange: Exchange) -> Awaitable[Response]:
        """Answer as the next handler does. Raises a 429 Problem."""
        self._admission.admit(exchange)
        return self._next(exchange)


MAX_STARTS = 4
"""Requests started per iteration. One takes about half a millisecond, so the stop waits for a few at most."""


class RequestScheduler:
    """First-in, first-out queue of requests: `limit` of them start per iteration of one event loop."""

    def __init__(self, limit: int = MAX_STARTS) -> None:
        self._limit = limit
        self._begun = 0
        self._waiting: deque[asyncio.Future[None]] = deque()
        self._loop: asyncio.AbstractEventLoop | None = None

    def try_start(self) -> bool:
        """Start now if this iteration has a free slot; otherwise use `wait_turn`."""
        loop = self._loop = self._loop or asyncio.get_running_loop()  # the latter is a system call before Python 3.12
        if self._begun == 0:
            loop.call_soon(self._next)
        if self._begun < self._limit and not self._waiting:
            self._begun += 1
            return True
        return False

    async def wait_turn(self) -> None:
        """Wait for a free slot."""
        if self.try_start():
            return
        turn = asyncio.get_running_loop().create_future()
        self._waiting.append(turn)
        await turn

    def _next(self) -> None:
        self._begun = 0
        while self._waiting and self._begun < self._limit:
            turn = self._waiting.popleft()
            if not turn.done():  # cancelled when the client disconnected
                turn.set_result(None)
                self._begun += 1
        if self._begun and self._loop is not None:
            self._loop.call_soon(self._next)


class Scheduling:
    """Scheduling of all requests but the stop, whose path is `stop`."""

    def __init__(self, next: Handler, stop: bytes, turns: RequestScheduler) -> None:
        self._next = next
        self._stop = stop
        self._turns = turns

    def __call__(self, exchange: Exchange) -> Awaitable[Response]:
        """Answer as the next handler does, in turn."""
        if exchange.request.scope["raw_path"] == self._stop or self._turns.try_start():
            return self._next(exchange)
        return self._later(exchange)

    async def _later(self, exchange: Exchange) -> Response:
        await self._turns.wait_turn()
        return await self._next(exchange)
