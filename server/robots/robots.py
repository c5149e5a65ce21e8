"""Several robots in one server: `/robots/NAME/` is one of them as if it were alone, the base is about all."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import logging
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import TypeAlias

from msgspec.structs import replace
from starlette.types import Receive, Scope, Send

from rosld.adapters.base import Adapter, AdapterOptions, Capabilities, Sink, Subscription
from rosld.adapters.model import (
    Encoding,
    Graph,
    NotFound,
    Operation,
    Ref,
    RosError,
    Schema,
    Stale,
    TypeRef,
    UnknownType,
)
from rosld.adapters.registry import RECORDING, adapter_for, installed, scheme_of, without_credentials
from rosld.ontology.urls import Space
from rosld.server.app import Application, create_app, shared_of
from rosld.server.auth.rules import Agent
from rosld.server.http.problem import Problem, one_line
from rosld.server.robot.interlock import StopState
from rosld.server.robots.federation import RobotsMaterializer, RobotsPermissions, RobotsUpdates, StopOfAll
from rosld.server.robots.resources import routes
from rosld.server.runtime.tasks import Signal
from rosld.server.runtime.version_cache import IdentityKey
from rosld.server.serving.lifespan import lifespan
from rosld.server.settings import Settings
from rosld.server.sparql.process.shared import RobotProcess, UnionCopy

_log = logging.getLogger("rosld")

OpenAdapter: TypeAlias = Callable[[str, AdapterOptions], Adapter]
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
_FIRST_SECONDS = 6.0
"""Seconds that the server waits at its start for robots to be opened."""
_PAUSE, _LONGEST_PAUSE = 1.0, 60.0
"""Seconds until a robot that could not be opened is tried again, doubled each time."""
MAX_ROBOTS = 64


def require_name(name: str) -> None:
    """Raise ValueError for a name that no robot can have."""
    if not _NAME.fullmatch(name):
        raise ValueError(f"{name!r} is not a robot's name: use at most 64 letters, digits, '_', '-' and '.'")


class NoRobot(Adapter):
    """The adapter of the base of a server of several robots, where there is no robot."""

    @property
    def capabilities(self) -> Capabilities:
        return Capabilities("robots", Encoding.CDR, writes=True, creates_topics=False, parameter_trees=False)

    @property
    def graph(self) -> Graph:
        return _NO_GRAPH

    async def open(self, sink: Sink, *, deadline: float) -> None:
        """Do nothing."""

    async def close(self) -> None:
        """Do nothing."""

    def allows(self, ref: Ref) -> frozenset[Operation]:
        return frozenset()

    async def schema(self, ref: TypeRef, *, deadline: float) -> Schema:
        raise UnknownType(f"there is no type {ref.name} at the base of several robots")

    def known_types(self) -> Sequence[TypeRef]:
        return ()

    async def subscribe(self, topic: str, *, depth: int = 1) -> Subscription:
        raise NotFound(f"there is no topic {topic} at the base of several robots")


_NO_GRAPH = Graph(1)


class Robot:
    """One robot of a server: its name, its source, its application while it is connected, or the reason if not."""

    def __init__(self, name: str, source: str, robots: Robots) -> None:
        self.name = name
        self.source = source
        self.url = f"{robots.base_url}robots/{name}/"
        self.app: Application | None = None
        self.problem = "it is being opened"
        self.stop_state: StopState | None = None
        """A stop that the robot gets as soon as it is connected."""
        self.tried = asyncio.Event()
        self._robots = robots
        self._removed = asyncio.Event()

    @property
    def union(self) -> UnionCopy:
        assert self.app is not None
        return self._union

    @property
    def shown_source(self) -> str:
        """The source without credentials."""
        return without_credentials(self.source)

    @property
    def trouble(self) -> str | None:
        """Why the robot cannot be reached, None if it can."""
        if self.app is None:
            return self.problem
        state = self.app.session.graph.state
        return state.why if isinstance(state, Stale) else None

    def require(self) -> Application:
        """Return the application. Raises a 503 Problem while there is none."""
        if self.app is None:
            raise Problem(503, f"{self.name} is not connected: {self.problem}.", headers={"Retry-After": "2"})
        return self.app

    def remove(self) -> None:
        """End the robot."""
        self._removed.set()

    def end_streams(self) -> None:
        """End unbounded responses, holds first."""
        if self.app is not None:
            self.app.end_streams()

    async def run(self) -> None:
        """Serve the robot until it is removed or this is cancelled; retry if it cannot be opened."""
        pause = _PAUSE
        while not self._removed.is_set():
            try:
                await self._serve()
            except (RosError, OSError, ValueError, RuntimeError) as error:
                self.problem = one_line(str(error)).rstrip(".") or type(error).__name__
                _log.warning("the robot %s cannot be opened, trying again in %g s: %s", self.name, pause, self.problem)
            except Exception as error:
                self.problem = "the server failed to open it; see its log"
                _log.exception("the robot %s cannot be opened", self.name, exc_info=error)
            self.tried.set()
            self._robots.changes.emit()
            with contextlib.suppress(asyncio.TimeoutError):
                await asyncio.wait_for(self._removed.wait(), pause)
            pause = min(_LONGEST_PAUSE, 2 * pause)

    async def _serve(self) -> None:
        robots = self._robots
        settings = robots.settings_of(self)
        adapter = robots.open_adapter(self.source, settings.adapter_options)
        process = RobotProcess(robots.shared.process)
        app = create_app(adapter, settings, replace(robots.shared, process=process, is_first=False))
        self._union = UnionCopy(robots.shared.process, process, self.url)
        try:
            async with lifespan(app):
                if self.stop_state is not None:
                    stopped, self.stop_state = self.stop_state, None
                    await app.parts.services.software_stop.stop(Agent(stopped.stopped_by), stopped.reason)
                signals = (
                    app.session.changes,
                    app.parts.services.faults.changes,
                    app.parts.services.software_stop.changes,
                )
                self.app, watches = app, [each.watch(robots.changes.emit) for each in signals]
                self.tried.set()
                robots.changes.emit()
                try:
                    await self._removed.wait()
                finally:
                    app.end_streams()
                    self.stop_state, self.app, self.problem = app.session.interlock.stop_state, None, "it has ended"
                    self._union.remove()
                    for each in watches:
                        each.close()
        finally:
            await adapter.close()


def _base_settings(settings: Settings) -> Settings:
    """Return the settings of the base: those about a robot apply to each robot instead."""
    return dataclasses.replace(
        settings,
        name=settings.name or "Robots",
        subscribe=(),
        history=(),
        mapping=(),
        shapes=(),
        stop_zero=(),
        stop_ready=False,
        store=None,
        store_query=None,
        store_update=None,
        store_credentials=None,
    )


class Robots:
    """The ASGI application of several robots. `open_adapter` returns the adapter of a source."""

    def __init__(self, sources: Mapping[str, str], settings: Settings, open_adapter: OpenAdapter = adapter_for) -> None:
        self.settings = settings
        for name, source in sources.items():
            require_name(name)
            open_adapter(source, settings.adapter_options)
        self.open_adapter = open_adapter
        self.changes = Signal()
        self._robots = {name: Robot(name, source, self) for name, source in sources.items()}
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self.shared = shared_of(settings)
        self.adapter = NoRobot()
        own = replace(
            self.shared,
            stop=StopOfAll(self),
            make_materializer=partial(RobotsMaterializer, self),
            make_updates=partial(RobotsUpdates, self),
            make_permissions=partial(RobotsPermissions, self),
            sections=("robots", "faults", "data", "queries"),
            types_version=lambda session: tuple(
                (each.name, None if each.app is None else IdentityKey(each.app.session.graph)) for each in self
            ),
        )
        self.base = create_app(self.adapter, _base_settings(settings), own)
        self.session, self.clients = self.base.session, self.base.clients
        self.metric_sources = self.base.metric_sources
        self.base.parts.router.routes = dict(routes(self, self.base.parts))
        self.base.mcp.connect(self)
        self._prefix = f"{self.space.path}robots/".encode("ascii")
        self._stop = re.compile(re.escape(self.space.path.encode("ascii")) + rb"(robots/[^/]+/)?stop")

    def __iter__(self) -> Iterator[Robot]:
        return iter(tuple(self._robots.values()))

    @property
    def base_url(self) -> str:
        """The base of the server."""
        return self.settings.base_url

    @property
    def space(self) -> Space:
        """The URLs at the base."""
        return self.session.space

    def get(self, name: str) -> Robot | None:
        """Return the robot of a name, None if there is none."""
        return self._robots.get(name)

    def at_url(self, url: str) -> Robot | None:
        """Return the robot that a URL belongs to, None if it belongs to the base."""
        begin = f"{self.base_url}robots/"
        name, slash, _ = url.removeprefix(begin).partition("/")
        return self._robots.get(name) if slash and url.startswith(begin) else None

    def is_urgent(self, method: bytes, path: bytes) -> bool:
        """Whether a request is exempt from all limits because it stops a robot, or all."""
        return method == b"POST" and self._stop.fullmatch(path) is not None

    def settings_of(self, robot: Robot) -> Settings:
        """Return the settings of a robot: those of the server, with its own name, base and data folder."""
        data = self.settings.data
        own = None if data is None else data / "robots" / robot.name
        if own is not None:
            own.mkdir(parents=True, exist_ok=True)
        return dataclasses.replace(self.settings, base_url=robot.url, name=robot.name, data=own)

    def add(self, name: str, source: str) -> Robot:
        """Add a robot, whose source is opened in the background. Raises ValueError, and Problem 409 for a used name."""
        require_name(name)
        if name in self._robots:
            raise Problem(409, f"There is a robot {name} already: {self._robots[name].url}")
        if len(self._robots) >= MAX_ROBOTS:
            raise Problem(409, f"There are {MAX_ROBOTS} robots, the maximum.")
        if scheme_of(source, frozenset(installed())) == RECORDING:
            words = "A recording is a file of the server, which clients must not choose: name it on the command line."
            raise Problem(403, words)
        self.open_adapter(source, self.settings.adapter_options)  # raises ValueError for an invalid source
        robot = self._robots[name] = Robot(name, source, self)
        self._start(robot)
        self.changes.emit()
        return robot

    async def remove(self, name: str) -> None:
        """Remove a robot, after its holds and streams have ended."""
        self._robots[name].remove()
        await asyncio.wait([self._tasks.pop(name)])
        self._robots.pop(name, None)
        self.changes.emit()

    def end_streams(self) -> None:
        """End unbounded responses, holds first."""
        for each in self:
            each.end_streams()
        self.base.end_streams()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self._run(receive, send)
            return
        app = self._app_at(scope["raw_path"], scope.get("method"))
        await app(scope, receive, send)

    def _app_at(self, path: bytes, method: str | None) -> Application:
        """Return the application for a path: that of a connected robot, or that of the base."""
        if not path.startswith(self._prefix):
            return self.base
        name, slash, rest = path[len(self._prefix) :].partition(b"/")
        robot = self._robots.get(name.decode("latin-1"))
        if robot is None or robot.app is None or not slash or (method == "DELETE" and not rest):
            return self.base
        return robot.app

    def _start(self, robot: Robot) -> None:
        self._tasks[robot.name] = asyncio.get_running_loop().create_task(robot.run())

    async def _run(self, receive: Receive, send: Send) -> None:
        await receive()
        async with lifespan(self.base):
            self.changes.watch(self.session.changes.emit)
            for each in self:
                self._start(each)
            with contextlib.suppress(asyncio.TimeoutError):
                await asyncio.wait_for(asyncio.gather(*(each.tried.wait() for each in self)), _FIRST_SECONDS)
            await send({"type": "lifespan.startup.complete"})
            await receive()
            for each in self:
                each.remove()
            if self._tasks:
                await asyncio.wait(self._tasks.values())
        await send({"type": "lifespan.shutdown.complete"})
