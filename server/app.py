"""The application: composes robot, resources, verbs and pages into one ASGI app. Nothing is decided here."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Mapping
from functools import partial
from urllib.parse import quote

from starlette.requests import Request
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from rosld.adapters.base import Adapter
from rosld.adapters.model import RosError
from rosld.ontology.body import BodyError
from rosld.ontology.lower import LoweringError
from rosld.ontology.urls import Location
from rosld.server.access import gate
from rosld.server.access.agent import ANYBODY
from rosld.server.access.door import Door
from rosld.server.access.judge import Judge
from rosld.server.clients import REFUSAL_SECONDS, Allowance, Clients, TooMuch
from rosld.server.dataset import ELSEWHERE, Dataset
from rosld.server.errors import problem_of, problem_of_body, problem_of_shortage
from rosld.server.events import websocket
from rosld.server.events.channels import Channels
from rosld.server.events.feed import Feeds
from rosld.server.html import prepare_pages
from rosld.server.http import link
from rosld.server.http.origin import Site, check_host, check_origin, sharing, site
from rosld.server.http.problem import Problem
from rosld.server.http.problem_details import render
from rosld.server.http.tokens import LENGTH as TOKEN_LENGTH
from rosld.server.http.tokens import PREFIX, has_token, without_tokens
from rosld.server.hypermedia.mappings import relations
from rosld.server.ldp.alone import Alone
from rosld.server.ldp.exchange import Exchange
from rosld.server.ldp.large import LargeDocuments
from rosld.server.ldp.pages import Pages
from rosld.server.ldp.resource import Resource
from rosld.server.ldp.verbs import Verbs, options
from rosld.server.memory import is_shortage
from rosld.server.mirroring import mirror_of
from rosld.server.receipts.graphs import ReceiptGraphs
from rosld.server.receipts.recorder import Recorder
from rosld.server.records.record import StorageError
from rosld.server.resources.acl import acl_room
from rosld.server.resources.channels import Notifications, fixed, rooms
from rosld.server.resources.kept.graphs import RecordGraphs
from rosld.server.resources.mirror import mirror_room
from rosld.server.resources.router import ROOMS, Router
from rosld.server.resources.status import status_room
from rosld.server.resources.typed import types_at
from rosld.server.resources.updating.service import Updates
from rosld.server.robot import Robot, Same
from rosld.server.settings import Settings
from rosld.server.sparql.analysis import Analyser
from rosld.server.sparql.endpoint import QueryService, QuerySettings, Unread
from rosld.server.sparql.mentions import Mentions, Noting
from rosld.server.sparql.process.client import QueryProcess
from rosld.server.sparql.protocol import UPDATE
from rosld.server.sparql.restricted import RestrictedDatasets
from rosld.server.sparql.sync import Synchroniser
from rosld.server.sparql.syntax.lexer import Bounds, Reach
from rosld.server.sparql.update.drawer import Drawer
from rosld.server.store.mirror import Mirror
from rosld.server.turns import Turns
from rosld.server.watchdog import Watchdog

_log = logging.getLogger("rosld")
_TOKEN_MARK = PREFIX.encode("ascii")
_ABSENT = frozenset({404, 410})
_REFUSED = frozenset({403, *_ABSENT})
_TELLING_NOTHING = frozenset({401, *_ABSENT})
"""Statuses of answers that say nothing of what may be done: it might tell whether anything is there."""

_OF_SERVER = {"allow": "DELETE, GET, HEAD, OPTIONS, PATCH, POST, PUT"}
"""The answer to `OPTIONS *`: methods that some resource here has (RFC 9110 9.3.7)."""


def create_app(adapter: Adapter, settings: Settings) -> Application:
    """The ASGI app that serves this adapter; its lifespan opens and closes the adapter, raising what `open` raises."""
    robot = Robot(adapter, settings)
    large = LargeDocuments(robot.workers)
    pages = Pages(robot, robot.stops, large)
    process = QueryProcess(settings.query_concurrency, settings.query_queue)
    kept = RecordGraphs(robot.records, robot.space.base, robot.queries.said, ELSEWHERE)
    mentions = Mentions(robot.space.base, robot.space.types)
    receipts = ReceiptGraphs(robot.receipts, robot.space)
    source = Dataset(robot)
    synchroniser = Synchroniser(process, source, Noting(kept, mentions), receipts, mentioned=mentions.of)
    reach = Reach(frozenset(settings.allow_service))
    bounded = Bounds(size=settings.query_size_limit)
    analyser = Analyser(
        robot.space.base,
        robot.space.types,
        bounds=bounded,
        reach=reach,
        relations=lambda: relations(robot.mappings.arrangement),
    )
    service = query_service(robot, process, synchroniser, analyser, source.unread)
    mirror = mirror_of(robot, process, synchroniser, {*ROOMS, "queries", "sparql"})
    names = site(settings.base_url, settings.host, settings.port, settings.cors_origins)
    feeds = Feeds(robot.changes, settings.client_streams)
    alone = Alone(settings.call_deadline)
    bounds = Bounds(size=settings.body_limit)
    drawer = Drawer(service, analyser)
    router = Router(robot, service, pages, lambda at: Updates(robot, drawer, analyser, bounds, at, alone))
    notifications = Notifications(robot, Channels(robot.boot), feeds, names, router.resolve)
    router.add(rooms(notifications, ROOMS[".well-known"]))
    router.add(mirror_room(mirror))
    watchdog = Watchdog()
    router.add(status_room(watchdog))
    described = {each.url: each.document for each in fixed(notifications)}
    described |= {router.endpoint.url: router.endpoint.document, router.graphs.url: router.graphs.document}
    changing = ("/status",) if mirror is None else ("/status", "/mirror")
    source.add(described, map(router.at, changing))
    door = None if settings.auth is None else Door(settings.auth, robot.space, partial(types_at, robot))
    if door is not None:
        door.changed.watch(feeds.stir)
    router.add(acl_room(door))
    verbs = Verbs(robot.boot, pages, feeds, alone, large)
    return Application(robot, router, verbs, pages, names, notifications, service, process, watchdog, mirror, door)


def query_service(
    robot: Robot, process: QueryProcess, synchroniser: Synchroniser, analyser: Analyser, unread: Unread
) -> QueryService:
    """SPARQL over everything that the robot's resources say."""
    settings = robot.settings
    limits = QuerySettings(
        settings.query_time_limit,
        settings.query_memory_limit,
        settings.query_row_limit,
        settings.query_concurrency,
        settings.query_queue,
    )
    restricted = RestrictedDatasets(process, lambda: Same(robot.graph))
    return QueryService(process, synchroniser, analyser, robot.ages, limits, restricted, unread)


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
        process: QueryProcess,
        watchdog: Watchdog,
        mirror: Mirror | None = None,
        door: Door | None = None,
    ) -> None:
        self.robot = robot
        self._router = router
        self._verbs = verbs
        self._pages = pages
        self._site = names
        self._notifications = notifications
        self._service = service
        self._process = process
        self._watchdog = watchdog
        self._turns = Turns()
        self._stop = f"{robot.space.path}stop".encode("ascii")
        self._mirror = mirror
        self._recorder = Recorder(robot.receipts, robot.space)
        settings = robot.settings
        allowance = Allowance(
            settings.client_rate, settings.client_requests, settings.client_connections, settings.client_websockets
        )
        self.clients = Clients(allowance, loopback=settings.limit_loopback)
        self._door = door
        self._acl = link.Link(f"{robot.space.base}acl", "acl")
        self._standing = (b"link", link.render([notifications.link]).encode("latin-1"))

    @property
    def rooms(self) -> frozenset[str]:
        """The first segments of all paths that lead anywhere."""
        return self._router.rooms

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http":
            exchange = Exchange(
                Request(scope, receive), self.robot.settings.body_limit, self.robot.settings.body_timeout
            )
            try:
                await self._http(exchange, scope, receive, send)
            finally:
                self.clients.leave(exchange.client)
        elif scope["type"] == "lifespan":
            await self._lifespan(receive, send)
        else:
            await self._websocket(scope, receive, send)

    def is_urgent(self, method: bytes, path: bytes) -> bool:
        """Whether a request is answered whatever limits there are: it stops the robot."""
        return method == b"POST" and path == self._stop

    def end_streams(self) -> None:
        """End what would go on for ever, holds first: to be called when the server is told to end, before it waits for

        requests.
        """
        self.robot.holds.close("rosld ended")
        self._verbs.feeds.end()

    async def _lifespan(self, receive: Receive, send: Send) -> None:
        await receive()
        await self._process.start()
        try:
            await self.robot.start()
        except BaseException:
            await self._process.close()
            raise
        self._watchdog.start()
        background = [asyncio.ensure_future(self._service.keep_up())]
        background.append(asyncio.ensure_future(asyncio.to_thread(prepare_pages)))
        if self._mirror is not None:
            background.append(asyncio.ensure_future(self._mirror.run()))
        if self._door is not None:
            background.append(asyncio.ensure_future(self._door.keep_up()))
        await send({"type": "lifespan.startup.complete"})
        await receive()
        self._watchdog.stop()
        for each in background:
            each.cancel()
        await asyncio.wait(background)
        if self._mirror is not None:
            await self._mirror.close()
        await self._verbs.large.close()
        await self._process.close()
        await self.robot.stop()
        await send({"type": "lifespan.shutdown.complete"})

    async def _http(self, exchange: Exchange, scope: Scope, receive: Receive, send: Send) -> None:
        origin = exchange.header("origin")
        if self._door is not None:
            exchange.visit = self._door.anybody
        try:
            response = await self._answer(exchange, origin)
        except Exception as error:
            error = self._counted(exchange, error)
            if isinstance(error, TooMuch):
                await asyncio.sleep(REFUSAL_SECONDS)
            response = self._failure(exchange, error)
        if response.status_code in _REFUSED:
            self._audit_refusal(exchange, response.status_code)
        if exchange.account.is_write:
            response.raw_headers = [*response.raw_headers, self._recorder.note(exchange, scope, response)]
        if self._door is not None:
            place = self._place(exchange)
            judge, public = exchange.judge, self._door.anybody.judge
            if response.status_code in _TELLING_NOTHING and not _may_know(judge, place, response.status_code):
                place = None
            response.raw_headers = gate.marked(
                response.raw_headers, judge, public, place, exchange.answering, self._acl
            )
        if origin is not None or self._site.shared or self._site.anybody:
            _share(response, sharing(self._site, exchange.method, origin))
        response.raw_headers = [*response.raw_headers, self._standing]
        await response(scope, receive, send)

    async def _websocket(self, scope: Scope, receive: Receive, send: Send) -> None:
        client = scope["client"]
        if not self._may_open(client[0] if client else None):
            await asyncio.sleep(REFUSAL_SECONDS)
            await websocket.refuse(scope, send, Problem(429, "You open too many WebSockets a second: open fewer."))
            return
        try:
            websocket.check_request(self._site, scope)
            receiver = self._notifications.receiver(scope)
        except Problem as problem:
            await websocket.refuse(scope, send, problem)
            return
        await receiver(scope, receive, send)

    async def _answer(self, exchange: Exchange, origin: str | None) -> Response:
        path: bytes = exchange.request.scope["raw_path"]
        if exchange.header("host") not in self._site.hosts:  # several are joined, and then none of these
            check_host(self._site, exchange.hosts)
        check_origin(self._site, exchange.method, origin, exchange.header("sec-fetch-site"))
        if path != self._stop:
            await self._turns.wait()
        if path == b"*":
            self._admit(exchange)
            return _of_server(exchange.method)
        is_preflight = exchange.method == "OPTIONS" and exchange.header("access-control-request-method") is not None
        if self._door is not None:
            if is_preflight:  # it never says who asks, so it is told of nothing
                self._admit(exchange)
                return self._preflight(None, origin)
            exchange.visit = await self._door.visit(exchange.header("authorization"))
            if not exchange.judge.whole:
                place = gate.place_of(exchange.request.scope, self.robot.space)
                gate.require_path(exchange.judge, exchange.method, place)
        self._require_no_token(exchange)
        self._admit(exchange)
        resource = self._router.resolve(exchange.request.scope)
        if is_preflight:
            return self._preflight(resource, origin)
        return await self._verbs.answer(exchange, resource)

    def _require_no_token(self, exchange: Exchange) -> None:
        """Raises a 400 Problem where the URL has a token of rosld in it: URLs are logged, linked and remembered.

        What has such a name already can be deleted.
        """
        scope = exchange.request.scope
        asked: bytes = scope["raw_path"] + b"?" + scope["query_string"]
        if len(asked) <= TOKEN_LENGTH or exchange.method == "DELETE" or not (_TOKEN_MARK in asked or b"%" in asked):
            return
        if has_token(asked.decode("latin-1")):
            if gate.is_write(exchange.method, self._place(exchange)):
                exchange.account.begin()
            sentence = "The URL has a token in it: send it as 'Authorization: Bearer TOKEN', and have it replaced."
            raise Problem(400, sentence)

    def _admit(self, exchange: Exchange) -> None:
        """Raises a 429 Problem for a client at its limit. Stopping the robot is never too much."""
        scope = exchange.request.scope
        if scope["raw_path"] != self._stop or exchange.method != "POST":
            client = scope["client"]
            exchange.client = self.clients.admit(exchange.agent, client[0] if client else None)

    def _may_open(self, address: str | None) -> bool:
        """Whether a client may open a WebSocket now; it counts as a request."""
        try:
            self.clients.leave(self.clients.admit(ANYBODY, address))
        except TooMuch:
            return False
        return True

    def _counted(self, exchange: Exchange, error: Exception) -> Exception:
        """What became of a request: one that was refused before it was let pass counts like any other (429)."""
        if exchange.client is None and not isinstance(error, TooMuch):
            try:
                self._admit(exchange)
            except TooMuch as too_much:
                return too_much
        return error

    def _preflight(self, resource: Resource | None, origin: str | None) -> Response:
        headers = {"vary": "Accept"} if resource is None else options(resource)
        response = Response(status_code=204, headers=headers)
        _share(response, sharing(self._site, "OPTIONS", origin, preflight=True))
        return response

    def _place(self, exchange: Exchange) -> Location | None:
        return gate.place_of(exchange.request.scope, self.robot.space)

    def _audit_refusal(self, exchange: Exchange, status: int) -> None:
        """See to it that a write of a known agent leaves a receipt where it was refused for want of rights, or of

        anything there; of nobody in particular, what is not there leaves none.
        """
        if exchange.agent == ANYBODY:
            if status in _ABSENT:
                exchange.account.only_reads()
        elif gate.is_write(exchange.method, self._place(exchange)):
            exchange.account.begin()

    def _would_write(self, exchange: Exchange) -> bool:
        """Whether a request is a write, as far as it was read: of a form for `/sparql`, only its content tells."""
        if exchange.account.is_write or exchange.method in ("PUT", "PATCH"):
            return True
        return exchange.essence == UPDATE or gate.is_write(exchange.method, self._place(exchange))

    def _failure(self, exchange: Exchange, error: Exception) -> Response:
        """The response that tells of an error. What nobody foresaw is logged in full and told in one sentence."""
        if isinstance(error, RosError):
            error = problem_of(error)
        elif isinstance(error, BodyError | LoweringError):
            error = problem_of_body(error)
        elif isinstance(error, StorageError):
            error = Problem(507, str(error)) if error.full else Problem(503, str(error), headers={"Retry-After": "1"})
        elif is_shortage(error):
            _log.error("%s %s: %s", exchange.method, exchange.request.scope["path"], error or "no memory is left")
            error = problem_of_shortage(error, is_write=self._would_write(exchange))
        if not isinstance(error, Problem):
            _log.exception("%s %s failed", exchange.method, exchange.request.scope["path"], exc_info=error)
            error = Problem(500, "The server failed on this request; its log says more.")
        error = gate.told(exchange.judge, error, self._place(exchange))
        exchange.account.refused(error.detail)
        path = quote(exchange.request.scope["raw_path"].lstrip(b"/"), safe="/%:@!$&'()*+,;=~")
        url = without_tokens(self.robot.space.base + path)
        return self._pages.problem(exchange, error, url) or render(error, exchange.accept, url=url).response()


def _may_know(judge: Judge, place: Location | None, status: int) -> bool:
    """Whether an agent may know that there is nothing at a place."""
    return status in _ABSENT and place is not None and judge.knows_any(place)


def _of_server(method: str) -> Response:
    """The answer to `OPTIONS *`. Raises a 400 Problem for other methods, which are for a resource (RFC 9112 3.2.4)."""
    if method != "OPTIONS":
        raise Problem(400, "Only OPTIONS is for the whole server (*): name a resource.")
    return Response(status_code=204, headers=_OF_SERVER)


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
