"""The session with a robot: its adapter, its name, and the state of the system while it is served."""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import logging
import re
import socket
from collections.abc import Callable, Mapping
from fnmatch import fnmatchcase
from html import unescape
from urllib.parse import urlsplit

from rosld.adapters.base import Adapter
from rosld.adapters.model import ActionSchema, GoalEvent, GoalId, Graph, Kind, Live, RosError, Stale, TypeRef
from rosld.ontology.lift import LiftSettings
from rosld.ontology.urls import Space
from rosld.server.robot.audited_adapter import AuditedAdapter
from rosld.server.robot.calls import Calls
from rosld.server.robot.goals import Goals
from rosld.server.robot.interlock import WriteInterlock
from rosld.server.robot.live_topics import LiveTopics
from rosld.server.robot.schemas import Schemas
from rosld.server.robot.write_policy import PublishLimiter
from rosld.server.runtime.dry_run import is_dry_run
from rosld.server.runtime.tasks import Signal, WokenTask, loop_time
from rosld.server.settings import Settings

MAX_CALLS = 1000
"""Maximum number of calls under /calls/; the oldest is removed first."""
MAX_GOALS = 1000
"""Maximum number of goals under /goals/; the oldest ended goal is removed first."""
_MAX_NAME = 60
"""Maximum number of characters of a name."""
_PARAMETER = "/robot_name"
_DESCRIPTION = "robot_description"
_URDF_NAME = re.compile(r"<robot\b[^<>]{0,2000}?\sname\s*=\s*[\"']([^\"'<>]{1,200})[\"']")
_URDF_BEGIN = 20_000
"""Number of characters of a URDF in which its first element is searched."""


def shown_name(text: str) -> str:
    """Return a name for display: on one line, without invisible characters, and truncated."""
    return "".join(filter(str.isprintable, " ".join(text[: 4 * _MAX_NAME].split())))[:_MAX_NAME].strip()


def naming_parameters(graph: Graph) -> tuple[str, ...]:
    """Return the parameters of a graph that may name the robot, the best first."""
    described = sorted(name for name in graph.parameters if name.rpartition("/")[2] == _DESCRIPTION)
    return (*((_PARAMETER,) if _PARAMETER in graph.parameters else ()), *described[:1])


async def read_robot_name(adapter: Adapter, graph: Graph, *, deadline: float) -> str | None:
    """Return the name of the robot according to its parameters, None if they have none."""
    for name in naming_parameters(graph):
        try:
            value = (await adapter.get_parameters([name], deadline=deadline)).get(name)
        except RosError:
            continue
        if isinstance(value, str):
            found = _URDF_NAME.search(value[:_URDF_BEGIN]) if name != _PARAMETER else None
            text = value if name == _PARAMETER else unescape(found[1]) if found else ""
            if shown := shown_name(text):
                return shown
    return None


def host_name(uri: str | None) -> str:
    """Return the host name in a URI; the name of this machine for a loopback address or no URI."""
    host = (urlsplit(uri).hostname if uri is not None else None) or "localhost"
    try:
        is_here = ipaddress.ip_address(host).is_loopback
    except ValueError:
        is_here = host == "localhost"
    return shown_name(socket.gethostname() if is_here else host)


OPEN_SECONDS = 5.0

_log = logging.getLogger("rosld")


class Session:
    """The session of one adapter, and its `Sink`, which receives changes from any thread.

    `changes` is emitted when the graph or the permitted operations change, `parameter_changes` with the name of a
    parameter that was set.
    """

    def __init__(self, adapter: Adapter, settings: Settings) -> None:
        self.settings = settings
        self.space = Space(settings.base_url, settings.types_namespace)
        self.lifting = LiftSettings(settings.types_namespace, settings.inline_limit)
        self.interlock = WriteInterlock()
        self.adapter = AuditedAdapter(adapter, self.interlock, self.space)
        self.schemas = Schemas(adapter)
        self.topics = LiveTopics(self.adapter, self.schemas, settings)
        self.calls = Calls(
            self.adapter,
            lambda service: self.announce_write(Kind.SERVICE, service),
            limit=MAX_CALLS,
            age=settings.calls_age,
        )
        self.goals = Goals(
            self.adapter,
            self._action_schema,
            limit=MAX_GOALS,
            age=settings.goals_age,
            idle=settings.idle_time,
        )
        self.limiter = PublishLimiter(settings.max_publish_rate)
        self.changes = Signal()
        self.parameter_changes = Signal()
        self._write_listeners: list[Callable[[Kind, str], None]] = []
        self._follower = GraphFollower(self)

    @property
    def graph(self) -> Graph:
        """Latest known computation graph."""
        return self.adapter.graph

    @property
    def is_stopped(self) -> bool:
        """Whether the robot is stopped: all writes are refused, except those that stop it."""
        return self.interlock.stop_state is not None

    @property
    def name(self) -> str:
        """Name of the robot: `--name`, a recording's name, the robot's own, its host's, or the kind of system."""
        if self.settings.name:
            return shown_name(self.settings.name)
        if self.adapter.catalogue is not None:
            return "recordings"
        recordings = list(self.adapter.recordings)
        if recordings:
            return recordings[0]
        if self._follower.robot_name is not None:
            return self._follower.robot_name
        master, system = self.graph.master, self.adapter.capabilities.system
        return host_name(None if master is None else master.uri) if system.startswith("ROS") else system

    def message_age(self, url: str) -> float | None:
        """Return the age of the newest message of the topic at `url`, or None (thread-safe)."""
        location = self.space.location(url)
        if location is None or location.kind != "topics":
            return None
        view = self.topics.last_view(location.name)
        newest = None if view is None else view.newest
        return None if newest is None else self.adapter.age_ns(newest) / 1e9

    def message_ages(self) -> Mapping[str, float]:
        """Return the seconds since the newest message of each topic that has one, by the URLs of the topics."""
        urls = map(self.space.topic, self.topics.subscribed())
        return {url: age for url in urls if (age := self.message_age(url)) is not None}

    def is_resources_only(self, name: str) -> bool:
        """Whether a topic, service or parameter is written under /resources/ only."""
        return any(fnmatchcase(name, glob) for glob in self.settings.resources_only)

    def add_write_listener(self, listener: Callable[[Kind, str], None]) -> None:
        """Call a function with each topic, service or parameter that was written to (see `announce_write`)."""
        self._write_listeners.append(listener)

    def announce_write(self, kind: Kind, name: str) -> None:
        """Report a write, or a possible one, to a topic, a service or a parameter through rosld."""
        if is_dry_run():
            return
        for listener in self._write_listeners:
            listener(kind, name)

    async def open(self) -> None:
        """Open the adapter, unless it is open. Raises what `Adapter.open` raises."""
        self._follower.open()
        self.goals.start()
        await self.adapter.open(self, deadline=loop_time() + OPEN_SECONDS)
        self.topics.start()

    def follow(self) -> None:
        """Start to follow the graph, once open."""
        self._follower.start()

    async def close(self) -> None:
        """Release everything on the robot. Idempotent."""
        await self._follower.stop()
        await self.calls.stop()
        await self.goals.stop()
        await self.topics.stop()
        await self.adapter.close()

    def graph_changed(self, graph: Graph) -> None:
        """Handle a change of the graph (`Sink`)."""
        self._follower.call_soon(self._follower.on_graph_changed)

    def goal_changed(self, goal: GoalId, event: GoalEvent) -> None:
        """Handle an update about a goal (`Sink`)."""
        self.goals.on_event(goal, event)

    def parameter_changed(self, name: str) -> None:
        """Wake the watches of a parameter (`Sink`). Reads of its value are never cached."""
        self._follower.call_soon(lambda: self.parameter_changes.emit(name))

    def _action_schema(self, name: str) -> ActionSchema | None:
        action = self.graph.actions.get(name)
        if action is None or action.type is None:
            return None
        found = self.schemas.find_similar(action.type)
        return found if isinstance(found, ActionSchema) else None


class GraphFollower:
    """Follower of a session's graph: subscribes to eager topics, loads types, and logs losing and finding the robot."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._following = WokenTask(self._follow)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._is_stale = False
        self.robot_name: str | None = None
        """Name according to the robot's parameters, once known."""

    def open(self) -> None:
        """Use the running loop to announce changes."""
        self._loop = asyncio.get_running_loop()

    def call_soon(self, callback: Callable[[], None]) -> None:
        """Call it on the loop (thread-safe); do nothing before or after there is one."""
        if self._loop is not None and not self._loop.is_closed():
            with contextlib.suppress(RuntimeError):
                self._loop.call_soon_threadsafe(callback)

    def on_graph_changed(self) -> None:
        """Process a possibly changed graph."""
        self._log_state()
        self._following.wake()
        self._session.changes.emit()

    def start(self) -> None:
        """Start following, beginning with the current graph."""
        self._log_state()
        self._following.start()

    async def stop(self) -> None:
        """Stop following. Idempotent."""
        await self._following.stop()

    def _log_state(self) -> None:
        """Log when the robot becomes invisible or visible."""
        graph = self._session.graph
        match graph.state:
            case Stale(_, why) if not self._is_stale:
                _log.warning("the robot cannot be reached, waiting for it: %s", why)
            case Live() if self._is_stale:
                _log.info("connected to the robot: %d nodes, %d topics", len(graph.nodes), len(graph.topics))
        self._is_stale = isinstance(graph.state, Stale)

    async def _follow(self) -> None:
        graph = self._session.graph
        await self._learn_name(graph)
        await self._session.topics.subscribe_eager(graph)
        for ref in used_types(graph):
            with contextlib.suppress(RosError, asyncio.TimeoutError):
                await self._session.schemas.get(ref)

    async def _learn_name(self, graph: Graph) -> None:
        if self.robot_name is None and naming_parameters(graph):
            self.robot_name = await read_robot_name(self._session.adapter, graph, deadline=loop_time() + OPEN_SECONDS)
            if self.robot_name is not None:
                self._session.changes.emit()


def used_types(graph: Graph) -> list[TypeRef]:
    """Return every type of a topic, a service or an action in the graph."""
    refs = {ref: None for topic in graph.topics.values() for ref in topic.types}
    refs |= {service.type: None for service in graph.services.values() if service.type is not None}
    refs |= {action.type: None for action in graph.actions.values() if action.type is not None}
    return list(refs)
