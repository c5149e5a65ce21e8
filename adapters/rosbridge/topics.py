"""Topics behind a rosbridge server: those that rosld reads, and those that it publishes."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Collection, Mapping
from functools import partial
from typing import Any, cast

from msgspec import Struct

from rosld.adapters.bridge_connection import BridgeFeed, Echoes
from rosld.adapters.model import Graph, MessageSchema, NotFound, Refused, RosError, TypeRef, UnknownType, Unreachable
from rosld.adapters.model.plain import message_of
from rosld.adapters.rosbridge.client import Client
from rosld.adapters.thread import Tasks

_ANSWER_SECONDS = 5.0
_POLL_PAUSE = 0.3
_SETTLING = 0.2
"""Seconds for the subscribers of a topic to discover the bridge's new publisher, which no message reports."""


class Reader(Struct, eq=False):
    """A topic that the bridge sends; `take` receives the bytes of each message."""

    topic: str
    take: Callable[[bytes, TypeRef], None]
    schema: MessageSchema | None = None
    raw: bool = True
    is_subscribed: bool = False


class Readers:
    """The topics that rosld reads. `changed` is called when one is found to be unreadable."""

    def __init__(self, client: Client, graph: Callable[[], Graph], changed: Callable[[], None]) -> None:
        self.echoes = Echoes()
        self._client = client
        self._graph = graph
        self._changed = changed
        self._by_topic: dict[str, list[Reader]] = {}
        self._feeds: dict[str, tuple[BridgeFeed, Reader]] = {}
        self._sequences: dict[str, int] = {}
        self._tasks = Tasks()

    @property
    def topics(self) -> Collection[str]:
        """The topics that are read."""
        return self._by_topic.keys()

    def begin(self) -> None:
        """Subscribe to all topics again, on a new connection."""
        for of_topic in self._by_topic.values():
            for reader in of_topic:
                reader.is_subscribed, reader.raw = False, True

    def close(self) -> None:
        """Stop reading all topics."""
        self._tasks.cancel()
        for topic in self._by_topic:
            self._client.try_to_send({"op": "unsubscribe", "topic": topic})

    def read(self, feed: BridgeFeed) -> None:
        """Start reading a topic."""
        reader = self.listen(feed.topic, partial(self._put, feed))
        self._feeds[feed.topic] = feed, reader
        self._name_publisher(feed)

    def stop_reading(self, feed: BridgeFeed) -> None:
        """Stop reading a topic."""
        found = self._feeds.get(feed.topic)
        if found is not None and found[0] is feed:
            del self._feeds[feed.topic]
            self.leave(found[1])

    def listen(self, topic: str, take: Callable[[bytes, TypeRef], None], schema: MessageSchema | None = None) -> Reader:
        """Read a topic, without `schema` one that is in the graph, as soon as possible until `leave`."""
        reader = Reader(topic, take, schema)
        self._by_topic.setdefault(topic, []).append(reader)
        self._tasks.begin(self.subscribe())
        return reader

    def leave(self, reader: Reader) -> None:
        """Stop reading a topic, unless somebody else reads it."""
        of_topic = self._by_topic.get(reader.topic, [])
        if reader in of_topic:
            of_topic.remove(reader)
        if not of_topic and self._by_topic.pop(reader.topic, None) is not None:
            self._client.try_to_send({"op": "unsubscribe", "topic": reader.topic})

    async def subscribe(self) -> None:
        """Subscribe to all topics that are read and exist."""
        for reader in [reader for of_topic in self._by_topic.values() for reader in of_topic]:
            if not reader.is_subscribed and self._client.is_connected:
                await self._subscribe(reader)

    async def _subscribe(self, reader: Reader) -> None:
        topic = self._graph().topics.get(reader.topic)
        name = reader.schema.ref.name if reader.schema else topic.types[0].name if topic and topic.types else None
        if name is None:
            return
        reader.is_subscribed = True
        try:
            until = asyncio.get_running_loop().time() + _ANSWER_SECONDS
            reader.schema = reader.schema or await self._client.types.message(name, until)
        except UnknownType as error:
            self._client.types.problems[name] = error.sentence
            self._changed()
            return
        if reader in self._by_topic.get(reader.topic, ()):
            self._send_subscription(reader)

    def _send_subscription(self, reader: Reader) -> None:
        """Ask for the messages of a topic as ROS serialized them, or else in JSON."""
        name = cast(MessageSchema, reader.schema).ref.name
        message = {
            "op": "subscribe",
            "id": f"subscribe:{reader.topic}",
            "topic": reader.topic,
            "type": self._client.type_name(name),
            "compression": "cbor-raw" if reader.raw else "none",
        }
        self._client.try_to_send(message)

    def receive(self, decoded: Mapping[str, Any]) -> None:
        """Process a message of a topic."""
        readers = self._by_topic.get(str(decoded.get("topic")), ())
        content = decoded.get("msg")
        for reader in readers:
            if reader.schema is None or not isinstance(content, dict):
                continue
            data = content.get("bytes")
            if not isinstance(data, bytes):
                with contextlib.suppress(ValueError):
                    data = reader.schema.codec.encode(message_of(reader.schema, content), self._client.encoding)
            if isinstance(data, bytes):
                reader.take(data, reader.schema.ref)

    def receive_status(self, decoded: Mapping[str, Any]) -> None:
        """Subscribe in JSON where the bridge refuses messages as ROS serialized them."""
        id = str(decoded.get("id") or "")
        for reader in self._by_topic.get(id.removeprefix("subscribe:"), ()):
            if id.startswith("subscribe:") and decoded.get("level") == "error" and reader.raw:
                reader.raw = False
                self._send_subscription(reader)

    def _put(self, feed: BridgeFeed, data: bytes, type: TypeRef) -> None:
        if self.echoes.take(feed.topic, data):
            return
        self._sequences[feed.topic] = sequence = self._sequences.get(feed.topic, 0) + 1
        feed.put(data, type, sequence)

    def name_publishers(self) -> None:
        """Attribute messages to the only publisher of their topic in the current graph."""
        for feed, _ in self._feeds.values():
            self._name_publisher(feed)

    def _name_publisher(self, feed: BridgeFeed) -> None:
        graph = self._graph()
        topic = graph.topics.get(feed.topic)
        others = {each.node for each in topic.publishers if each.node != graph.own_node} if topic else ()
        feed.publisher = next(iter(others)) if len(others) == 1 else ""


class Publication:
    """A topic that rosld publishes through the bridge."""

    def __init__(self, of: Publications, topic: str, schema: MessageSchema, latched: bool) -> None:
        self._of = of
        self.topic = topic
        self.ref = schema.ref
        self.schema = schema
        self.latched = latched

    @property
    def matched(self) -> int:
        """Number of subscribing nodes, without the bridge."""
        return self._of.subscribers(self.topic)

    async def wait_matched(self, count: int, until: float, patience: float) -> None:
        """Poll until there are `count` subscribers, or until a time."""
        await self._of.wait_matched(self, count, until)

    def send(self, data: bytes, latch: bool) -> None:
        """Publish a message; it is lost if the connection is."""
        self._of.send(self, data)


class Publications:
    """The topics that rosld publishes: what `LivePublications` promises. `poll` updates the graph."""

    def __init__(
        self, client: Client, echoes: Echoes, graph: Callable[[], Graph], poll: Callable[[], Awaitable[None]]
    ) -> None:
        self.by_topic: dict[str, Publication] = {}
        self._client = client
        self._echoes = echoes
        self._graph = graph
        self._poll = poll

    def suitable(self, topic: str, type: TypeRef, latch: bool) -> Publication | None:
        """Return the publication of a topic if messages of this type can be sent with it as it is."""
        found = self.by_topic.get(topic)
        is_fit = found is not None and found.ref.name == type.name and (found.latched or not latch)
        return found if is_fit and self._client.is_connected else None

    def is_latched(self, publication: Publication, latch: bool) -> bool:
        """Whether a message is latched: as its publication is."""
        return publication.latched

    def subscribers(self, topic: str) -> int:
        """Return the number of nodes that subscribe to a topic, without the bridge."""
        existing = self._graph().topics.get(topic)
        return len(existing.subscribers) if existing is not None else 0

    def begin(self) -> None:
        """Advertise all topics again, on a new connection."""
        for publication in self.by_topic.values():
            self._announce(publication)

    def close(self) -> None:
        """Stop publishing all topics."""
        for topic in self.by_topic:
            self._client.try_to_send({"op": "unadvertise", "topic": topic})

    async def advertise(self, topic: str, type: TypeRef, latch: bool, until: float) -> Publication:
        """Publish a topic, and wait for a subscriber and until it knows the bridge.

        Raises Refused, Unreachable, UnknownType.
        """
        if not self._client.is_connected:
            raise Unreachable(f"the rosbridge server at {self._client.url} is not connected")
        before = self.by_topic.get(topic)
        if before is not None and before.ref.name != type.name:
            raise Refused(f"rosld publishes {topic} as {before.ref.name}, not {type.name}")
        schema = await self._client.types.message(type.name, until)
        publication = Publication(self, topic, schema, latch or (before is not None and before.latched))
        self.by_topic[topic] = publication
        if before is not None:
            self._client.try_to_send({"op": "unadvertise", "topic": topic})
        self._announce(publication)
        await self._poll()
        await self.wait_matched(publication, 1, until)
        left = until - asyncio.get_running_loop().time()
        if publication.matched and left > 0:
            await asyncio.sleep(min(left, _SETTLING))
        return publication

    async def wait_matched(self, publication: Publication, count: int, until: float) -> None:
        """Poll until there are `count` subscribers, or until a time."""
        loop = asyncio.get_running_loop()
        while publication.matched < count and loop.time() < until:
            await self._poll()
            await asyncio.sleep(min(_POLL_PAUSE, max(until - loop.time(), 0.0)))

    def unadvertise(self, topic: str) -> None:
        """Stop publishing a topic. Raises NotFound."""
        if self.by_topic.pop(topic, None) is None:
            raise NotFound(f"rosld does not publish {topic}")
        self._client.try_to_send({"op": "unadvertise", "topic": topic})

    def send(self, publication: Publication, data: bytes) -> None:
        """Publish a message, which is lost without a connection; expect its echo."""
        with contextlib.suppress(RosError, ValueError):
            message = publication.schema.codec.decode(data, self._client.encoding)
            values = self._client.plain(publication.schema, message)
            self._client.send({"op": "publish", "topic": publication.topic, "msg": values})
            self._echoes.note(publication.topic, data)

    def _announce(self, publication: Publication) -> None:
        type = self._client.type_name(publication.ref.name)
        message = {"op": "advertise", "topic": publication.topic, "type": type, "latch": publication.latched}
        self._client.try_to_send(message)
