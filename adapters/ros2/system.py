"""rosld in a ROS 2 system: all work on the ROS thread, and the polling of the graph."""

from __future__ import annotations

import asyncio
import os
import re
import socket
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

from rosld.adapters.base import AdapterOptions, Sink
from rosld.adapters.model import Action, Endpoint, GoalId, Graph, NotFound, Qos, Refused, TypeRef, UnknownType
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.ros2.actions import Actions
from rosld.adapters.ros2.calls import Calls
from rosld.adapters.ros2.feeds import Feed, Publishers
from rosld.adapters.ros2.graph import Discovery, GraphInputs, LiveGraph, foreign_nodes, nodes_using, of_action
from rosld.adapters.ros2.lifecycle import Lifecycles
from rosld.adapters.ros2.message_classes import request_of, serialize
from rosld.adapters.ros2.middleware import DiscoveredEndpoint, ParameterEvents, Participant, Reader
from rosld.adapters.ros2.parameters import Parameters
from rosld.adapters.ros2.profiles import override_for, reading_profile
from rosld.adapters.ros2.publications import Publications
from rosld.adapters.ros2.source import Source
from rosld.adapters.ros2.types import Types
from rosld.adapters.ros2.wait_set import Waiter

_CHECK_SECONDS = 5.0
"""Maximum seconds for checking whether messages of a type can be decoded."""


class Readers:
    """Readers of feeds. `refresh_soon` is called when a topic is found to be unreadable. Belongs to the ROS thread."""

    def __init__(
        self, participant: Participant, types: Types, options: AdapterOptions, refresh_soon: Callable[[], None]
    ) -> None:
        self._participant = participant
        self._types = types
        self._options = options
        self._refresh_soon = refresh_soon
        self._feeds: dict[str, Feed] = {}
        self._checked_types: set[TypeRef] = set()
        self._checks: set[asyncio.Task[None] | None] = set()

    def reader_of(self, topic: str) -> Reader | None:
        """Return the reader of a topic, or None."""
        feed = self._feeds.get(topic)
        return feed.reader if feed is not None else None

    def add(self, feed: Feed) -> None:
        """Read a topic, starting with the next `follow`."""
        self._feeds[feed.topic] = feed

    def remove(self, feed: Feed) -> None:
        """Stop reading a topic."""
        if self._feeds.get(feed.topic) is feed:
            del self._feeds[feed.topic]
        if (reader := feed.read_with(None)) is not None:
            reader.close()

    def close(self) -> None:
        """Stop reading all topics."""
        for feed in self._feeds.values():
            if (reader := feed.read_with(None)) is not None:
                reader.close()

    def follow_all(self, graph: Graph, endpoints_of: Callable[[str], Sequence[DiscoveredEndpoint]]) -> None:
        """Read all topics with profiles that match their current publishers, returned by `endpoints_of`."""
        for feed in list(self._feeds.values()):
            self.follow(feed, graph, endpoints_of(feed.topic))

    def follow(self, feed: Feed, graph: Graph, discovered: Sequence[DiscoveredEndpoint]) -> None:
        """Read a feed's topic with a profile that matches its current publishers."""
        if self._feeds.get(feed.topic) is not feed:
            return
        feed.own = graph.own_node
        others = [each for each in discovered if each.node != graph.own_node]
        publishers = self._publishers(feed.topic, graph, [each for each in others if each.node])
        if publishers != feed.publishers:
            feed.publishers = publishers
        type = publishers.type
        if feed.topic not in graph.topics or type is None or self._types.problem(type.name) is not None:
            return
        self._check_type(type, graph)
        endpoints = [Endpoint(each.node, qos=each.qos) for each in others]
        profile = reading_profile(endpoints, feed.depth, override_for(feed.topic, self._options.qos))
        reader = feed.reader
        if reader is not None and reader.qos.depth >= profile.depth:
            profile = replace(profile, depth=reader.qos.depth)
        if reader is None or reader.qos != profile:
            self._read_with(feed, type, profile)

    def _check_type(self, type: TypeRef, graph: Graph) -> None:
        """Check once whether messages of a type can be decoded; if not, its topics are marked as unreadable."""
        if type in self._checked_types:
            return
        self._checked_types.add(type)
        loop = asyncio.get_running_loop()

        async def check() -> None:
            try:
                await self._types.schema(type, nodes_using(graph, type), loop.time() + _CHECK_SECONDS)
            except UnknownType as error:
                self._types.note_problem(type.name, error.sentence)
                self._refresh_soon()
            finally:
                self._checks.discard(asyncio.current_task())

        self._checks.add(loop.create_task(check()))

    def _read_with(self, feed: Feed, type: TypeRef, profile: Qos) -> None:
        try:
            reader: Reader | None = self._participant.reader(feed.topic, type.name, profile)
        except Exception:  # a name that ROS 2 does not allow, or a profile that the middleware refuses
            return
        if (before := feed.read_with(reader)) is not None:
            before.close()

    def _publishers(self, name: str, graph: Graph, discovered: Sequence[DiscoveredEndpoint]) -> Publishers:
        topic = graph.topics.get(name)
        types = {each.node: self._types.with_hash(each.type) for each in discovered}
        first = next(iter(types.values()), None)
        if first is None and topic is not None and topic.types:
            first = self._types.with_hash(topic.types[0])
        return Publishers(
            Counter(each.node for each in discovered),
            {each.gid: each.node for each in discovered if each.gid},
            types,
            frozenset(each.node for each in discovered if each.qos.durability == "transient_local"),
            first,
        )


_EVERY = 0.2
_SOON = 0.02
_DISCOVERY = 4.0
"""Seconds to wait for the first node: lost announcements are repeated after three."""
_STABLE = 0.3
_PATIENCE = 0.5


class System:
    """Polls the system, reads and publishes topics, calls services. Used on the ROS thread, except for `graph`."""

    def __init__(self, source: Source, graph: Graph, options: AdapterOptions, library: TypeLibrary, sink: Sink) -> None:
        self._sink = sink
        self._graph = LiveGraph(graph, sink)
        self._participant = Participant(hidden_name(), source.domain, source.namespace)
        self.waiter = Waiter(self._participant)
        self.calls = Calls(self._participant, self.waiter)
        self.types = Types(library, self.calls)
        self.actions = Actions(self._participant, self.calls, self.waiter, sink.goal_changed)
        self.parameters = Parameters(self.calls, self._parameters_changed)
        self.lifecycles = Lifecycles(self._participant, self.calls, self.waiter, self.refresh_soon)
        self._discovery = Discovery(self._participant)
        self._readers = Readers(self._participant, self.types, options, self.refresh_soon)
        self.publications = Publications(
            self._participant, self.types, options, lambda: self.graph, self._readers.reader_of, self.poll
        )
        self._refreshing = False
        self._task: asyncio.Task[None] | None = None

    @property
    def graph(self) -> Graph:
        """The last known graph."""
        return self._graph.current

    async def open(self, until: float) -> None:
        """Poll until discovery is complete, which no event reports."""
        self.waiter.start()
        self._take_parameter_events(self._participant.parameter_events())
        loop = asyncio.get_running_loop()
        changed = loop.time()
        until = min(until, changed + _DISCOVERY)
        while loop.time() < until:
            before = self._discovery.observation
            await self.poll()
            if self._discovery.observation != before:
                changed = loop.time()
            if self._graph.has_robot and loop.time() - changed > _STABLE:
                break
            await asyncio.sleep(_SOON)
        await self.parameters.wait_settled(min(_PATIENCE, max(0.0, until - loop.time())))
        await self.lifecycles.wait_settled(min(_PATIENCE, max(0.0, until - loop.time())))
        self.refresh()
        self._task = loop.create_task(self._watch())

    async def close(self) -> None:
        """Leave the system."""
        if self._task is not None:
            self._task.cancel()
        self.parameters.close()
        self.lifecycles.close()
        self.actions.close()
        self._readers.close()
        self.calls.close()
        await asyncio.get_running_loop().run_in_executor(None, self.waiter.stop, 0.5)
        self.publications.close()
        self._participant.close()

    # Reading

    def read(self, feed: Feed) -> None:
        """Start reading a topic."""
        self._readers.add(feed)
        self._follow(feed)

    def stop_reading(self, feed: Feed) -> None:
        """Stop reading a topic."""
        self._readers.remove(feed)

    def deepen(self, feed: Feed) -> None:
        """Apply a feed's new depth."""
        self._follow(feed)

    def _follow(self, feed: Feed) -> None:
        self._readers.follow(feed, self.graph, self._discovery.observation.publishers.get(feed.topic, ()))

    # Services

    async def call(self, service: str, type: TypeRef, request: bytes, until: float) -> bytes:
        """Call a service. Raises Refused, TimedOut, Unreachable, NotFound, UnknownType."""
        if (words := of_action(service)) is not None:
            raise Refused(f"{service} is not called: {words}")
        existing = self.graph.services.get(service)
        if existing is None:
            await self.poll()
            existing = self.graph.services.get(service)
        if existing is None:
            raise NotFound(f"there is no service {service}")
        if existing.type is not None and existing.type.name != type.name:
            raise Refused(f"{service} has the type {existing.type.name}, not {type.name}")
        try:
            message = request_of(type.name, request)
        except ValueError as error:
            raise Refused(f"{service} was not called: {error}") from error
        return serialize(await self.calls.call(service, type.name, message, until))

    # Actions

    async def send_goal(self, name: str, type: TypeRef, goal: bytes, until: float) -> GoalId:
        """Send a goal. Raises Refused, TimedOut, Unreachable, NotFound."""
        action = self._action(name)
        if action.type is not None and action.type.name != type.name:
            raise Refused(f"{name} has the type {action.type.name}, not {type.name}")
        return await self.actions.send(action, goal, until)

    async def cancel_goal(self, goal: GoalId, until: float) -> None:
        """Request the cancellation of a goal. Raises Refused, TimedOut, Unreachable, NotFound."""
        self._action(goal.action)
        await self.actions.cancel(goal, until)

    async def cancel_goals(self, name: str, until: float) -> None:
        """Request the cancellation of all goals of an action. Raises Refused, TimedOut, Unreachable, NotFound."""
        self._action(name)
        await self.actions.cancel_all(name, until)

    async def follow_goals(self, name: str, until: float) -> Callable[[], None]:
        """Report all goals of an action to the sink until the returned function is called. Raises Refused, NotFound."""
        return await self.actions.follow(self._action(name), until)

    def _action(self, name: str) -> Action:
        action = self.graph.actions.get(name)
        if action is None:
            raise NotFound(f"there is no action {name}")
        return action

    # Lifecycles

    async def change_state(self, node: str, transition: str, until: float) -> None:
        """Request a transition of a managed node. Raises Refused, TimedOut, Unreachable, NotFound."""
        if node not in self.graph.nodes:
            raise NotFound(f"there is no node {node}")
        try:
            await self.lifecycles.change(node, transition, until)
        finally:
            self.refresh()

    # The graph

    async def poll(self, topics: Sequence[str] = ()) -> None:
        """Poll the system now, always including the endpoints of these topics."""
        await self._discovery.poll(topics)
        providers = self._discovery.observation.providers
        self.parameters.follow(providers, self._ours())
        self.lifecycles.follow(providers, self._ours())
        self.refresh()

    def refresh(self) -> None:
        """Rebuild the graph and report changes."""
        self._refreshing = False
        observation = self._discovery.observation
        has_robot = any(self._is_robots(name) for name in foreign_nodes(observation, self._participant.hidden_name))
        self._graph.update(observation, self._graph_inputs(), has_robot=has_robot)
        self._readers.follow_all(self.graph, lambda topic: observation.publishers.get(topic, ()))

    def refresh_soon(self) -> None:
        """Rebuild the graph once for all changes in this iteration of the loop."""
        if not self._refreshing:
            self._refreshing = True
            asyncio.get_running_loop().call_soon(self.refresh)

    async def _watch(self) -> None:
        while True:
            await self._discovery.pause()
            try:
                await self.poll()
                self.calls.drop_missing_servers()
                self.actions.drop_missing_servers(self.graph.actions)
            except Exception as error:  # any error of the middleware: the next poll retries
                self._graph.mark_stale(f"the system cannot be looked at: {error}")
                await asyncio.sleep(_EVERY)

    def _graph_inputs(self) -> GraphInputs:
        return GraphInputs(
            self._participant.hidden_name,
            self.graph.own_node,
            frozenset(self.publications.by_topic),
            self.parameters.graph_parameters,
            self.parameters.unreachable,
            self.lifecycles.by_node,
            self.parameters.simulated_time,
            self.types.problem,
        )

    def _ours(self) -> tuple[str, ...]:
        """Return the nodes of rosld, which are never queried."""
        visible = self._participant.visible_name
        return (self._participant.hidden_name,) if visible is None else (self._participant.hidden_name, visible)

    def _is_robots(self, node: str) -> bool:
        """Whether a node belongs to the robot, not to rosld or to tools, which are hidden."""
        return node != self._participant.visible_name and not node.rpartition("/")[2].startswith("_")

    def _parameters_changed(self, names: Sequence[str]) -> None:
        self.refresh_soon()
        for name in names:
            self._sink.parameter_changed(name)

    def _take_parameter_events(self, events: ParameterEvents) -> None:
        while (change := events.take()) is not None:
            if change.node not in self._ours():
                self.parameters.event(change)
            self._discovery.poll_soon()  # a new node reports its parameters, so poll soon
        self.waiter.arm(events.handle, "reader", partial(self._take_parameter_events, events))


def hidden_name() -> str:
    """Return the name of the reading node, which is hidden like those of ROS 2's own tools."""
    return f"_{unique_name()}"


def unique_name() -> str:
    """Return a name unique among rosld nodes, even if containers share a host name and all have the process id 1."""
    host = re.sub(r"\W", "_", socket.gethostname(), flags=re.ASCII)
    return f"rosld_{host}_{os.getpid()}_{time.monotonic_ns() % 10**6}"
