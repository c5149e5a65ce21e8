"""The application: composes robot, resources, verbs and pages into one ASGI app. Nothing is decided here."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Mapping
from urllib.parse import quote

from starlette.requests import Request
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from rosld.adapters.base import Adapter
from rosld.adapters.model import RosError
from rosld.ontology.body import BodyError
from rosld.ontology.lower import LoweringError
from rosld.server.dataset import Dataset
from rosld.server.errors import problem_of, problem_of_body
from rosld.server.events import websocket
from rosld.server.events.channels import Channels
from rosld.server.events.feed import Feeds
from rosld.server.http import link
from rosld.server.http.origin import Site, check_host, check_origin, sharing, site
from rosld.server.http.problem import Problem, render
from rosld.server.ldp.alone import Alone
from rosld.server.ldp.exchange import Exchange
from rosld.server.ldp.pages import Pages
from rosld.server.ldp.resource import Resource
from rosld.server.ldp.verbs import Verbs, options
from rosld.server.records.record import StorageError
from rosld.server.resources.channels import Notifications, rooms
from rosld.server.resources.kept.graphs import RecordGraphs
from rosld.server.resources.router import ROOMS, Router
from rosld.server.robot import Robot
from rosld.server.settings import Settings
from rosld.server.sparql.analysis import Analyser
from rosld.server.sparql.endpoint import QueryService, QuerySettings
from rosld.server.sparql.functions import functions
from rosld.server.sparql.lexer import Bounds
from rosld.server.sparql.sync import Synchroniser
from rosld.server.store import MemoryStore

_log = logging.getLogger("rosld")


def create_app(adapter: Adapter, settings: Settings) -> Application:
    """The ASGI app that serves this adapter; its lifespan opens and closes the adapter, raising what `open` raises."""
    robot = Robot(adapter, settings)
    pages = Pages(robot)
    service = query_service(robot)
    names = site(settings.base_url, settings.host, settings.port, settings.cors_origins)
    feeds = Feeds(robot.changes)
    router = Router(robot, service, pages)
    notifications = Notifications(robot, Channels(robot.boot), feeds, names, router.resolve)
    router.add(rooms(notifications, ROOMS[".well-known"]))
    verbs = Verbs(robot.boot, pages, feeds, Alone(settings.call_deadline))
    return Application(robot, router, verbs, pages, names, notifications, service)


def query_service(robot: Robot) -> QueryService:
    """SPARQL over everything that the robot's resources say."""
    settings = robot.settings
    store = MemoryStore()
    analyser = Analyser(robot.space.base, robot.space.types, bounds=Bounds(size=settings.query_size_limit))
    synchroniser = Synchroniser(store, Dataset(robot), RecordGraphs(robot.records, robot.space.base))
    limits = QuerySettings(settings.query_time_limit, settings.query_memory_limit)
    return QueryService(store, synchroniser, analyser, functions(robot.received_ns), limits)


class Application:
    """One robot on the web."""

    def __init__(
        self,
        robot: Robot,
        router: Router,
        verbs: Verbs,
        pages: Pages,
        names: Site,
        notifications: Notifications,
        service: QueryService,
    ) -> None:
        self.robot = robot
        self._router = router
        self._verbs = verbs
        self._pages = pages
        self._site = names
        self._notifications = notifications
        self._service = service
        self._standing = (b"link", link.render([notifications.link]).encode("latin-1"))

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http":
            await self._http(scope, receive, send)
        elif scope["type"] == "lifespan":
            await self._lifespan(receive, send)
        else:
            await self._websocket(scope, receive, send)

    def end_streams(self) -> None:
        """End what would go on for ever: to be called when the server is told to end, before it waits for requests."""
        self._verbs.feeds.end()

    async def _lifespan(self, receive: Receive, send: Send) -> None:
        await receive()
        await self.robot.start()
        indexing = asyncio.ensure_future(self._service.keep_up())
        await send({"type": "lifespan.startup.complete"})
        await receive()
        indexing.cancel()
        await asyncio.wait([indexing])
        await self.robot.stop()
        await send({"type": "lifespan.shutdown.complete"})

    async def _http(self, scope: Scope, receive: Receive, send: Send) -> None:
        exchange = Exchange(Request(scope, receive), self.robot.settings.body_limit)
        origin = exchange.header("origin")
        try:
            response = await self._answer(exchange, origin)
        except Exception as error:
            response = self._failure(exchange, error)
        if origin is not None or self._site.shared or self._site.anybody:
            _share(response, sharing(self._site, exchange.method, origin))
        response.raw_headers = [*response.raw_headers, self._standing]
        await response(scope, receive, send)

    async def _websocket(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            websocket.check_request(self._site, scope)
            receiver = self._notifications.receiver(scope)
        except Problem as problem:
            await websocket.refuse(scope, send, problem)
            return
        await receiver(scope, receive, send)

    async def _answer(self, exchange: Exchange, origin: str | None) -> Response:
        check_host(self._site, exchange.hosts)
        check_origin(self._site, exchange.method, origin, exchange.header("sec-fetch-site"))
        resource = self._router.resolve(exchange.request.scope)
        if exchange.method == "OPTIONS" and exchange.header("access-control-request-method") is not None:
            return self._preflight(resource, origin)
        return await self._verbs.answer(exchange, resource)

    def _preflight(self, resource: Resource, origin: str | None) -> Response:
        headers = options(resource)
        response = Response(status_code=204, headers=headers)
        _share(response, sharing(self._site, "OPTIONS", origin, preflight=True))
        return response

    def _failure(self, exchange: Exchange, error: Exception) -> Response:
        """The response that tells of an error. What nobody foresaw is logged in full and told in one sentence."""
        if isinstance(error, RosError):
            error = problem_of(error)
        elif isinstance(error, BodyError | LoweringError):
            error = problem_of_body(error)
        elif isinstance(error, StorageError):
            error = Problem(507 if error.full else 503, str(error))
        if not isinstance(error, Problem):
            _log.exception("%s %s failed", exchange.method, exchange.request.scope["path"], exc_info=error)
            error = Problem(500, "The server failed on this request; its log says more.")
        path = quote(exchange.request.scope["raw_path"].lstrip(b"/"), safe="/%:@!$&'()*+,;=~")
        url = self.robot.space.base + path
        return self._pages.problem(exchange, error, url) or render(error, exchange.accept, url=url).response()


def _share(response: Response, headers: Mapping[str, str]) -> None:
    """Add CORS headers to a response, joining Vary. The header list is copied: it may belong to a kept rendering."""
    names = {name.encode("latin-1") for name in headers}
    kept = [pair for pair in response.raw_headers if pair[0] not in names]
    varied = [value.decode("latin-1") for name, value in response.raw_headers if name == b"vary"]
    vary = dict.fromkeys(part.strip() for value in (*varied, headers.get("vary", "")) for part in value.split(","))
    joined = {**headers, "vary": ", ".join(part for part in vary if part)} if "vary" in headers else headers
    response.raw_headers = [
        *kept,
        *((name.encode("latin-1"), value.encode("latin-1")) for name, value in joined.items()),
    ]
