"""The ends of the middleware stack: resources and channels answer, and exceptions become responses."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Mapping
from urllib.parse import quote

from msgspec import Struct
from starlette.responses import Response
from starlette.types import ASGIApp, Receive, Scope, Send

from rosld.adapters.model import RosError
from rosld.ontology.body import BodyError
from rosld.ontology.urls import Space
from rosld.ontology.violations import LoweringError
from rosld.server.auth import enforcement
from rosld.server.auth.rate_limit import RETRY_SECONDS, RateLimitExceeded
from rosld.server.auth.redaction import redact_problem
from rosld.server.auth.rules import ANONYMOUS
from rosld.server.events.delivery import check_request, reject_handshake
from rosld.server.http.origin import OriginPolicy
from rosld.server.http.problem import Problem
from rosld.server.http.problem_details import render
from rosld.server.http.token_redaction import redact_tokens
from rosld.server.middleware import Handler
from rosld.server.middleware.limits import Admission
from rosld.server.resources.channels import Notifications
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.pages import PageRenderer
from rosld.server.rest.resource import Resource
from rosld.server.rest.ros_problems import problem_of, problem_of_body, problem_of_out_of_memory
from rosld.server.routing.dispatcher import Dispatcher
from rosld.server.runtime.process_memory import is_out_of_memory
from rosld.server.sparql.protocol import UPDATE_MEDIA_TYPE
from rosld.server.storage.record import StorageError

_log = logging.getLogger("rosld")


class ErrorResponses:
    """Exceptions as pages or problem details (RFC 9457), redacted for the agent."""

    def __init__(self, next: Handler, admission: Admission, pages: PageRenderer, space: Space) -> None:
        self._next = next
        self._admission = admission
        self._pages = pages
        self._space = space

    async def __call__(self, exchange: Exchange) -> Response:
        """Answer as the next handler does, or describe what it raises."""
        try:
            return await self._next(exchange)
        except Exception as raised:
            error = self._admission.count_refused(exchange, raised)
            if isinstance(error, RateLimitExceeded):
                await asyncio.sleep(RETRY_SECONDS)
            return self._failure(exchange, error)

    def _failure(self, exchange: Exchange, error: Exception) -> Response:
        """Return the response for an error. An unexpected error is logged in full, and the client gets one sentence."""
        scope = exchange.request.scope
        if isinstance(error, RosError):
            error = problem_of(error)
        elif isinstance(error, BodyError | LoweringError):
            error = problem_of_body(error)
        elif isinstance(error, StorageError):
            lasts = error.full or error.final
            error = Problem(507, str(error)) if lasts else Problem(503, str(error), headers={"Retry-After": "1"})
        elif is_out_of_memory(error):
            _log.error("%s %s: %s", exchange.method, scope["path"], error or "out of memory")
            error = problem_of_out_of_memory(error, is_write=self._would_write(exchange))
        if not isinstance(error, Problem):
            id = exchange.request_id
            _log.exception("%s %s failed, request %s", exchange.method, scope["path"], id, exc_info=error)
            error = Problem(500, "The server failed to handle this request; see its log.", extra={"requestId": id})
        error = redact_problem(error, exchange.permissions, enforcement.location_of(scope, self._space))
        self._explain_release(error, exchange)
        exchange.audit.set_refusal(error.with_quotes, error.about)
        path = quote(scope["raw_path"].lstrip(b"/"), safe="/%:@!$&'()*+,;=~")
        url = redact_tokens(self._space.base + path)
        return self._pages.problem(exchange, error, url) or render(error, exchange.accept, url=url).response()

    def _explain_release(self, error: Problem, exchange: Exchange) -> None:
        """Explain how to release the stop, only to an agent that may release it."""
        if error.status != 423 or not exchange.permissions.may("DELETE", self._space.stop):
            return
        if exchange.agent == ANONYMOUS:
            error.detail += f" A person can release the stop at {self._space.stop}."
        else:
            error.detail += f" DELETE of {self._space.stop} releases the stop."

    def _would_write(self, exchange: Exchange) -> bool:
        """Whether a request is a write, as far as it was read; a form sent to `/sparql` is judged by its content."""
        if exchange.audit.is_write or exchange.method in ("PUT", "PATCH"):
            return True
        is_write = enforcement.is_write(exchange.method, enforcement.location_of(exchange.request.scope, self._space))
        return exchange.essence == UPDATE_MEDIA_TYPE or is_write


_OF_SERVER = {"allow": "DELETE, GET, HEAD, OPTIONS, PATCH, POST, PUT"}
"""Response to `OPTIONS *`: methods of any resource (RFC 9110 9.3.7)."""


class ServerOptions:
    """Responses to `OPTIONS *`, which is about the whole server (RFC 9112 3.2.4)."""

    def __init__(self, next: Handler, admission: Admission) -> None:
        self._next = next
        self._admission = admission

    def __call__(self, exchange: Exchange) -> Awaitable[Response]:
        """Answer for `*`, and as the next handler does for a path. Raises a 400 Problem for other methods on `*`."""
        return self._next(exchange) if exchange.request.scope["raw_path"] != b"*" else self._answer(exchange)

    async def _answer(self, exchange: Exchange) -> Response:
        self._admission.admit(exchange)
        if exchange.method != "OPTIONS":
            raise Problem(400, "Only OPTIONS is allowed for the whole server (*): name a resource.")
        return Response(status_code=204, headers=_OF_SERVER)


class Dispatch:
    """The innermost handler: finds the resource and lets it answer."""

    def __init__(self, resolve: Callable[[Scope], Resource], dispatcher: Dispatcher) -> None:
        self._resolve = resolve
        self._dispatcher = dispatcher

    def __call__(self, exchange: Exchange) -> Awaitable[Response]:
        """Return the response of the resource. Raises what resources raise."""
        return self._dispatcher.answer(exchange, self._resolve(exchange.request.scope))


class WebSockets(Struct, eq=False):
    """The ASGI application of WebSockets: those of channels, and `others`, which return a receiver, by path."""

    site: OriginPolicy
    admission: Admission
    notifications: Notifications
    others: Mapping[bytes, Callable[[Scope], Awaitable[ASGIApp]]]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve a WebSocket, or refuse its handshake with a problem."""
        client = scope["client"]
        if not self.admission.admit_websocket(client[0] if client else None):
            await asyncio.sleep(RETRY_SECONDS)
            await reject_handshake(scope, send, Problem(429, "You opened too many WebSockets per second: slow down."))
            return
        try:
            check_request(self.site, scope)
            other = self.others.get(scope["raw_path"])
            receiver = await other(scope) if other is not None else self.notifications.websocket_receiver(scope)
        except Problem as problem:
            await reject_handshake(scope, send, problem)
            return
        await receiver(scope, receive, send)
