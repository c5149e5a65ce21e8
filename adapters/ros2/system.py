"""rosld in a ROS 2 system: all work on the ROS thread, and the polling of the graph."""

from __future__ import annotations

import asyncio
import os
import re
import socket
import time
from collections.abc import Sequence
from functools import partial
from typing import Any, cast

from rosld.adapters.base import AdapterOptions, Sink
from rosld.adapters.model import Graph, Live, NotFound, Qos, Refused, TypeRef, Unreachable
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.model.names import global_name
from rosld.adapters.node_parameters import Parameters
from rosld.adapters.ros2.actions import Actions
from rosld.adapters.ros2.calls import Calls
from rosld.adapters.ros2.feeds import TopicFeed
from rosld.adapters.ros2.graph import Discovery, GraphInputs, LiveGraph, foreign_nodes, of_action
from rosld.adapters.ros2.lifecycle import Lifecycles
from rosld.adapters.ros2.middleware import Participant, Reader
from rosld.adapters.ros2.topics import Publication, Publications, Readers
from rosld.adapters.ros2.types import Types
from rosld.adapters.ros2.wait_set import Waiter

_EVENT = "rcl_interfaces/msg/ParameterEvent"
_EVENTS_QOS = Qos("best_effort", "volatile", "keep_last", 1000)
_EVERY = 0.2
_SOON = 0.02
_DISCOVERY = 4.0
"""Seconds to wait for the first node: lost announcements are repeated after three."""
_STABLE = 0.3
_PATIENCE = 0.5


class System:
    """Polls the system, reads and publishes topics, calls services. Used on the ROS thread, except for `graph`."""

    def __init__(
        self,
        participant: Participant,
        waiter: Waiter,
        graph: Graph,
        options: AdapterOptions,
        library: TypeLibrary,
        sink: Sink,
    ) -> None:
        self._sink = sink
        self._graph = LiveGraph(graph, sink)
        self._participant = participant
        self.waiter = waiter
        self.calls = Calls(self._participant, self.waiter)
        self.types = Types(library, self.calls)
        self.actions = Actions(self._participant, self.calls, self.waiter, lambda: self.graph, sink)
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
        self._take_parameter_events(self._participant.reader("/parameter_events", _EVENT, _EVENTS_QOS))
        loop = asyncio.get_running_loop()
        changed = loop.time()
        until = min(until, changed + _DISCOVERY)
        while loop.time() < until:
            before = self._discovery.observation
            try:
                await self.poll()
            except Unreachable as error:
                self._graph.mark_stale(error.sentence)
                break
            if self._discovery.observation != before:
                changed = loop.time()
            if self._graph.has_robot and loop.time() - changed > _STABLE:
                break
            await asyncio.sleep(_SOON)
        await self.parameters.queries.wait(min(_PATIENCE, max(0.0, until - loop.time())))
        await self.lifecycles.queries.wait(min(_PATIENCE, max(0.0, until - loop.time())))
        if self._discovery.observation.nodes or isinstance(self.graph.state, Live):
            self.refresh()
        self._task = loop.create_task(self._watch())

    async def close(self) -> None:
        """Leave the system."""
        if self._task is not None:
            self._task.cancel()
        self.parameters.queries.cancel()
        self.lifecycles.close()
        self.actions.close()
        self._readers.close()
        self.calls.close()
        await asyncio.get_running_loop().run_in_executor(None, self.waiter.stop, 0.5)
        self.publications.close()
        self._participant.close()

    # Reading

    def read(self, feed: TopicFeed) -> None:
        """Start reading a topic."""
        self._readers.add(feed)
        self._follow(feed)

    def stop_reading(self, feed: TopicFeed) -> None:
        """Stop reading a topic."""
        self._readers.remove(feed)

    def deepen(self, feed: TopicFeed) -> None:
        """Apply a feed's new depth."""
        self._follow(feed)

    def _follow(self, feed: TopicFeed) -> None:
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
            message = self.calls.messages.request_of(type.name, request)
        except ValueError as error:
            raise Refused(f"{service} was not called: {error}") from error
        answer = await self.calls.call(service, type.name, message, until)
        return self.calls.messages.serialize(answer, type.name, "Response")

    async def advertise(self, topic: str, type: TypeRef, latch: bool, until: float) -> Publication:
        """Publish a topic, wait for its subscribers, and update the graph."""
        return await self.publications.advertise(topic, type, latch, until)

    async def unadvertise(self, topic: str) -> None:
        """Stop publishing a topic, and update the graph. Raises NotFound."""
        await self.publications.unadvertise(topic)

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
        others = {*foreign_nodes(observation, self._participant.hidden_name)} - {self._participant.visible_name}
        has_robot = any(not name.rpartition("/")[2].startswith("_") for name in others)  # tools are hidden
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
                self.actions.drop_missing_servers()
            except Exception as error:  # any error of the middleware: the next poll retries
                words = error.sentence if isinstance(error, Unreachable) else f"the system cannot be inspected: {error}"
                self._graph.mark_stale(words)
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

    def _parameters_changed(self, names: Sequence[str]) -> None:
        self.refresh_soon()
        for name in names:
            self._sink.parameter_changed(name)

    def _take_parameter_events(self, reader: Reader) -> None:
        while (message := reader.take()) is not None:
            event = cast(Any, self.calls.messages.deserialize(_EVENT, message.data))
            if global_name(event.node) not in self._ours():
                self.parameters.event(event)
            self._discovery.poll_soon()  # a new node reports its parameters, so poll soon
        self.waiter.arm(reader.handle, "reader", partial(self._take_parameter_events, reader))


def unique_name() -> str:
    """Return a name unique among rosld nodes, even if containers share a host name and all have the process id 1."""
    host = re.sub(r"\W", "_", socket.gethostname(), flags=re.ASCII)
    return f"rosld_{host}_{os.getpid()}_{time.monotonic_ns() % 10**6}"
