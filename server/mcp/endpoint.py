"""`/mcp`: streamable HTTP of the Model Context Protocol, behind the checks that every request passes."""

from __future__ import annotations

import asyncio
import importlib
import importlib.util
from collections.abc import Awaitable, Callable

from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from rosld.ontology.urls import Space
from rosld.server.auth.authenticator import Authenticator
from rosld.server.auth.errors import not_visible
from rosld.server.auth.rules import ANONYMOUS
from rosld.server.http.origin import OriginPolicy, check_origin
from rosld.server.http.problem import Problem
from rosld.server.mcp.transport import LocalTransport
from rosld.server.middleware import Handler
from rosld.server.middleware.limits import Admission
from rosld.server.rest.exchange import Exchange
from rosld.server.runtime.tasks import end_tasks
from rosld.server.settings import Settings

SEGMENT = "mcp"
NEEDS_SDK = "tools for language models need the Model Context Protocol SDK: pip install 'rosld[mcp]'"
_OFF = "Tools for language models are switched off here: start the server with --mcp read or --mcp write."


class McpService:
    """The protocol's server, created with the first request: its libraries take 40 MB and a second of CPU."""

    def __init__(self, space: Space, settings: Settings) -> None:
        self.space = space
        self.settings = settings
        self._app: ASGIApp | None = None
        self._serve: Callable[..., Awaitable[None]] | None = None
        self._running: asyncio.Task[None] | None = None
        self._lock = asyncio.Lock()
        self._is_over = False

    def connect(self, app: ASGIApp) -> None:
        """Send the requests of tools to this application."""
        self._app = app

    def transport(self) -> LocalTransport:
        """Return the transport of tools."""
        assert self._app is not None
        return LocalTransport(self._app)

    async def served(self) -> Callable[..., Awaitable[None]]:
        """Return the function that serves a request for an agent. Raises a 404 or 503 Problem."""
        if self.settings.mcp == "off":
            raise Problem(404, _OFF)
        async with self._lock:
            if self._is_over:
                raise Problem(503, "The server is shutting down.", headers={"Retry-After": "10"})
            if self._serve is None:
                if importlib.util.find_spec("mcp") is None:
                    raise Problem(404, f"{NEEDS_SDK[0].upper()}{NEEDS_SDK[1:]}, and restart the server.")
                # On a thread: the loop must not wait for the import.
                module = await asyncio.to_thread(importlib.import_module, "rosld.server.mcp.protocol")
                sessions = module.Sessions(self.space, self.transport(), self.settings)
                started = asyncio.Event()
                self._running = asyncio.get_running_loop().create_task(sessions.run(started))
                await started.wait()
                self._serve = sessions.serve
            return self._serve

    def end(self) -> None:
        """End all sessions, and refuse new ones."""
        self._is_over = True
        if self._running is not None:
            self._running.cancel()

    async def close(self) -> None:
        """End all sessions, and wait until they have ended."""
        self.end()
        if self._running is not None:
            await end_tasks([self._running])


class Mcp:
    """Answers requests for `/mcp`; the credentials are checked here, and rights by the requests of each tool."""

    def __init__(
        self,
        next: Handler,
        service: McpService,
        site: OriginPolicy,
        admission: Admission,
        authenticator: Authenticator | None,
    ) -> None:
        self._next = next
        self._service = service
        self._site = site
        self._admission = admission
        self._authenticator = authenticator
        self._path = f"{service.space.path}{SEGMENT}".encode("ascii")

    def __call__(self, exchange: Exchange) -> Awaitable[Response]:
        """Answer for `/mcp`, and as the next handler does for other paths. Raises Problems."""
        return self._answer(exchange) if exchange.request.scope["raw_path"] == self._path else self._next(exchange)

    async def _answer(self, exchange: Exchange) -> Response:
        # The protocol demands this check of reads, too.
        check_origin(self._site, "POST", exchange.header("origin"), exchange.header("sec-fetch-site"))
        if self._authenticator is not None:
            exchange.auth = await self._authenticator.authenticate(exchange.header("authorization"))
            if exchange.agent == ANONYMOUS and not exchange.permissions.rights.rules:
                raise not_visible(ANONYMOUS)
        if not _is_stop(exchange):
            self._admission.admit(exchange)
        return _McpResponse(await self._service.served(), exchange.agent.name)


def _is_stop(exchange: Exchange) -> bool:
    """Whether a request calls the tool `stop`, which is exempt from the limits of clients, as the stop itself is.

    Its header fields say so since 2026-07-28; the SDK refuses a body that says otherwise.
    """
    fields = ("mcp-method", "mcp-name", "mcp-protocol-version")
    method, name, version = (exchange.header(each) or "" for each in fields)
    return (method, name) == ("tools/call", "stop") and version >= "2026"


class _McpResponse(Response):
    """Response of the protocol's server, with the header fields that handlers add."""

    def __init__(self, serve: Callable[..., Awaitable[None]], agent: str) -> None:
        self.status_code = 200
        self.body = b""
        self.background = None
        self.raw_headers = []
        self._serve = serve
        self._agent = agent

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def send_with_fields(message: Message) -> None:
            if message["type"] == "http.response.start":
                message = {**message, "headers": [*message["headers"], *self.raw_headers]}
            await send(message)

        await self._serve(scope, receive, send_with_fields, self._agent)
