"""A robot behind a rosbridge server: the session with the bridge, and the polling of the robot's graph."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence

from rosld.adapters.base import AdapterOptions, Sink
from rosld.adapters.bridge_connection import BridgeFeed, BridgeGraph
from rosld.adapters.model import (
    Graph,
    NotFound,
    Refused,
    RosError,
    ServiceSchema,
    TypeRef,
    UnknownType,
    Unreachable,
)
from rosld.adapters.rosbridge.actions import Actions
from rosld.adapters.rosbridge.client import Client
from rosld.adapters.rosbridge.graph import Observer, compose
from rosld.adapters.rosbridge.parameters import NodeParameters, TreeParameters
from rosld.adapters.rosbridge.protocol import decode_message
from rosld.adapters.rosbridge.topics import Publication, Publications, Readers
from rosld.adapters.thread import Tasks

_EVERY = 1.0
_SHARE = 20
"""A poll may take this fraction of the bridge's time."""
_LONGEST = 30.0
_ANSWER_SECONDS = 5.0


class System:
    """A `Session` with the bridge, and the `LiveSystem` of the adapter. Used on the thread, except for `graph`."""

    def __init__(self, url: str, version: int | None, graph: Graph, options: AdapterOptions, sink: Sink) -> None:
        self.sink = sink
        self.client = Client(url, version, options, self)
        self._graph = BridgeGraph(graph, sink)
        self._observer = Observer(self.client.rosapi)
        self._tasks = Tasks()
        self._poll_lock = asyncio.Lock()
        self._refreshing = False
        self._use_version(version or 2)

    def _use_version(self, version: int) -> None:
        client = self.client
        client.use_version(version)
        self.readers = Readers(client, lambda: self.graph, self.refresh)
        self.publications = Publications(client, self.readers.echoes, lambda: self.graph, self.poll)
        self.actions = Actions(self)
        self.parameters: TreeParameters | NodeParameters = (
            TreeParameters(client.rosapi, self._parameters_changed)
            if version == 1
            else NodeParameters(client, self.readers, self._parameters_changed)
        )

    @property
    def graph(self) -> Graph:
        """The last known graph."""
        return self._graph.current

    async def open(self, patience: float) -> None:
        """Connect and load the graph; if the bridge does not respond, the graph is Stale until it does."""
        await self.client.connection.open(patience)
        await self.parameters.wait(min(patience, 1.0))
        self.refresh()
        self.client.version = self.client.version or 2
        self._tasks.begin(self._watch())

    async def close(self) -> None:
        """Stop publishing and reading, and disconnect."""
        self._tasks.cancel()
        self.parameters.close()
        self.publications.close()
        self.readers.close()
        await self.client.connection.close()

    # The session

    async def begin(self) -> None:
        """Load the graph, and subscribe and advertise again."""
        client = self.client
        version = await client.detected_version()
        if client.version is None:
            self._use_version(version)
            client.version = version
        elif version != client.version:
            raise Refused(f"the rosbridge server at {client.url} has ROS {version}: restart rosld with ?ros={version}")
        client.is_connected = True
        self.readers.begin()
        self.publications.begin()
        await self._poll(whole=True)

    async def receive(self, message: str | bytes) -> None:
        """Process a message of the bridge."""
        decoded = decode_message(message)
        match decoded.get("op"):
            case "publish":
                self.readers.receive(decoded)
            case "service_response":
                self.client.settle(decoded)
            case "action_feedback" | "action_result":
                self.actions.receive(decoded)
            case "status":
                self.readers.receive_status(decoded)

    def end(self, error: RosError) -> None:
        """Mark the graph as stale, and fail what is pending."""
        self.client.fail()
        self.actions.end()
        self._graph.mark_stale(error)

    # What the adapter asks for

    def read(self, feed: BridgeFeed) -> None:
        """Start reading a topic."""
        self.readers.read(feed)

    def deepen(self, feed: BridgeFeed) -> None:
        """Do nothing: a feed stores as many messages as it needs."""

    def stop_reading(self, feed: BridgeFeed) -> None:
        """Stop reading a topic."""
        self.readers.stop_reading(feed)

    async def advertise(self, topic: str, type: TypeRef, latch: bool, until: float) -> Publication:
        """Publish a topic, wait for its subscribers, and update the graph."""
        return await self.publications.advertise(topic, type, latch, until)

    async def unadvertise(self, topic: str) -> None:
        """Stop publishing a topic, and update the graph. Raises NotFound."""
        self.publications.unadvertise(topic)
        self.refresh()

    async def call(self, service: str, type: TypeRef, request: bytes, until: float) -> bytes:
        """Call a service. Raises Refused, TimedOut, Unreachable, NotFound, UnknownType."""
        if service not in self.graph.services:
            await self.poll()
        existing = self.graph.services.get(service)
        if existing is None:
            raise NotFound(f"there is no service {service}")
        if existing.type is not None and existing.type.name != type.name:
            raise Refused(f"{service} has the type {existing.type.name}, not {type.name}")
        schema = await self.client.types.schema(TypeRef(type.name), until)
        if not isinstance(schema, ServiceSchema):
            raise UnknownType(f"{type.name} is not a service type")
        try:
            message = schema.request.codec.decode(request, self.client.encoding)
        except ValueError as error:
            raise Refused(f"{service} was not called: {error}") from error
        answer = await self.client.call_parts(service, schema.request, schema.response, message, until)
        return schema.response.codec.encode(answer, self.client.encoding)

    # The graph

    async def poll(self) -> None:
        """Update the graph now, including the endpoints of all nodes."""
        await self._try_to_poll(whole=True)

    async def _try_to_poll(self, *, whole: bool) -> None:
        if self.client.is_connected:
            try:
                await self._poll(whole=whole)
            except RosError as error:
                if self.client.is_connected:
                    self._graph.mark_stale(error)

    async def _poll(self, *, whole: bool) -> None:
        async with self._poll_lock:
            until = asyncio.get_running_loop().time() + _ANSWER_SECONDS
            try:
                await self._observer.poll(until, ros2=self.client.version == 2, whole=whole)
            except Refused as error:
                raise Unreachable(f"rosapi does not answer: {error}; start its node with the bridge") from error
        self.parameters.follow(self._observer.observation)
        self.refresh()
        await self.readers.subscribe()

    async def _watch(self) -> None:
        while True:
            started = time.monotonic()
            await self._try_to_poll(whole=False)
            took = time.monotonic() - started
            await asyncio.sleep(min(max(_EVERY, _SHARE * took), _LONGEST))

    def refresh(self) -> None:
        """Rebuild the graph, unless it is stale."""
        self._refreshing = False
        if not self.client.is_connected:
            return
        published = {topic: each.ref for topic, each in self.publications.by_topic.items()}
        problems = self.client.types.problems
        parts = compose(self._observer.observation, self.graph.own_node, published, self.readers.topics, problems)
        parts["parameters"] = self.parameters.graph_parameters
        parts["simulated_time"] = self.parameters.simulated_time
        self._graph.update(**parts)
        self.readers.name_publishers()

    def _parameters_changed(self, names: Sequence[str]) -> None:
        if not self._refreshing:
            self._refreshing = True
            asyncio.get_running_loop().call_soon(self.refresh)
        for name in names:
            self.sink.parameter_changed(name)
