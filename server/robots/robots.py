"""Several robots in one server: `/robots/NAME/` is one of them as if it were alone, the base is about all."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import logging
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TypeAlias

import msgspec
from msgspec.structs import replace
from starlette.datastructures import Headers
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
from rosld.server.app import Application, create_app, shared_of
from rosld.server.auth.permissions import Permissions
from rosld.server.auth.rules import ROBOTS, Agent
from rosld.server.http.problem import Problem, one_line
from rosld.server.robot.interlock import StopState
from rosld.server.robots.federation import RobotsMaterializer, RobotsPast, RobotsPermissions, RobotsUpdates, StopOfAll
from rosld.server.robots.resources import routes
from rosld.server.runtime.dry_run import end_dry_run
from rosld.server.runtime.tasks import Signal
from rosld.server.runtime.version_cache import IdentityKey
from rosld.server.serving.lifespan import lifespan
from rosld.server.settings import Settings
from rosld.server.sparql.process.shared import RobotProcess, UnionCopy
from rosld.server.storage.files import write_note

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
        self.source, self.shown_source = source, without_credentials(source)
        self.url = f"{robots.settings.base_url}robots/{name}/"
        self.app: Application | None = None
        self.union: UnionCopy
        self.problem = "it is being opened"
        self.stop_state: StopState | None = None
        """A stop that the robot gets as soon as it is connected."""
        self.tried = asyncio.Event()
        self._robots = robots
        self.removed = asyncio.Event()

    @property
    def trouble(self) -> str | None:
        """Why the robot cannot be reached, None if it can."""
        if self.app is None:
            return self.problem
        state = self.app.session.graph.state
        return state.why if isinstance(state, Stale) else None

    def is_known_to(self, permissions: Permissions) -> bool:
        """Whether an agent may know of the robot: it may do something there."""
        return permissions.is_unrestricted or permissions.rights.may_know_in_subtree((ROBOTS, self.name))

    def require(self) -> Application:
        """Return the application. Raises a 503 Problem while there is none."""
        if self.app is None:
            words, retry = f"{self.name} is not connected: {self.problem}.", {"Retry-After": "2"}
            raise Problem(503, words, headers=retry, about=(self.url,))
        return self.app

    async def run(self) -> None:
        """Serve the robot until it is removed or this is cancelled; retry if it cannot be opened."""
        pause = _PAUSE
        while not self.removed.is_set():
            try:
                await self._serve()
            except (RosError, OSError, ValueError, RuntimeError) as error:
                self.problem = without_credentials(one_line(str(error)).rstrip(".")) or type(error).__name__
                _log.warning("the robot %s cannot be opened, trying again in %g s: %s", self.name, pause, self.problem)
            except Exception as error:
                self.problem = "the server failed to open it; see its log"
                _log.exception("the robot %s cannot be opened", self.name, exc_info=error)
            self.tried.set()
            self._robots.changes.emit()
            with contextlib.suppress(asyncio.TimeoutError):
                await asyncio.wait_for(self.removed.wait(), pause)
            pause = min(_LONGEST_PAUSE, 2 * pause)

    async def _serve(self) -> None:
        robots = self._robots
        settings = robots.settings_of(self)
        adapter = robots.open_adapter(self.source, settings.adapter_options)
        process = RobotProcess(robots.shared.process)
        app = create_app(adapter, settings, replace(robots.shared, process=process, is_first=False))
        self.union = UnionCopy(robots.shared.process, process, self.url)
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
                    await self.removed.wait()
                finally:
                    app.end_streams()
                    self.stop_state, self.app, self.problem = app.session.interlock.stop_state, None, "it has ended"
                    self.union.remove()
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


class AddedRobots:
    """The robots that clients added: their sources by name, in a file if the server has a data folder."""

    def __init__(self, folder: Path | None) -> None:
        self._file = None if folder is None else folder / "robots.json"
        self.sources = {} if self._file is None else self._read(self._file)
        self.lock = asyncio.Lock()

    @property
    def lost_at_end(self) -> Sequence[str]:
        """Names of the robots that are not kept over a restart."""
        return sorted(self.sources) if self._file is None else ()

    async def store(self, sources: dict[str, str]) -> None:
        """Replace the sources. Raises Problem 507 if that fails."""
        if self._file is not None and sources != self.sources:
            try:
                # Sources may contain passwords.
                await asyncio.to_thread(write_note, self._file, msgspec.json.encode(sources), 0o600)
            except OSError as error:
                raise Problem(507, f"The list of robots cannot be stored: {error.strerror}.") from error
        self.sources = sources

    def _read(self, file: Path) -> dict[str, str]:
        """Return the sources in the file; a damaged one is set aside."""
        try:
            found = msgspec.json.decode(file.read_bytes(), type=dict[str, str])
            for name in found:
                require_name(name)
        except FileNotFoundError:
            return {}
        except (OSError, ValueError, msgspec.MsgspecError) as error:
            aside = file.with_suffix(".damaged")
            with contextlib.suppress(OSError):
                file.replace(aside)
            _log.error("%s is damaged (%s): the robots that clients added are missing; see %s", file, error, aside)
            return {}
        return found


class Robots:
    """The ASGI application of several robots. `open_adapter` returns the adapter of a source."""

    def __init__(self, sources: Mapping[str, str], settings: Settings, open_adapter: OpenAdapter = adapter_for) -> None:
        self.settings = settings
        for name, source in sources.items():
            require_name(name)
            open_adapter(source, settings.adapter_options)
        self.open_adapter = open_adapter
        self.changes = Signal()
        self.added = AddedRobots(settings.data)
        for name in self.added.sources.keys() & sources:
            _log.warning(
                "the robot %s added by a client is replaced by the one that this server was started with", name
            )
        everything = {**sources, **self.added.sources, **sources}
        self._robots = {name: Robot(name, source, self) for name, source in everything.items()}
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
        queries = self.base.parts.sparql.queries
        queries.ages, queries.past, queries.transforms = self._message_ages, RobotsPast(self), None
        self.base.mcp.connect(self)
        self._prefix = f"{self.session.space.path}robots/".encode("ascii")
        self._stop = re.compile(re.escape(self.session.space.path.encode("ascii")) + rb"(robots/[^/]+/)?stop")

    def __iter__(self) -> Iterator[Robot]:
        return iter(tuple(self._robots.values()))

    def get(self, name: str) -> Robot | None:
        """Return the robot of a name, None if there is none."""
        return self._robots.get(name)

    def at_url(self, url: str) -> Robot | None:
        """Return the robot that a URL belongs to, None if it belongs to the base."""
        begin = f"{self.settings.base_url}robots/"
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

    async def add(self, name: str, source: str) -> Robot:
        """Add a robot, whose source is opened in the background. Raises ValueError, and Problem 409 for a used name."""
        require_name(name)
        if scheme_of(source, frozenset(installed())) == RECORDING:
            words = "A recording is a file of the server, which clients must not choose: name it on the command line."
            raise Problem(403, words)
        self.open_adapter(source, self.settings.adapter_options)  # raises ValueError for an invalid source
        async with self.added.lock:
            if name in self._robots:
                raise Problem(409, f"There is a robot {name} already.")
            if len(self._robots) >= MAX_ROBOTS:
                raise Problem(409, f"There are {MAX_ROBOTS} robots, the maximum.")
            end_dry_run(201)
            await self.added.store({**self.added.sources, name: source})
            robot = self._robots[name] = Robot(name, source, self)
            self._start(robot)
        self.changes.emit()
        return robot

    async def remove(self, name: str) -> None:
        """Remove a robot, after its holds and streams have ended. Raises Problem 404 if it was removed meanwhile."""
        end_dry_run(204)
        async with self.added.lock:
            if name not in self._robots:
                raise Problem(404, f"There is no robot {name} any more.")
            await self.added.store({other: source for other, source in self.added.sources.items() if other != name})
            self._robots[name].removed.set()
            await asyncio.wait([self._tasks.pop(name)])
            del self._robots[name]
        self.changes.emit()

    def _message_ages(self) -> Mapping[str, float]:
        """Return the seconds since the newest message of each topic of all robots, by URL."""
        return {url: age for each in self if each.app for url, age in each.app.session.message_ages().items()}

    def end_streams(self) -> None:
        """End unbounded responses, holds first."""
        for each in self:
            if each.app is not None:
                each.app.end_streams()
        self.base.end_streams()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self._run(receive, send)
            return
        app = await self._app_for(scope)
        await app(scope, receive, send)

    async def _app_for(self, scope: Scope) -> Application:
        """Return the application for a request: that of a connected robot, or that of the base.

        An agent that may do nothing at a robot gets the answer of the base, as for a robot that does not exist.
        WebSockets of channels need no credentials: their URLs are secrets.
        """
        path: bytes = scope["raw_path"]
        if not path.startswith(self._prefix):
            return self.base
        name, slash, rest = path[len(self._prefix) :].partition(b"/")
        robot = self._robots.get(name.decode("latin-1"))
        if robot is None or robot.app is None or not slash or (scope.get("method") == "DELETE" and not rest):
            return self.base
        app, authenticator = robot.app, self.base.parts.authenticator
        if authenticator is None or (scope["type"] == "websocket" and rest.startswith(b"channels/")):
            return app
        try:
            auth = await authenticator.authenticate(Headers(scope=scope).get("authorization"))
        except Problem:
            return self.base
        return app if robot.is_known_to(auth.permissions) else self.base

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
                each.removed.set()
            if self._tasks:
                await asyncio.wait(self._tasks.values())
        await send({"type": "lifespan.shutdown.complete"})
