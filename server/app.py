"""The application: composes robot, resources, verbs and pages into one ASGI app. Nothing is decided here."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial

from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from rosld.adapters.base import Adapter
from rosld.ontology.urls import Space
from rosld.server.auth.authenticator import Authenticator
from rosld.server.auth.rate_limit import ClientLimiter, ClientLimits
from rosld.server.events.broadcaster import Broadcasters
from rosld.server.events.notification_channels import Channels
from rosld.server.html import prepare_pages
from rosld.server.http import link
from rosld.server.http.origin import OriginPolicy, origin_policy
from rosld.server.hypermedia.mappings import relations
from rosld.server.middleware.audit import Audit
from rosld.server.middleware.authentication import AccessHeaders, Authentication
from rosld.server.middleware.cors import CrossOriginHeaders, Preflight, TrustedHosts
from rosld.server.middleware.dispatch import Dispatch, ServerOptions
from rosld.server.middleware.error_responses import ErrorResponses
from rosld.server.middleware.handler import Handler
from rosld.server.middleware.lifespan import Job, Lifespan
from rosld.server.middleware.rate_limits import Admission, RateLimits
from rosld.server.middleware.scheduling import Scheduling
from rosld.server.middleware.tokens_in_urls import RejectTokensInUrls
from rosld.server.middleware.websockets import WebSockets
from rosld.server.receipts.journal import Journal
from rosld.server.resources.acl import AclResource
from rosld.server.resources.channels import Notifications, fixed_resources
from rosld.server.resources.channels import routes as notification_routes
from rosld.server.resources.frames import FramesResource
from rosld.server.resources.ldp.record_graphs import RecordGraphs
from rosld.server.resources.mapping_warnings import log_mapping_warnings
from rosld.server.resources.mirror import ReplicationResource
from rosld.server.resources.mirror_setup import create_mirror
from rosld.server.resources.near import near_urls
from rosld.server.resources.past_messages import RecordedPast
from rosld.server.resources.plot import PlotResource
from rosld.server.resources.resource_types import types_at
from rosld.server.resources.space import SpaceResource
from rosld.server.resources.sparql_update.service import UpdateService
from rosld.server.resources.status import StatusResource
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.keyed_lock import KeyedLock
from rosld.server.rest.large import LargeDocuments
from rosld.server.rest.pages import PageRenderer
from rosld.server.rest.resource import Resource
from rosld.server.robot.hold_store import Holds
from rosld.server.robot.scene import Scene
from rosld.server.robot.session import Session
from rosld.server.routing.dispatcher import Dispatcher
from rosld.server.routing.live_graphs import OTHER_ROUTES, RobotGraphs
from rosld.server.routing.resource_factory import ResourceFactory
from rosld.server.routing.router import Router, robot_routes, single_route
from rosld.server.routing.services import Services
from rosld.server.runtime.version_cache import IdentityKey
from rosld.server.runtime.watchdog import Watchdog
from rosld.server.settings import Settings
from rosld.server.sparql.analysis import Analyser
from rosld.server.sparql.materializer import Materializer
from rosld.server.sparql.mentions import MentionRecorder, Mentions
from rosld.server.sparql.process.client import QueryProcess
from rosld.server.sparql.query_service import QueryService, QuerySettings, UnreadGraphs
from rosld.server.sparql.receipt_graphs import ReceiptGraphs
from rosld.server.sparql.restricted import RestrictedDatasets
from rosld.server.sparql.syntax.lexer import QueryBounds, ServiceAllowlist
from rosld.server.sparql.update.executor import UpdateEvaluator


def create_app(adapter: Adapter, settings: Settings) -> Application:
    """The ASGI app that serves this adapter; its lifespan opens and closes the adapter, raising what `open` raises."""
    services = Services(adapter, settings)
    session, space, documents = services.session, services.session.space, services.documents
    factory = ResourceFactory(services)
    routes = robot_routes(factory)
    scene = Scene(session)
    large = LargeDocuments(documents.workers)
    pages = PageRenderer(session, services.software_stop, large, services.receipts)
    process = QueryProcess(settings.query_concurrency, settings.query_queue)
    kept = RecordGraphs(documents.records, space.base, services.queries.description, OTHER_ROUTES)
    mentions = Mentions(space.base, space.types)
    receipts = ReceiptGraphs(services.receipts, space)
    source = RobotGraphs(factory)
    materializer = Materializer(
        process, source, MentionRecorder(kept, mentions), receipts, mentioned=mentions.documents_of
    )
    reach = ServiceAllowlist(frozenset(settings.allow_service))
    bounded = QueryBounds(size=settings.query_size_limit)
    analyser = Analyser(
        space.base,
        space.types,
        bounds=bounded,
        reach=reach,
        relations=lambda: relations(services.mappings.mapping_set),
    )
    service = query_service(services, process, materializer, analyser, source.count_unread)
    mirror = create_mirror(session, services.instance_id, process, materializer, {*routes, "queries", "sparql"})
    names = origin_policy(settings.base_url, settings.host, settings.port, settings.cors_origins)
    broadcasters = Broadcasters(session.changes, settings.client_streams)
    keyed_lock = KeyedLock(settings.call_deadline)
    bounds = QueryBounds(size=settings.body_limit)
    evaluator = UpdateEvaluator(service, analyser)

    def updates(at: Callable[[str], Resource]) -> UpdateService:
        return UpdateService(session, services.affordances, documents, evaluator, analyser, bounds, at, keyed_lock)

    router = Router(factory, routes, service, pages, updates)
    notifications = Notifications(
        space, services.instance_id, Channels(services.instance_id), broadcasters, names, router.resolve
    )
    router.add(notification_routes(notifications, routes[".well-known"]))
    plot = partial(PlotResource, session, services.affordances, factory.history, broadcasters)
    view = partial(SpaceResource, session, scene, factory.history, broadcasters)
    watchdog = Watchdog()
    status = partial(StatusResource, space, services.storage_problems, watchdog)
    own: dict[str, Callable[[], Resource]] = {
        "plot": plot,
        "space": view,
        "frames": partial(FramesResource, session, scene),
        "status": status,
    }
    changing = ["/status"]
    if mirror is not None:
        own["mirror"] = partial(ReplicationResource, space, mirror)
        changing.append("/mirror")
    router.add({name: single_route(make) for name, make in own.items()})
    described = {each.url: each.document for each in fixed_resources(notifications)}
    described |= {each.url: each.document for each in (router.endpoint, router.graphs, router.search, plot(), view())}
    source.add(described, map(router.at, changing))
    authenticator = (
        None
        if settings.auth is None
        else Authenticator(settings.auth, space, partial(types_at, session, services.affordances))
    )
    if authenticator is not None:
        authenticator.changed.watch(broadcasters.wake_all)
        router.add({"acl": single_route(partial(AclResource, space.base, authenticator))})
    dispatcher = Dispatcher(
        services.instance_id, pages, broadcasters, keyed_lock, large, partial(near_urls, session, services.affordances)
    )
    allowance = ClientLimits(
        settings.client_rate, settings.client_requests, settings.client_connections, settings.client_websockets
    )
    clients = ClientLimiter(allowance, loopback=settings.limit_loopback)
    admission = Admission(clients, f"{space.path}stop".encode("ascii"))
    handler = middleware(space, services.receipts, router, dispatcher, pages, names, admission, authenticator)
    background: list[Job] = [
        service.keep_materialized,
        partial(asyncio.to_thread, prepare_pages),
        partial(log_mapping_warnings, services.affordances, services.mappings),
    ]
    closings: list[Job] = [large.close, scene.close]
    if mirror is not None:
        background.append(mirror.run)
        closings.insert(0, mirror.close)
    if authenticator is not None:
        background.append(authenticator.watch_file)
    return Application(
        session,
        services.holds,
        clients,
        admission,
        broadcasters,
        router.route_names,
        HttpApplication(handler, clients, settings, link.render([notifications.link])),
        WebSockets(names, admission, notifications),
        Lifespan(services.start, services.stop, process, watchdog, background, closings),
    )


def middleware(
    space: Space,
    receipts: Journal,
    router: Router,
    dispatcher: Dispatcher,
    pages: PageRenderer,
    names: OriginPolicy,
    admission: Admission,
    authenticator: Authenticator | None,
) -> Handler:
    """The stack that answers a request, made from its end to its beginning."""
    stop = f"{space.path}stop".encode("ascii")
    handler: Handler = Dispatch(router.resolve, dispatcher)
    if authenticator is None:
        handler = Preflight(handler, names, lambda exchange: router.resolve(exchange.request.scope))
    handler = RateLimits(handler, admission)
    handler = RejectTokensInUrls(handler, space)
    if authenticator is not None:
        handler = Authentication(handler, authenticator, space)
        # A preflight request never says who asks, so it is told of nothing, before anybody is asked for.
        handler = Preflight(handler, names, lambda exchange: admission.admit(exchange))
    handler = ServerOptions(handler, admission)
    handler = Scheduling(handler, stop)
    handler = TrustedHosts(handler, names)
    handler = ErrorResponses(handler, admission, pages, space)
    handler = Audit(handler, receipts, space)
    if authenticator is not None:
        handler = AccessHeaders(handler, authenticator, space)
    return CrossOriginHeaders(handler, names)


def query_service(
    services: Services, process: QueryProcess, materializer: Materializer, analyser: Analyser, unread: UnreadGraphs
) -> QueryService:
    """SPARQL over everything that the robot's resources say."""
    session, settings = services.session, services.session.settings
    limits = QuerySettings(
        settings.query_time_limit,
        settings.query_memory_limit,
        settings.query_row_limit,
        settings.query_concurrency,
        settings.query_queue,
    )
    restricted = RestrictedDatasets(process, lambda: IdentityKey(session.graph))
    past = RecordedPast(session, services.recordings)
    return QueryService(process, materializer, analyser, session.message_ages, limits, restricted, unread, past)


class Application:
    """One robot on the web: an ASGI application."""

    def __init__(
        self,
        session: Session,
        holds: Holds,
        clients: ClientLimiter,
        admission: Admission,
        broadcasters: Broadcasters,
        rooms: frozenset[str],
        http: ASGIApp,
        websockets: ASGIApp,
        lifespan: ASGIApp,
    ) -> None:
        self.session = session
        self._holds = holds
        self.clients = clients
        self.is_urgent = admission.is_urgent
        self.broadcasters = broadcasters
        self.rooms = rooms
        """The first segments of all paths that lead anywhere."""
        self._parts = {"http": http, "websocket": websockets, "lifespan": lifespan}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        await self._parts[scope["type"]](scope, receive, send)

    def end_streams(self) -> None:
        """End what would go on for ever, holds first.

        To be called when the server is told to end, before it waits for requests.
        """
        self._holds.close("rosld ended")
        self.broadcasters.close()


class HttpApplication:
    """The ASGI application of requests. `link` is a Link field of all answers."""

    def __init__(self, handler: Handler, clients: ClientLimiter, settings: Settings, link: str) -> None:
        self._handler = handler
        self._clients = clients
        self._body_limit = settings.body_limit
        self._body_timeout = settings.body_timeout
        self._link = (b"link", link.encode("latin-1"))

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        exchange = Exchange(Request(scope, receive), self._body_limit, self._body_timeout)
        try:
            response = await self._handler(exchange)
            response.raw_headers = [*response.raw_headers, self._link]
            await response(scope, receive, send)
        finally:
            self._clients.release(exchange.client)
