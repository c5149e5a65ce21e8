"""The end of the middleware stack: the resource at the path answers."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from starlette.responses import Response
from starlette.types import Scope

from rosld.server.http.problem import Problem
from rosld.server.middleware.handler import Handler
from rosld.server.middleware.rate_limits import Admission
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.resource import Resource
from rosld.server.routing.dispatcher import Dispatcher

_OF_SERVER = {"allow": "DELETE, GET, HEAD, OPTIONS, PATCH, POST, PUT"}
"""The answer to `OPTIONS *`: methods that some resource here has (RFC 9110 9.3.7)."""


class ServerOptions:
    """Answers `OPTIONS *`, which is for the whole server (RFC 9112 3.2.4)."""

    def __init__(self, next: Handler, admission: Admission) -> None:
        self._next = next
        self._admission = admission

    def __call__(self, exchange: Exchange) -> Awaitable[Response]:
        """Answer for `*`, and as the next handler does for a path. Raises a 400 Problem for other methods of `*`."""
        return self._next(exchange) if exchange.request.scope["raw_path"] != b"*" else self._answer(exchange)

    async def _answer(self, exchange: Exchange) -> Response:
        self._admission.admit(exchange)
        if exchange.method != "OPTIONS":
            raise Problem(400, "Only OPTIONS is for the whole server (*): name a resource.")
        return Response(status_code=204, headers=_OF_SERVER)


class Dispatch:
    """Finds the resource and has it answer."""

    def __init__(self, resolve: Callable[[Scope], Resource], dispatcher: Dispatcher) -> None:
        self._resolve = resolve
        self._dispatcher = dispatcher

    def __call__(self, exchange: Exchange) -> Awaitable[Response]:
        """Answer. Raises what resources raise."""
        return self._dispatcher.answer(exchange, self._resolve(exchange.request.scope))
