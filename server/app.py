"""The application: composes the layers into one ASGI app, without logic of its own."""

from __future__ import annotations

import asyncio
import os
import time
from collections import Counter
from collections.abc import Callable, Hashable, Mapping, Sequence
from functools import partial
from urllib.parse import urlsplit

from msgspec import Struct, field
from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from rosld.adapters.base import Adapter
from rosld.server.auth.authenticator import Authenticator
from rosld.server.auth.permissions import Permissions
from rosld.server.auth.rate_limit import ClientLimiter, ClientLimits
from rosld.server.dataset.replication import Mirror
from rosld.server.events.broadcaster import Broadcasters
from rosld.server.events.notification_channels import Channels
from rosld.server.foxglove.endpoint import FoxgloveService
from rosld.server.html.frame import prepare_pages
from rosld.server.html.site import SECTIONS
from rosld.server.http.fields import render_links
from rosld.server.http.origin import FormKey, OriginPolicy, origin_policy
from rosld.server.mcp.endpoint import Mcp, McpService
from rosld.server.mcp.transport import LocalTransport
from rosld.server.middleware import Handler
from rosld.server.middleware.access import (
    AccessHeaders,
    Authentication,
    CrossOriginHeaders,
    Preflight,
    RejectTokensInUrls,
    TrustedHosts,
)
from rosld.server.middleware.audit import Audit
from rosld.server.middleware.dispatch import Dispatch, ErrorResponses, ServerOptions, WebSockets
from rosld.server.middleware.limits import Admission, RateLimits, RequestScheduler, Scheduling
from rosld.server.middleware.monitor import Monitor, Traced
from rosld.server.policies.stored_mappings import log_mapping_warnings
from rosld.server.resources.acl import AboutResources, AclResource, types_at
from rosld.server.resources.bag_routes import bag_route
from rosld.server.resources.base import Services
from rosld.server.resources.channels import Notifications, fixed_resources
from rosld.server.resources.channels import routes as notification_routes
from rosld.server.resources.entry_point import StatusResource
from rosld.server.resources.frames import FramesResource
from rosld.server.resources.health import HealthResource, ReadinessResource
from rosld.server.resources.ldp.record_graphs import RecordGraphs
from rosld.server.resources.metrics import MetricSources, MetricsResource
from rosld.server.resources.mirror import ReplicationResource, create_mirror
from rosld.server.resources.past_messages import RecordedPast
from rosld.server.resources.plot import PlotResource
from rosld.server.resources.recording_trigger import RecordingTriggers
from rosld.server.resources.space import GoalTargets, SpaceResource
from rosld.server.resources.sparql_update.service import UpdateService
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.large import LargeDocuments
from rosld.server.rest.pages import PageRenderer
from rosld.server.rest.resource import Resource
from rosld.server.robot.interrupted_holds import InterruptedHolds
from rosld.server.robot.scene import Scene
from rosld.server.robot.session import Session
from rosld.server.robot.software_stop import SoftwareStop
from rosld.server.routing.dispatcher import Dispatcher
from rosld.server.routing.live_graphs import OTHER_ROUTES, RobotGraphs
from rosld.server.routing.router import Router, single_route
from rosld.server.runtime.tasks import KeyedLock
from rosld.server.runtime.timings import RequestTimings
from rosld.server.runtime.tracing import tracing_of
from rosld.server.runtime.version_cache import IdentityKey
from rosld.server.runtime.watchdog import Watchdog
from rosld.server.serving.lifespan import Job, Lifespan
from rosld.server.settings import Settings
from rosld.server.sparql.analysis import Analyser
from rosld.server.sparql.materializer import Materializer
from rosld.server.sparql.process.client import QueryProcess
from rosld.server.sparql.query_limits import Limits
from rosld.server.sparql.query_service import QueryService
from rosld.server.sparql.receipt_graphs import ReceiptGraphs
from rosld.server.sparql.restricted import RestrictedDatasets
from rosld.server.sparql.syntax.lexer import ServiceAllowlist
from rosld.server.sparql.update.base import UpdateRunner


class Shared(Struct, frozen=True, kw_only=True):
    """State that the applications of a server share. `root` is the base of the server: rules are about paths below it.

    `stop`, `make_materializer` and `make_permissions` replace those of a single robot.
    """

    root: str
    process: QueryProcess
    clients: ClientLimiter
    is_first: bool = True
    """Whether this application starts the watchdog, and answers probes without authentication."""
    watchdog: Watchdog = field(default_factory=Watchdog)
    turns: RequestScheduler = field(default_factory=RequestScheduler)
    readers: Counter[str | None] = field(default_factory=Counter)
    keys: FormKey = field(default_factory=FormKey)
    stop: SoftwareStop | None = None
    make_materializer: Callable[..., Materializer] = Materializer
    make_updates: Callable[[UpdateRunner], UpdateRunner] = lambda own: own
    make_permissions: Callable[..., Permissions] = Permissions
    sections: tuple[str, ...] = (*SECTIONS, "bags")
    types_version: Callable[[Session], Hashable] = lambda session: IdentityKey(session.graph)
    """Version of the types of resources, which rules can depend on."""


def shared_of(settings: Settings) -> Shared:
    """Return what applications share, for the only application of a server or the first of several."""
    process = QueryProcess(settings.query_concurrency, settings.query_queue)
    return Shared(root=settings.base_url, process=process, clients=client_limiter(settings))


class SparqlServices:
    """Queries and updates over the states of the robot's resources, in a separate process."""

    def __init__(self, services: Services, scene: Scene, shared: Shared) -> None:
        session, space, settings = services.session, services.space, services.settings
        self._services = services
        self.process = shared.process
        self.graphs = RobotGraphs(services)
        """Source of the dataset."""
        record_graphs = RecordGraphs(services.documents.records, space.base, services.queries.description, OTHER_ROUTES)
        self.materializer = shared.make_materializer(
            self.process, self.graphs, record_graphs, ReceiptGraphs(services.receipts, space)
        )
        self._analyser = Analyser(space.base, space.types, reach=ServiceAllowlist(frozenset(settings.allow_service)))
        self.queries = services.sparql = QueryService(
            self.process,
            self.materializer,
            self._analyser,
            session.message_ages,
            _limits(settings),
            RestrictedDatasets(self.process, partial(shared.types_version, session)),
            RecordedPast(session, services.recordings),
            scene.frames.settle,
        )

    def updates(self, keyed_lock: KeyedLock) -> UpdateService:
        """Return the runner of updates."""
        return UpdateService(self._services, self._analyser, keyed_lock)


def _limits(settings: Settings) -> Limits:
    return Limits(
        settings.query_time_limit,
        settings.query_memory_limit,
        settings.query_row_limit,
        settings.query_concurrency,
        settings.query_queue,
    )


def create_app(adapter: Adapter, settings: Settings, shared: Shared | None = None) -> Application:
    """Return the ASGI app for this adapter; its lifespan opens and closes the adapter, raising the errors of `open`."""
    shared = shared or shared_of(settings)
    services = Services(adapter, settings, shared.stop)
    session, space = services.session, services.space
    scene, watchdog = Scene(session), shared.watchdog
    sparql = SparqlServices(services, scene, shared)
    large = LargeDocuments(services.documents.workers)
    pages = PageRenderer(session, services.software_stop, large, services.receipts, shared.keys, shared.sections)
    names = origin_policy(settings.base_url, settings.host, settings.port, settings.cors_origins)
    broadcasters = Broadcasters(session.changes, settings.client_streams, shared.readers)
    keyed_lock = KeyedLock(settings.call_deadline)
    router = Router(services, pages, lambda: shared.make_updates(sparql.updates(keyed_lock)))
    mirror = create_mirror(session, services.instance_id, sparql.process, sparql.materializer, router.route_names)
    notifications = Notifications(services, broadcasters, names, router.resolve)
    router.add(notification_routes(notifications, router.routes[".well-known"]))
    views: dict[str, Callable[[], PlotResource | SpaceResource]] = {
        "plot": partial(PlotResource, services, broadcasters),
        "space": partial(SpaceResource, services, scene, broadcasters, GoalTargets(services)),
    }
    changing: dict[str, Callable[[], Resource]] = {
        "status": partial(StatusResource, services, watchdog),
        **({} if mirror is None else {"mirror": partial(ReplicationResource, space, mirror)}),
    }
    frames = partial(FramesResource, services, scene)
    own: dict[str, Callable[[], Resource]] = {**views, **changing, "frames": frames}
    router.add({name: single_route(make) for name, make in own.items()})
    fixed = (router.endpoint, router.graphs, router.search, *(make() for make in views.values()))
    described = {each.url: each.document for each in (*fixed_resources(notifications), *fixed)}
    sparql.graphs.add(described, [router.at(f"/{name}") for name in changing])
    authenticator = create_authenticator(services, notifications.channels, shared)
    if authenticator is not None:
        authenticator.changed.watch(broadcasters.wake_all)
        router.add({"acl": single_route(partial(AclResource, space, authenticator))})
    triggers = RecordingTriggers(services, authenticator)
    router.add({"bags": partial(bag_route, services, triggers=triggers)})
    dispatcher = Dispatcher(services, pages, broadcasters, keyed_lock, large)
    clients = shared.clients
    admission = Admission(clients, f"{space.path}stop".encode("ascii"))
    mcp = McpService(space, settings)
    health, ready = HealthResource(space), ReadinessResource(session, lambda: sparql.process.is_running)
    router.add({"healthz": single_route(lambda: health), "readyz": single_route(lambda: ready)})
    timings = RequestTimings(space.path, lambda: router.route_names | {"mcp"})
    sources = MetricSources(services, sparql.process, timings, watchdog, clients, broadcasters)
    router.add({"metrics": single_route(partial(MetricsResource, sources))})
    parts = Parts(services, router, sparql, authenticator)
    handler = middleware(parts, dispatcher, pages, names, admission, mcp, shared.turns)
    tracing = tracing_of(os.environ)
    if tracing is not None:
        handler = Traced(handler, tracing, timings)
    monitor = Monitor(timings, logs=settings.log_format == "json")
    link = render_links([notifications.link])
    probes = (health, ready) if shared.is_first else ()  # those of one of several robots need authentication
    http = HttpApplication(handler, clients, settings, link, monitor, probes)
    mcp.connect(http)
    foxglove = FoxgloveService(session, broadcasters, authenticator, LocalTransport(http), services.instance_id)
    return Application(
        parts,
        sources,
        admission,
        mcp,
        http,
        WebSockets(names, admission, notifications, {foxglove.path: foxglove.receiver}),
        Lifespan(
            services.start,
            services.stop,
            sparql.process,
            watchdog if shared.is_first else None,
            background_jobs(services, sparql, mirror, authenticator, triggers),
            [
                mcp.close,
                *(() if mirror is None else (mirror.close,)),
                large.close,
                scene.frames.stop,
                *(() if tracing is None else (tracing.close,)),
            ],
        ),
    )


def background_jobs(
    services: Services,
    sparql: SparqlServices,
    mirror: Mirror | None,
    authenticator: Authenticator | None,
    triggers: RecordingTriggers,
) -> Sequence[Job]:
    """Return the jobs that run in the background from start to end."""
    return [
        sparql.materializer.stored.run,
        partial(asyncio.to_thread, prepare_pages),
        partial(log_mapping_warnings, services.affordances, services.mappings),
        triggers.resume,
        InterruptedHolds(services.session, services.holds, services.receipts.add).run,
        *(() if mirror is None else (mirror.run,)),
        *(() if authenticator is None else (authenticator.watch_file,)),
    ]


def create_authenticator(services: Services, channels: Channels, shared: Shared) -> Authenticator | None:
    """Return the authenticator for the file of `--auth`; None without one."""
    session = services.session
    if session.settings.auth is None:
        return None
    about, types = AboutResources(services, channels), partial(types_at, services)
    return Authenticator(session.settings.auth, session.space, types, about, shared.root, shared.make_permissions)


def client_limiter(settings: Settings) -> ClientLimiter:
    """Return the limits of each client according to the settings."""
    allowance = ClientLimits(
        settings.client_rate, settings.client_requests, settings.client_connections, settings.client_websockets
    )
    return ClientLimiter(allowance, loopback=settings.limit_loopback)


def middleware(
    parts: Parts,
    dispatcher: Dispatcher,
    pages: PageRenderer,
    names: OriginPolicy,
    admission: Admission,
    mcp: McpService,
    turns: RequestScheduler,
) -> Handler:
    """Return the middleware stack, built from the innermost to the outermost."""
    space, router, authenticator = parts.services.space, parts.router, parts.authenticator
    stop = f"{space.path}stop".encode("ascii")
    handler: Handler = Dispatch(router.resolve, dispatcher)
    if authenticator is None:
        handler = Preflight(handler, names, lambda exchange: router.resolve(exchange.request.scope))
    handler = RateLimits(handler, admission)
    handler = RejectTokensInUrls(handler, space)
    if authenticator is not None:
        handler = Authentication(handler, authenticator, space)
        # A preflight request never has credentials, so it is answered without data before authentication.
        handler = Preflight(handler, names, lambda exchange: admission.admit(exchange))
    handler = Mcp(handler, mcp, names, admission, authenticator)
    handler = ServerOptions(handler, admission)
    handler = Scheduling(handler, stop, turns)
    handler = TrustedHosts(handler, names)
    handler = ErrorResponses(handler, admission, pages, space)
    handler = Audit(handler, parts.services.receipts, space)
    if authenticator is not None:
        handler = AccessHeaders(handler, authenticator, space)
    return CrossOriginHeaders(handler, names)


class Parts(Struct, frozen=True):
    """The parts of an application that others use: a server of several robots."""

    services: Services
    router: Router
    sparql: SparqlServices
    authenticator: Authenticator | None


class Application:
    """One robot on the web: an ASGI application."""

    def __init__(
        self,
        parts: Parts,
        metric_sources: MetricSources,
        admission: Admission,
        mcp: McpService,
        http: ASGIApp,
        websockets: ASGIApp,
        lifespan: ASGIApp,
    ) -> None:
        self.parts = parts
        self.session = parts.services.session
        self.metric_sources = metric_sources
        self.clients = metric_sources.clients
        self.is_urgent = admission.is_urgent
        self.broadcasters = metric_sources.broadcasters
        self.rooms = parts.router.route_names
        """First segments of all paths."""
        self.mcp = mcp
        self._parts = {"http": http, "websocket": websockets, "lifespan": lifespan}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        await self._parts[scope["type"]](scope, receive, send)

    def end_streams(self) -> None:
        """End unbounded responses, holds first.

        Call this when the server is to stop, before it waits for requests.
        """
        self.parts.services.holds.close("rosld ended")
        self.mcp.end()
        self.broadcasters.close()


class HttpApplication:
    """The ASGI application for requests. `link` is a Link field of all responses.

    `probes` are answered without authentication, limits and checks of Host: probes know only an address.
    """

    def __init__(
        self,
        handler: Handler,
        clients: ClientLimiter,
        settings: Settings,
        link: str,
        monitor: Monitor,
        probes: Sequence[HealthResource],
    ) -> None:
        self._handler = handler
        self._monitor = monitor
        self._probes: Mapping[bytes, HealthResource] = {urlsplit(each.url).path.encode(): each for each in probes}
        self._clients = clients
        self._body_limit = settings.body_limit
        self._body_timeout = settings.body_timeout
        self._link = (b"link", link.encode("latin-1"))

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        started, monitor = time.perf_counter(), self._monitor
        exchange = Exchange(Request(scope, receive), self._body_limit, self._body_timeout)
        probe = self._probes.get(scope["raw_path"])
        if probe is not None and scope["method"] in ("GET", "HEAD"):
            await probe.answer(exchange.accept)(scope, receive, send)
            return
        monitor.timings.current += 1
        if monitor.logs:
            monitor.start(exchange)
        try:
            response = await self._handler(exchange)
            more = monitor.answered(exchange, response, time.perf_counter() - started)
            response.raw_headers = [*response.raw_headers, self._link, *more]
            await response(scope, receive, send)
        finally:
            monitor.timings.current -= 1
            self._clients.release(exchange.client)
