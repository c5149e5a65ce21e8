"""rosld in a ROS 2 system: everything that lives on the thread that talks to ROS, and the looks that keep it true.

rclpy tells of no graph events, so the names of things are looked at often, which is cheap, and the endpoints of a
topic when something hints at a change, and of all topics now and then.
"""

from __future__ import annotations

import asyncio
import os
import re
import socket
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

from rosld.adapters.base import AdapterOptions, Sink
from rosld.adapters.model import (
    Action,
    Endpoint,
    GoalEvent,
    GoalId,
    Graph,
    Live,
    NotFound,
    Qos,
    Refused,
    Stale,
    Topic,
    TypeRef,
    UnknownType,
)
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.ros2.actions import Actions
from rosld.adapters.ros2.calls import Calls
from rosld.adapters.ros2.feeds import Feed, Publishers
from rosld.adapters.ros2.graph import Known, Observation, compose, foreign_nodes, of_action, stale
from rosld.adapters.ros2.lifecycle import Lifecycles
from rosld.adapters.ros2.middleware import Names, Participant, Reader, Seen, request_of, serialized
from rosld.adapters.ros2.parameters import Parameters
from rosld.adapters.ros2.profiles import override_for, publishing_profile, reading_profile
from rosld.adapters.ros2.publications import Publication
from rosld.adapters.ros2.source import Source
from rosld.adapters.ros2.types import Types
from rosld.adapters.ros2.wait_set import Waiter

_EVERY = 0.2
_COUNTS = 1.0
_ALL = 10.0
_SHARE = 20  # looks may take one part in so many of our time
_AT_ONCE = 25
_SOON = 0.02
_DISCOVERY = 4.0
"""Seconds to wait for the first node: announcements that get lost are made again after three."""
_STABLE = 0.3
_PATIENCE = 0.5
_PROOF = 5.0
_LEAVING = 5.0
"""Seconds that a robot may take to go away node by node."""


@dataclass
class _Times:
    """When was looked at what for the last time, and how long it took."""

    counts: float = 0.0
    all: float = 0.0
    took: float = 0.0


class System:
    """Looks, reads, publishes, calls. Made and used on the thread that talks to ROS, but for `graph`."""

    def __init__(self, source: Source, graph: Graph, options: AdapterOptions, library: TypeLibrary, sink: Sink) -> None:
        self.graph = graph
        self.publications: dict[str, Publication] = {}
        self._options = options
        self._sink = sink
        self._loop = asyncio.get_running_loop()
        self._participant = Participant(hidden_name(), source.domain, source.namespace)
        self.waiter = Waiter(self._participant)
        self.calls = Calls(self._participant, self.waiter)
        self.types = Types(library, self.calls)
        self.actions = Actions(self._participant, self.calls, self.waiter, self._goal_changed)
        self.parameters = Parameters(self.calls, self._parameters_changed)
        self.lifecycles = Lifecycles(self._participant, self.calls, self.waiter, self.refresh_soon)
        self._own_node = graph.own_node
        self._events = self._participant.parameter_events()
        self._feeds: dict[str, Feed] = {}
        self._seen = Observation()
        self._counts: dict[str, tuple[int, int]] = {}
        self._times = _Times()
        self._wanted = asyncio.Event()
        self._refreshing = False
        self._anybody = False
        self._task: asyncio.Task[None] | None = None
        self._looking = asyncio.Lock()
        self._whole: tuple[Graph, float] | None = None
        self._proved: set[TypeRef] = set()
        self._proving: set[asyncio.Task[None] | None] = set()
        self._advertising = asyncio.Lock()

    async def open(self, until: float) -> None:
        """Look until the system has shown itself: discovery takes a moment, and nobody says when it is over."""
        self.waiter.start()
        self._arm_events()
        began = self._loop.time()
        until = min(until, began + _DISCOVERY)
        changed = began
        while self._loop.time() < until:
            before = self._seen
            await self.look()
            if self._seen != before:
                changed = self._loop.time()
            if self._anybody and self._loop.time() - changed > _STABLE:
                break
            await asyncio.sleep(_SOON)
        await self.parameters.settled(min(_PATIENCE, max(0.0, until - self._loop.time())))
        await self.lifecycles.settled(min(_PATIENCE, max(0.0, until - self._loop.time())))
        self.refresh()
        self._task = self._loop.create_task(self._watch())

    async def close(self) -> None:
        """Leave the system."""
        if self._task is not None:
            self._task.cancel()
        self.parameters.close()
        self.lifecycles.close()
        self.actions.close()
        for feed in self._feeds.values():
            if (reader := feed.read_with(None)) is not None:
                reader.close()
        self.calls.close()
        await self._loop.run_in_executor(None, self.waiter.stop, 0.5)
        for publication in self.publications.values():
            publication.writer.close()
        self._participant.close()

    # Reading

    def read(self, feed: Feed) -> None:
        """Begin to read a topic."""
        self._feeds[feed.topic] = feed
        self._follow(feed)

    def unread(self, feed: Feed) -> None:
        """Stop reading a topic."""
        if self._feeds.get(feed.topic) is feed:
            del self._feeds[feed.topic]
        if (reader := feed.read_with(None)) is not None:
            reader.close()

    def deepen(self, feed: Feed) -> None:
        """Heed that a feed wants another depth."""
        if self._feeds.get(feed.topic) is feed:
            self._follow(feed)

    # Publishing

    async def advertise(self, topic: str, type: TypeRef, latch: bool, until: float) -> Publication:
        """Publish a topic from now on, and wait for its subscribers as `Adapter.publish` promises.

        Raises Refused where it is ours with another type, UnknownType, Unreachable.
        """
        async with self._advertising:
            publication = self.publications.get(topic)
            if publication is not None and not publication.carries(type):
                raise Refused(f"rosld publishes {topic} as {publication.ref.name}, not {type.name}")
            if publication is None or not self.suits(publication, latch):
                publication = await self._advertise(topic, type, latch, until)
            return publication

    def suits(self, publication: Publication, latch: bool) -> bool:
        """Whether all subscribers still accept a publication's profile. From any thread."""
        topic = self.graph.topics.get(publication.topic)
        wanted = self._publishing_profile(publication.topic, topic, latch or publication.latched)
        return replace(wanted, depth=publication.qos.depth) == publication.qos

    async def unadvertise(self, topic: str) -> None:
        """Stop publishing. Raises NotFound."""
        async with self._advertising:
            publication = self.publications.pop(topic, None)
            if publication is None:
                raise NotFound(f"rosld does not publish {topic}")
            publication.writer.close()
            if not self.publications:
                self._participant.hide()
            await self.look(topics=(topic,))

    # Services

    async def call(self, service: str, type: TypeRef, request: bytes, until: float) -> bytes:
        """Call a service. Raises Refused, TimedOut, Unreachable, NotFound, UnknownType."""
        if (words := of_action(service)) is not None:
            raise Refused(f"{service} is not called: {words}")
        known = self.graph.services.get(service)
        if known is None:
            await self.look()
            known = self.graph.services.get(service)
        if known is None:
            raise NotFound(f"there is no service {service}")
        if known.type is not None and known.type.name != type.name:
            raise Refused(f"{service} has the type {known.type.name}, not {type.name}")
        try:
            asked = request_of(type.name, request)
        except ValueError as error:
            raise Refused(f"{service} was not called: {error}") from error
        return serialized(await self.calls.call(service, type.name, asked, until))

    # Actions

    async def send_goal(self, name: str, type: TypeRef, goal: bytes, until: float) -> GoalId:
        """Send a goal. Raises Refused, TimedOut, Unreachable, NotFound."""
        action = self._action(name)
        if action.type is not None and action.type.name != type.name:
            raise Refused(f"{name} has the type {action.type.name}, not {type.name}")
        return await self.actions.send(action, goal, until)

    async def cancel_goal(self, goal: GoalId, until: float) -> None:
        """Ask for a goal to be canceled. Raises Refused, TimedOut, Unreachable, NotFound."""
        self._action(goal.action)
        await self.actions.cancel(goal, until)

    async def follow_goals(self, name: str, until: float) -> Callable[[], None]:
        """Have the sink told of all goals of an action until what is returned is called. Raises Refused, NotFound."""
        return await self.actions.follow(self._action(name), until)

    def _action(self, name: str) -> Action:
        action = self.graph.actions.get(name)
        if action is None:
            raise NotFound(f"there is no action {name}")
        return action

    # Lifecycles

    async def change_state(self, node: str, transition: str, until: float) -> None:
        """Have a managed node make a transition. Raises Refused, TimedOut, Unreachable, NotFound."""
        if node not in self.graph.nodes:
            raise NotFound(f"there is no node {node}")
        try:
            await self.lifecycles.change(node, transition, until)
        finally:
            self.refresh()

    # The graph

    async def look(self, topics: Sequence[str] = ()) -> None:
        """Look at the system now; at the endpoints of these topics whether something hints at a change or not."""
        async with self._looking:
            started = time.monotonic()
            await self._look(topics)
            self._times.took = time.monotonic() - started
        self.refresh()

    def refresh(self) -> None:
        """Make the graph anew and tell of it where it changed."""
        self._refreshing = False
        robots = [name for name in foreign_nodes(self._seen, self._participant.hidden_name) if self._is_robots(name)]
        if robots or not self._anybody:
            self._anybody = bool(robots)
            graph = compose(self.graph, self._seen, self._known())
            self._note_leaving(graph)
            self._show(graph)
        else:
            self._show(stale(self._last_whole(), time.time_ns(), "none of its nodes can be seen any more"))
        for feed in list(self._feeds.values()):
            self._follow(feed)

    def _note_leaving(self, graph: Graph) -> None:
        """Remember the graph as it was before nodes began to leave: they may all be about to."""
        now = self._loop.time()
        before, after = (each.nodes.keys() - {self._own_node} for each in (self.graph, graph))
        if after > before:
            self._whole = None
            return
        is_new = self._whole is None or now - self._whole[1] > _LEAVING
        if is_new and before - after and isinstance(self.graph.state, Live):
            self._whole = self.graph, now

    def _last_whole(self) -> Graph:
        """The graph as last known: nodes that left one by one, but in one go, are still in it."""
        if isinstance(self.graph.state, Stale) or self._whole is None:
            return self.graph
        whole, since = self._whole
        if self._loop.time() - since > _LEAVING:
            return self.graph
        return replace(whole, revision=self.graph.revision, own_node=self._own_node)

    def refresh_soon(self) -> None:
        """Make the graph anew, once for all that happens in this turn of the loop."""
        if not self._refreshing:
            self._refreshing = True
            self._loop.call_soon(self.refresh)

    def in_use(self, ref: TypeRef) -> TypeRef:
        """The type of this name that a topic has, where its hash is not said."""
        if ref.hash is not None:
            return ref
        types = (each for topic in self.graph.topics.values() for each in topic.types)
        return next((each for each in types if each.name == ref.name), ref)

    def users_of(self, ref: TypeRef) -> list[str]:
        """The nodes that use a type and tell of their types."""
        nodes: dict[str, None] = {}
        for topic in self.graph.topics.values():
            for each in (*topic.publishers, *topic.subscribers):
                if each.type is not None and each.type.name == ref.name:
                    nodes[each.node] = None
        for service in self.graph.services.values():
            if service.type is not None and service.type.name == ref.name:
                nodes.update(dict.fromkeys(service.providers))
        return [node for node in nodes if f"{node}/get_type_description" in self.graph.services]

    async def _watch(self) -> None:
        while True:
            pause = max(_EVERY, _SHARE * self._times.took)
            try:
                await asyncio.wait_for(self._wanted.wait(), min(pause, _ALL))
            except asyncio.TimeoutError:
                pass
            self._wanted.clear()
            try:
                await self.look()
                self.calls.look()
                self.actions.look(self.graph.actions)
            except Exception as error:  # whatever the middleware provokes: the next look tries again
                self._show(stale(self.graph, time.time_ns(), f"the system cannot be looked at: {error}"))
                await asyncio.sleep(_EVERY)

    async def _look(self, wanted: Sequence[str]) -> None:
        participant, before, now = self._participant, self._seen, self._loop.time()
        nodes, topics, services = participant.node_names(), participant.topics(), participant.services()
        anew = set(wanted) & topics.keys()
        whole = now - self._times.all > max(_ALL, _SHARE * self._times.took)
        if whole or sorted(nodes) != sorted(before.nodes):
            anew.update(topics)
            self._times.all = now
        else:
            anew.update(name for name, types in topics.items() if before.topics.get(name) != types)
            anew.update(name for name in topics if self._incomplete(name))
            if now - self._times.counts > _COUNTS:
                anew.update(name for name in topics if self._counts.get(name) != participant.counts(name))
                self._times.counts = now
        publishers = {name: before.publishers[name] for name in topics if name in before.publishers}
        subscribers = {name: before.subscribers[name] for name in topics if name in before.subscribers}
        for position, name in enumerate(sorted(anew)):
            publishers[name], subscribers[name] = participant.publishers(name), participant.subscribers(name)
            self._counts[name] = len(publishers[name]), len(subscribers[name])
            if position % _AT_ONCE == _AT_ONCE - 1:
                await asyncio.sleep(0)
        self._counts = {name: count for name, count in self._counts.items() if name in topics}
        providers, callers = before.providers, before.callers
        if whole or sorted(nodes) != sorted(before.nodes) or services != before.services or self._unprovided(services):
            foreign = foreign_nodes(Observation(nodes), participant.hidden_name)
            providers = {node: participant.services_of(node) for node in foreign}
            callers = {node: participant.clients_of(node) for node in foreign}
        self._seen = Observation(nodes, topics, services, publishers, subscribers, providers, callers)
        self.parameters.follow(providers, self._ours())
        self.lifecycles.follow(providers, self._ours())

    def _incomplete(self, topic: str) -> bool:
        """Whether an endpoint was seen before its node was: who it is comes a moment later."""
        seen = self._seen
        return any(not each.node for of in (seen.publishers, seen.subscribers) for each in of.get(topic, ()))

    def _unprovided(self, services: Names) -> bool:
        provided = {service for of in self._seen.providers.values() for service in of}
        return not services.keys() <= provided

    def _known(self) -> Known:
        return Known(
            self._participant.hidden_name,
            self._own_node,
            frozenset(self.publications),
            self.parameters.graph_parameters,
            self.parameters.unreachable,
            self.lifecycles.by_node,
            self.parameters.simulated_time,
            self.types.problem,
        )

    def _ours(self) -> tuple[str, ...]:
        """Our nodes, which are never asked for anything."""
        shown = self._participant.shown_name
        return (self._participant.hidden_name,) if shown is None else (self._participant.hidden_name, shown)

    def _is_robots(self, node: str) -> bool:
        """Whether a node is the robot's: neither ours nor one of the tools, which hide."""
        return node != self._participant.shown_name and not node.rpartition("/")[2].startswith("_")

    def _show(self, graph: Graph) -> None:
        if graph is not self.graph:
            self.graph = graph
            self._sink.graph_changed(graph)

    # Goals and parameters

    def _goal_changed(self, goal: GoalId, event: GoalEvent) -> None:
        self._sink.goal_changed(goal, event)

    def _parameters_changed(self, names: Sequence[str]) -> None:
        self.refresh_soon()
        for name in names:
            self._sink.parameter_changed(name)

    def _arm_events(self) -> None:
        self.waiter.arm(self._events.handle, "reader", self._events_ready)

    def _events_ready(self) -> None:
        try:
            self._loop.call_soon_threadsafe(self._take_events)
        except RuntimeError:
            pass  # the thread's loop has ended

    def _take_events(self) -> None:
        while (change := self._events.take()) is not None:
            if change.node not in self._ours():
                self.parameters.event(change)
        self._wanted.set()  # a node that begins tells of its parameters: a hint to look
        self._arm_events()

    # Readers and writers

    def _follow(self, feed: Feed) -> None:
        """Read a feed's topic with the profile that fits its publishers now."""
        feed.own = self._own_node
        seen = [each for each in self._seen.publishers.get(feed.topic, ()) if each.node != self._own_node]
        publishers = self._publishers(feed.topic, [each for each in seen if each.node])
        if publishers != feed.publishers:
            feed.publishers = publishers
        topic = self.graph.topics.get(feed.topic)
        type = publishers.type
        if topic is None or type is None or self.types.problem(type.name) is not None:
            return
        self._prove(type)
        others = [Endpoint(each.node, qos=each.qos) for each in seen]
        wanted = reading_profile(others, feed.depth, override_for(feed.topic, self._options.qos))
        reader = feed.reader
        if reader is not None and reader.qos.depth >= wanted.depth:
            wanted = replace(wanted, depth=reader.qos.depth)
        if reader is None or reader.qos != wanted:
            self._read_with(feed, type, wanted)

    def _prove(self, type: TypeRef) -> None:
        """Find out, once, whether messages of a type that is read can be decoded: else its topics say why not."""
        if type in self._proved:
            return
        self._proved.add(type)

        async def prove() -> None:
            try:
                await self.types.schema(type, self.users_of(type), self._loop.time() + _PROOF)
            except UnknownType as error:
                self.types.note_problem(type.name, error.sentence)
                self.refresh_soon()
            finally:
                self._proving.discard(asyncio.current_task())

        self._proving.add(self._loop.create_task(prove()))

    def _read_with(self, feed: Feed, type: TypeRef, wanted: Qos) -> None:
        try:
            reader: Reader | None = self._participant.reader(feed.topic, type.name, wanted)
        except Exception:  # a name that ROS 2 does not allow, a profile that the middleware refuses
            return
        if (before := feed.read_with(reader)) is not None:
            before.close()

    def _publishers(self, topic: str, seen: Sequence[Seen]) -> Publishers:
        graphs = self.graph.topics.get(topic)
        types = {each.node: self.types.with_hash(each.type) for each in seen}
        first = next(iter(types.values()), None)
        if first is None and graphs is not None and graphs.types:
            first = self.types.with_hash(graphs.types[0])
        return Publishers(
            Counter(each.node for each in seen),
            {each.gid: each.node for each in seen if each.gid},
            types,
            frozenset(each.node for each in seen if each.qos.durability == "transient_local"),
            first,
        )

    def _publishing_profile(self, name: str, topic: Topic | None, latch: bool) -> Qos:
        subscribers = topic.subscribers if topic is not None else ()
        return publishing_profile(subscribers, latch=latch, override=override_for(name, self._options.qos))

    async def _advertise(self, topic: str, type: TypeRef, latch: bool, until: float) -> Publication:
        if (words := self.types.problem(type.name)) is not None:
            raise UnknownType(words)
        schema = await self.types.schema(type, self.users_of(type), until)
        before = self.publications.pop(topic, None)
        if before is not None:
            latch = latch or before.latched
            before.writer.close()
        profile = self._publishing_profile(topic, self.graph.topics.get(topic), latch)
        try:
            self._participant.show(self._own_node.rpartition("/")[2])
            writer = self._participant.writer(topic, schema.ref.name, profile)
        except Exception as error:
            if not self.publications:
                self._participant.hide()
            raise Refused(f"{topic} cannot be published: {error}") from error
        publication = Publication(topic, schema.ref, writer, partial(self._reader_of, topic))
        self.publications[topic] = publication
        await self.look(topics=(topic,))
        known = self.graph.topics.get(topic)
        await publication.matching(max(1, len(known.subscribers) if known else 0), until, _PATIENCE)
        await publication.settled(until)
        return publication

    def _reader_of(self, topic: str) -> Reader | None:
        feed = self._feeds.get(topic)
        return feed.reader if feed is not None else None


def hidden_name() -> str:
    """The name of the node that looks: hidden, as those of ROS 2's own tools are."""
    return f"_{unique_name()}"


def unique_name() -> str:
    """A name that no other rosld has, also where containers share a host's name and each has the process id 1."""
    host = re.sub(r"\W", "_", socket.gethostname(), flags=re.ASCII)
    return f"rosld_{host}_{os.getpid()}_{time.monotonic_ns() % 10**6}"
