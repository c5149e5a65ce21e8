"""Rate limits of clients, from which the stop is exempt."""

from __future__ import annotations

from collections.abc import Awaitable

from starlette.responses import Response

from rosld.server.auth.agent import ANONYMOUS
from rosld.server.auth.rate_limit import ClientLimiter, RateLimitExceeded
from rosld.server.middleware.handler import Handler
from rosld.server.rest.exchange import Exchange


class Admission:
    """Admits requests within the limits of their client. `stop` is the path that stops the robot."""

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
        """Whether a request is answered whatever limits there are: it stops the robot."""
        return method == b"POST" and path == self._stop

    def count_refused(self, exchange: Exchange, error: Exception) -> Exception:
        """What became of a request: one that was refused before it was let pass counts like any other (429)."""
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
    """Refuses requests above the limits of a client (429)."""

    def __init__(self, next: Handler, admission: Admission) -> None:
        self._next = next
        self._admission = admission

    def __call__(self, exchange: Exchange) -> Awaitable[Response]:
        """Answer as the next handler does. Raises a 429 Problem."""
        self._admission.admit(exchange)
        return self._next(exchange)
