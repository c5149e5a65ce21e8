"""A robot behind a rosbridge server: the session with the bridge, and the polling of the robot's graph."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from typing import cast

from rosld.adapters.base import AdapterOptions, Sink
from rosld.adapters.bridge_connection import BridgeFeed, BridgePublication, BridgeSource, BridgeSystem
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
from rosld.adapters.node_parameters import Parameters
from rosld.adapters.rosbridge.actions import Actions
from rosld.adapters.rosbridge.client import Client
from rosld.adapters.rosbridge.graph import Observer, compose
from rosld.adapters.rosbridge.parameters import TreeParameters
from rosld.adapters.rosbridge.protocol import decode_message
from rosld.adapters.rosbridge.topics import Reader, Readers
from rosld.adapters.thread import Tasks

_EVERY = 1.0
_SHARE = 20
"""A poll may take this fraction of the bridge's time."""
_LONGEST = 30.0
_ANSWER_SECONDS = 5.0
_EVENTS, _EVENT = "/parameter_events", "rcl_interfaces/msg/ParameterEvent"
_POLL_PAUSE = 0.3
_SETTLING = 0.2
"""Seconds for the subscribers of a topic to discover the bridge's new publisher, which no message reports."""


class System(BridgeSystem):
    """A `Session` with the bridge, and the `LiveSystem` of the adapter."""

    def __init__(
        self, source: BridgeSource, version: int | None, graph: Graph, options: AdapterOptions, sink: Sink
    ) -> None:
        super().__init__(graph, sink, latches=True)
        self.client = Client(source, version, options, self)
        self._feeds: dict[BridgeFeed, Reader] = {}
        self._observer = Observer(self.client)
        self._tasks = Tasks()
        self._poll_lock = asyncio.Lock()
        self._refreshing = False
        self._use_version(version or 2)

    def _use_version(self, version: int) -> None:
        client = self.client
        client.use_version(version)
        self.readers = Readers(client, self.refresh)
        self.actions = Actions(self)
        self.parameters: TreeParameters | Parameters = (
            TreeParameters(client.rosapi, self._parameters_changed)
            if version == 1
            else Parameters(client, self._parameters_changed)
        )
        if isinstance(self.parameters, Parameters):
            self.readers.listen(_EVENTS, self._take_event, lambda _: _EVENT)

    async def open(self, patience: float) -> None:
        """Connect and load the graph; if the bridge does not respond, the graph is Stale until it does."""
        await self.client.connection.open(patience)
        await self.parameters.queries.wait(min(patience, 1.0))
        self.refresh()
        self.client.version = self.client.version or 2
        self._tasks.begin(self._watch())

    async def close(self) -> None:
        """Stop publishing and reading, and disconnect."""
        self._tasks.cancel()
        self.parameters.queries.cancel()
        for topic in self.publications:
            self.client.try_to_send({"op": "unadvertise", "topic": topic})
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
            raise Refused(f"{client.connection.name} has ROS {version}: restart rosld with ?ros={version}")
        client.is_connected = self.publications.is_connected = True
        self.readers.begin()
        for publication in self.publications.values():
            self._announce(publication)
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

    def end(self, error: RosError) -> None:
        """Mark the graph as stale, and fail what is pending."""
        self.publications.is_connected = False
        self.client.fail()
        self.actions.end()
        self.show(self.graph.as_stale(error.sentence))

    # What the adapter asks for

    def read(self, feed: BridgeFeed) -> None:
        """Start reading a topic."""
        self._feeds[feed] = self.readers.listen(feed.topic, partial(self.deliver, feed), self._find_type)

    def stop_reading(self, feed: BridgeFeed) -> None:
        """Stop reading a topic."""
        if (reader := self._feeds.pop(feed, None)) is not None:
            self.readers.leave(reader)

    def _find_type(self, topic: str) -> str | None:
        found = self.graph.topics.get(topic)
        return found.types[0].name if found is not None and found.types else None

    async def advertise(self, topic: str, type: TypeRef, latch: bool, until: float) -> BridgePublication:
        """Publish a topic, and wait for a subscriber and until it knows the bridge.

        Raises Refused, Unreachable, UnknownType.
        """
        if not self.client.is_connected:
            raise Unreachable(f"{self.client.connection.name} is not connected")
        before = self.publications.get(topic)
        if before is not None and before.ref.name != type.name:
            raise Refused(f"rosld publishes {topic} as {before.ref.name}, not {type.name}")
        schema = await self.client.types.message(type, until)
        is_latched = latch or (before is not None and before.latched)
        publication = self.publications[topic] = BridgePublication(topic, schema, self._publish, latched=is_latched)
        if before is not None:
            self.client.try_to_send({"op": "unadvertise", "topic": topic})
        self._announce(publication)
        await self.poll()
        while not publication.matched and (left := until - time.monotonic()) > 0:
            await asyncio.sleep(min(_POLL_PAUSE, left))
            await self.poll()
        if publication.matched:
            await asyncio.sleep(max(min(until - time.monotonic(), _SETTLING), 0.0))
        return publication

    def _announce(self, publication: BridgePublication) -> None:
        message = {"op": "advertise", "topic": publication.topic, "latch": publication.latched}
        self.client.try_to_send({**message, "type": self.client.type_name(publication.ref.name)})

    def _publish(self, publication: BridgePublication, data: bytes) -> None:
        message = publication.schema.codec.decode(data, self.client.encoding)
        values = self.client.plain(publication.schema, message)
        self.client.send({"op": "publish", "topic": publication.topic, "msg": values})
        self.expect_echo(publication.topic, data)

    async def unadvertise(self, topic: str) -> None:
        """Stop publishing a topic, and update the graph. Raises NotFound."""
        if self.publications.pop(topic, None) is None:
            raise NotFound(f"rosld does not publish {topic}")
        self.client.try_to_send({"op": "unadvertise", "topic": topic})
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
        answer = await self.client.call(service, type.name, message, until)
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
                    self.show(self.graph.as_stale(error.sentence))

    async def _poll(self, *, whole: bool) -> None:
        async with self._poll_lock:
            until = asyncio.get_running_loop().time() + _ANSWER_SECONDS
            try:
                await self._observer.poll(until, ros2=self.client.version == 2, whole=whole)
            except Refused as error:
                raise Unreachable(f"rosapi does not answer: {error}; start its node with the bridge") from error
        observed = self._observer.observation
        typed = {
            node: {each: (observed.services.get(each, ""),) for each in its.services}
            for node, its in observed.nodes.items()
        }
        self.parameters.follow(typed, ())
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
        published = {topic: each.ref for topic, each in self.publications.items()}
        problems = self.client.types.problems
        parts = compose(self._observer.observation, self.graph.own_node, published, self.readers.topics, problems)
        parts["parameters"] = self.parameters.graph_parameters
        parts["simulated_time"] = self.parameters.simulated_time
        self.show(self.graph.updated(**parts))
        for topic, each in self.publications.items():
            each.match(len(self.graph.topics[topic].subscribers))

    def _take_event(self, data: bytes, _: TypeRef) -> None:
        with suppress(ValueError):
            event = self.client.messages.deserialize(_EVENT, data)
            cast(Parameters, self.parameters).event(event)

    def _parameters_changed(self, names: Sequence[str]) -> None:
        if not self._refreshing:
            self._refreshing = True
            asyncio.get_running_loop().call_soon(self.refresh)
        for name in names:
            self.sink.parameter_changed(name)
