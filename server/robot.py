"""The robot as the server holds it: the adapter, and beside it everything that one run of the server remembers."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import logging
import secrets
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase

from pyoxigraph import RdfFormat, parse

from rosld.adapters.base import Adapter
from rosld.adapters.model import Graph, Kind, RosError, TypeRef
from rosld.ontology.body import indexed
from rosld.ontology.lift import LiftSettings
from rosld.ontology.urls import Space
from rosld.server.calls import Calls
from rosld.server.events.watches import Signal
from rosld.server.http.csrf import FormKey
from rosld.server.hypermedia.documents import MappingDocument, load_mapping, mapping_of
from rosld.server.hypermedia.mappings import Mappings
from rosld.server.hypermedia.offers import Offers
from rosld.server.hypermedia.readings import Readings
from rosld.server.hypermedia.value import WHOLE
from rosld.server.ldp.state import State
from rosld.server.limiter import PublishLimiter
from rosld.server.live.schemas import Schemas
from rosld.server.live.topics import LiveSettings, LiveTopics
from rosld.server.records import Changed, Model, Put, Record
from rosld.server.records.describe import written
from rosld.server.records.sqlite import open_records
from rosld.server.settings import Settings
from rosld.shapes.limits import Limits, read_limits

OPEN_SECONDS = 5.0
_log = logging.getLogger("rosld")


class Robot:
    """One adapter being served. Also the adapter's `Sink`: told of changes, from any thread."""

    def __init__(self, adapter: Adapter, settings: Settings) -> None:
        self.adapter = adapter
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
            adapter,
            lambda service: self.written(Kind.SERVICE, service),
            most=settings.calls_kept,
            age=settings.calls_age,
        )
        self.limiter = PublishLimiter(settings.max_publish_rate)
        self.forms = FormKey()
        self.states = States()
        self.changes = Signal()
        self.parameter_changes = Signal()
        self.limits = limits_of(settings, adapter, self.space)
        self.records = open_records(settings.data, roots=("mappings/",))
        self.kept_changes = Signal()
        self.mappings = Mappings()
        self.mapping_turn = asyncio.Lock()
        self._given = tuple(documents_of(settings, adapter, self.space))
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

    def received_ns(self, url: str) -> int | None:
        """When the newest message of the topic at `url` was received, None where none was; from any thread."""
        location = self.space.location(url)
        if location is None or location.kind != "topics":
            return None
        view = self.topics.last_seen(location.name)
        return view.newest.received_ns if view is not None and view.newest is not None else None

    def is_closed(self, name: str) -> bool:
        """Whether a topic, service or parameter is written under /resources/ only."""
        return any(fnmatchcase(name, glob) for glob in self.settings.resources_only)

    def written(self, kind: Kind, name: str) -> None:
        """Something was written to a topic, a service or a parameter through rosld, or may have been."""
        self.offers.written(kind, name)

    def deadline(self, seconds: float) -> float:
        """The loop time so many seconds from now."""
        return asyncio.get_running_loop().time() + seconds

    async def start(self) -> None:
        """Open the adapter unless it is, and follow its graph. Raises what `Adapter.open` raises."""
        self._loop = asyncio.get_running_loop()
        await self.adapter.open(self, deadline=self.deadline(OPEN_SECONDS))
        self.topics.start()
        self.records.watch(self._kept)
        await self._keep_mappings()
        self._changed.set()
        gc.collect()
        gc.freeze()  # what is loaded now stays: looking through it again and again would hold everybody up
        self._follower = self._loop.create_task(self._follow())

    async def stop(self) -> None:
        """Give everything back to the robot; idempotent."""
        if self._follower is not None:
            self._follower.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._follower
        await self.calls.stop()
        await self.readings.stop()
        await self.topics.stop()
        await self.adapter.close()
        await self.records.close()

    def graph_changed(self, graph: Graph) -> None:
        """`Sink`: look at what the graph now holds."""
        if self._loop is not None and not self._loop.is_closed():
            with contextlib.suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self._moved)

    def parameter_changed(self, name: str) -> None:
        """`Sink`: tell those who watch it. Whoever asks reads it anew in any case."""
        if self._loop is not None and not self._loop.is_closed():
            with contextlib.suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self.parameter_changes.give, name)

    def _moved(self) -> None:
        self._changed.set()
        self.changes.give()

    async def _keep_mappings(self) -> None:
        """Keep the mappings to begin with, and put those into force that were kept by an earlier run.

        What the robot comes with gives way to what clients made of it; what the settings name does not.
        """
        named = {self.space.url("mappings", (path.stem,)) for path in self.settings.mapping}
        for document in self._given:
            path = document.url[len(self.space.base) :]
            if self.records.was_there(path):
                self.mappings.remove(document.url)
            elif self.records.get(path) is None or document.url in named:
                await self.records.write(Put(path, Model.RDF_SOURCE, written(document.triples)))
        for member in self.records.members("mappings/"):
            record, url = self.records.get(member.path), self.space.base + member.path
            if record is not None and (url not in self.mappings.documents or url not in named):
                self._put_into_force(record, url)

    def _put_into_force(self, record: Record, url: str) -> None:
        try:
            self.mappings.replace(mapping_of(indexed(parse(record.triples, RdfFormat.N_TRIPLES), url), url))
        except ValueError as error:
            _log.error("The mapping %s is kept and not in force: %s", url, error)

    def _kept(self, changes: Sequence[Changed]) -> None:
        for each in changes:
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


def documents_of(settings: Settings, adapter: Adapter, space: Space) -> Iterator[MappingDocument]:
    """The mapping documents to begin with: the robot's own, and those of the settings. Raises ValueError."""
    shipped = adapter.capabilities.mapping
    if shipped is not None:
        yield load_mapping(shipped, space, adapter.capabilities.system)
    for path in settings.mapping:
        yield load_mapping(path, space)


def limits_of(settings: Settings, adapter: Adapter, space: Space) -> Limits:
    """The limits in force: the robot's own, and those of the settings. Raises ValueError with the file's name."""
    shipped = adapter.capabilities.limits
    graphs = []
    for path in (*((shipped,) if shipped is not None else ()), *settings.shapes):
        try:
            graphs.append(read_limits(path.read_bytes(), space.base))
            Limits.of(graphs[-1:], space)
        except ValueError as error:
            raise ValueError(f"{path} holds no limits: {error}") from error
    return Limits.of(graphs, space)


def used_types(graph: Graph) -> list[TypeRef]:
    """Every type that a topic or a service of the graph has."""
    refs = {ref: None for topic in graph.topics.values() for ref in topic.types}
    refs |= {service.type: None for service in graph.services.values() if service.type is not None}
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
