"""The robot as the server holds it: the adapter, and beside it everything that one run of the server remembers."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import secrets
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase

from rosld.adapters.base import Adapter
from rosld.adapters.model import ActionSchema, GoalEvent, GoalId, Graph, Kind, RosError, TypeRef
from rosld.ontology.lift import LiftSettings
from rosld.ontology.urls import Space
from rosld.server.accounted import Accounted
from rosld.server.calls import Calls
from rosld.server.events.watches import Signal
from rosld.server.gate import Gate
from rosld.server.goals import Goals
from rosld.server.holds import Holds
from rosld.server.http.csrf import FormKey
from rosld.server.hypermedia.mappings import Mappings
from rosld.server.hypermedia.offers import Offers
from rosld.server.hypermedia.readings import Readings
from rosld.server.hypermedia.value import WHOLE
from rosld.server.in_force import limits, mappings, queries
from rosld.server.in_force.limits import LimitsInForce, given_limits
from rosld.server.in_force.mappings import given_mappings, keep_mappings
from rosld.server.ldp.state import State
from rosld.server.limiter import PublishLimiter
from rosld.server.live.schemas import Schemas
from rosld.server.live.topics import LiveSettings, LiveTopics
from rosld.server.loop_time import loop_time
from rosld.server.offload import Workers
from rosld.server.receipts.journal import Journal
from rosld.server.records import Changed
from rosld.server.records.sqlite import open_records
from rosld.server.settings import Settings
from rosld.server.sparql.syntax.lexer import Bounds
from rosld.server.stops import Stops
from rosld.shapes.limits import Limits

OPEN_SECONDS = 5.0


class Robot:
    """One adapter being served. Also the adapter's `Sink`: told of changes, from any thread."""

    def __init__(self, adapter: Adapter, settings: Settings) -> None:
        self.gate = Gate()
        self.gated = Accounted(adapter, self.gate, Space(settings.base_url, settings.types_namespace))
        self.adapter: Adapter = self.gated
        self.settings = settings
        self.space = Space(settings.base_url, settings.types_namespace)
        self.lifting = LiftSettings(settings.types_namespace, settings.inline_limit)
        self.whole = replace(self.lifting, inline_limit=WHOLE.inline_limit)
        self.schemas = Schemas(adapter)
        live = LiveSettings(
            settings.first_value_wait, settings.idle_time, settings.subscription_budget, tuple(settings.subscribe)
        )
        self.topics = LiveTopics(adapter, self.schemas, live)
        self.calls = Calls(
            self.adapter,
            lambda service: self.written(Kind.SERVICE, service),
            most=settings.calls_kept,
            age=settings.calls_age,
        )
        self.goals = Goals(
            self.adapter, self._action_schema, most=settings.goals_kept, age=settings.goals_age, idle=settings.idle_time
        )
        self.limiter = PublishLimiter(settings.max_publish_rate)
        self.forms = FormKey()
        self.states = States()
        self.workers = Workers()
        self.changes = Signal()
        self.parameter_changes = Signal()
        self.limits_in_force = LimitsInForce(tuple(given_limits(settings, adapter, self.space)), self.space)
        self.records = open_records(settings.data, roots=(mappings.ROOM, queries.ROOM, limits.ROOM))
        self.receipts = Journal(
            settings.data,
            most=settings.receipts_kept,
            age=settings.receipts_age,
            excerpt_bytes=settings.receipt_excerpt,
        )
        self.kept_changes = Signal()
        self.queries = queries.Queries(self.records, self.space, Bounds(size=settings.query_size_limit))
        self.mappings = Mappings()
        self.mapping_turn = asyncio.Lock()
        self._given = tuple(given_mappings(settings, adapter, self.space))
        for document in self._given:
            self.mappings.replace(document)
        self.readings = Readings(
            adapter,
            self.topics,
            self.schemas,
            self.space,
            freshness=settings.freshness,
            patience=settings.call_deadline,
        )
        self.offers = Offers(self)
        self.holds = Holds(self)
        self.stops = Stops(self)
        self.boot = secrets.token_hex(4)
        self._changed = asyncio.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._follower: asyncio.Task[None] | None = None

    @property
    def graph(self) -> Graph:
        """The computation graph as last known."""
        return self.adapter.graph

    @property
    def name(self) -> str:
        """What people call it: a recording's name, a master's address, else the kind of system."""
        recordings = list(self.adapter.recordings)
        if recordings:
            return recordings[0]
        master = self.graph.master
        return master.uri.partition("//")[2].rstrip("/") if master else self.adapter.capabilities.system

    def seconds_since(self, url: str) -> float | None:
        """How long ago the newest message of the topic at `url` was received, None where none was; from any thread."""
        location = self.space.location(url)
        if location is None or location.kind != "topics":
            return None
        view = self.topics.last_seen(location.name)
        newest = None if view is None else view.newest
        return None if newest is None else self.adapter.age_ns(newest) / 1e9

    def ages(self) -> Mapping[str, float]:
        """The seconds since the newest message of each topic that has one, by the URLs of the topics."""
        urls = map(self.space.topic, self.topics.subscribed())
        return {url: age for url in urls if (age := self.seconds_since(url)) is not None}

    @property
    def revision(self) -> Hashable:
        """Another one whenever anything has changed but values and what clients keep."""
        return (
            Same(self.adapter.graph),
            self.schemas.count,
            self.calls.revision,
            self.goals.revision,
            self.holds.revision,
            self.stops.revision,
            self.queries.version,
            Same(self.limits_in_force.now),
            Same(self.mappings.arrangement),
        )

    @property
    def storage_problems(self) -> tuple[str, ...]:
        """Why not everything can be stored just now, in sentences; none where it can."""
        found = (self.records.trouble, self.receipts.trouble)
        return tuple(problem for problem in found if problem is not None)

    @property
    def limits(self) -> Limits:
        """The limits on what is written that are in force now."""
        return self.limits_in_force.now

    def is_closed(self, name: str) -> bool:
        """Whether a topic, service or parameter is written under /resources/ only."""
        return any(fnmatchcase(name, glob) for glob in self.settings.resources_only)

    def written(self, kind: Kind, name: str) -> None:
        """Something was written to a topic, a service or a parameter through rosld, or may have been."""
        self.offers.written(kind, name)

    def deadline(self, seconds: float) -> float:
        """The loop time so many seconds from now."""
        return loop_time() + seconds

    async def start(self) -> None:
        """Open the adapter unless it is, and follow its graph. Raises what `Adapter.open` raises."""
        self._loop = asyncio.get_running_loop()
        self.goals.start()
        await self.adapter.open(self, deadline=self.deadline(OPEN_SECONDS))
        self.topics.start()
        self.records.watch(self._kept)
        self.receipts.start()
        self.limits_in_force.begin(self.records)
        await keep_mappings(self.mappings, self._given, self.records, self.settings, self.space)
        self._changed.set()
        gc.collect()
        gc.freeze()  # what is loaded now stays: looking through it again and again would hold everybody up
        self._follower = self._loop.create_task(self._follow())

    async def stop(self) -> None:
        """Give everything back to the robot; idempotent."""
        self.holds.close("rosld ended")
        await self.workers.close()
        await self.holds.closed()
        await self.stops.ended()
        await self.receipts.close()
        if self._follower is not None:
            self._follower.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._follower
        await self.calls.stop()
        await self.goals.stop()
        await self.readings.stop()
        await self.topics.stop()
        await self.adapter.close()
        await self.records.close()

    def graph_changed(self, graph: Graph) -> None:
        """`Sink`: look at what the graph now holds."""
        if self._loop is not None and not self._loop.is_closed():
            with contextlib.suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self._moved)

    def goal_changed(self, goal: GoalId, event: GoalEvent) -> None:
        """`Sink`: what became known of a goal."""
        self.goals.hear(goal, event)

    def parameter_changed(self, name: str) -> None:
        """`Sink`: tell those who watch it. Whoever asks reads it anew in any case."""
        if self._loop is not None and not self._loop.is_closed():
            with contextlib.suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self.parameter_changes.give, name)

    def _action_schema(self, name: str) -> ActionSchema | None:
        """The schema of an action of the graph, as far as it is at hand."""
        action = self.graph.actions.get(name)
        if action is None or action.type is None:
            return None
        found = self.schemas.at_hand(action.type) or self.schemas.named(action.type.name)
        return found if isinstance(found, ActionSchema) else None

    def _moved(self) -> None:
        self._changed.set()
        self.changes.give()
        self.holds.end_refused()

    def _kept(self, changes: Sequence[Changed]) -> None:
        for each in changes:
            self.queries.changed(each)
            self.kept_changes.give(each.path)

    async def _follow(self) -> None:
        """After each change: subscribe to what is to be eager, and learn the types in use, so that they are listed."""
        while True:
            await self._changed.wait()
            self._changed.clear()
            graph = self.graph
            await self.topics.eager(graph)
            for ref in used_types(graph):
                with contextlib.suppress(RosError, asyncio.TimeoutError):
                    await self.schemas.find(ref)


def used_types(graph: Graph) -> list[TypeRef]:
    """Every type that a topic, a service or an action of the graph has."""
    refs = {ref: None for topic in graph.topics.values() for ref in topic.types}
    refs |= {service.type: None for service in graph.services.values() if service.type is not None}
    refs |= {action.type: None for action in graph.actions.values() if action.type is not None}
    return list(refs)


@dataclass(slots=True)
class States:
    """States that are made once for each version of what they show; the oldest go first."""

    most: int = 4096
    _kept: dict[str, tuple[Hashable, State]] = field(default_factory=dict)

    def known(self, url: str, version: Hashable) -> State | None:
        """The state kept of a resource, if it is of this version."""
        kept = self._kept.get(url)
        return kept[1] if kept is not None and kept[0] == version else None

    def keep(self, url: str, version: Hashable, state: State) -> State:
        """Keep a state; returns it."""
        self._kept.pop(url, None)
        self._kept[url] = (version, state)
        if len(self._kept) > self.most:
            self._kept.pop(next(iter(self._kept)))
        return state

    def clear(self) -> None:
        """Make all of them anew from now on."""
        self._kept.clear()

    def get(self, url: str, version: Hashable, make: Callable[[], State]) -> State:
        """The state of a resource at this version: kept, or made now."""
        return self.known(url, version) or self.keep(url, version, make())


class Same:
    """Compares by identity: a version that costs nothing to compare."""

    __slots__ = ("value",)

    def __init__(self, value: object) -> None:
        self.value = value

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Same) and other.value is self.value

    def __hash__(self) -> int:
        return id(self.value)
