"""Topics behind a rosbridge server that rosld reads."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Collection, Mapping
from typing import Any

from msgspec import Struct

from rosld.adapters.model import MessageSchema, TypeRef, UnknownType
from rosld.adapters.model.plain import message_of
from rosld.adapters.rosbridge.client import Client
from rosld.adapters.thread import Tasks

_ANSWER_SECONDS = 5.0


class Reader(Struct, eq=False):
    """A topic that the bridge sends; `take` receives the bytes of each message, and `find_type` returns its type."""

    topic: str
    take: Callable[[bytes, TypeRef], None]
    find_type: Callable[[str], str | None]
    schema: MessageSchema | None = None
    is_subscribed: bool = False


class Readers:
    """The topics that rosld reads. `changed` is called when one is found to be unreadable."""

    def __init__(self, client: Client, changed: Callable[[], None]) -> None:
        self._client = client
        self._changed = changed
        self._by_topic: dict[str, list[Reader]] = {}
        self._tasks = Tasks()

    @property
    def topics(self) -> Collection[str]:
        """The topics that are read."""
        return self._by_topic.keys()

    def begin(self) -> None:
        """Forget the subscriptions of a former connection."""
        for of_topic in self._by_topic.values():
            for reader in of_topic:
                reader.is_subscribed = False

    def close(self) -> None:
        """Stop reading all topics."""
        self._tasks.cancel()
        for topic in self._by_topic:
            self._client.try_to_send({"op": "unsubscribe", "topic": topic})

    def listen(
        self, topic: str, take: Callable[[bytes, TypeRef], None], find_type: Callable[[str], str | None]
    ) -> Reader:
        """Read a topic until `leave`, as soon as its type is known."""
        reader = Reader(topic, take, find_type)
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
        """Subscribe to all topics that are read and whose types are known."""
        for reader in [reader for of_topic in self._by_topic.values() for reader in of_topic]:
            name = reader.find_type(reader.topic)
            if name is not None and not reader.is_subscribed and self._client.is_connected:
                reader.is_subscribed = True
                await self._subscribe(reader, name)

    async def _subscribe(self, reader: Reader, name: str) -> None:
        try:
            until = asyncio.get_running_loop().time() + _ANSWER_SECONDS
            reader.schema = await self._client.types.message(TypeRef(name), until)
        except UnknownType as error:
            self._client.types.problems[name] = error.sentence
            self._changed()
            return
        if reader in self._by_topic.get(reader.topic, ()):
            # Bridges that do not know cbor-raw, the messages as ROS serialized them, send JSON instead.
            message = {"op": "subscribe", "id": f"subscribe:{reader.topic}", "compression": "cbor-raw"}
            type = self._client.type_name(name)
            self._client.try_to_send({**message, "topic": reader.topic, "type": type})

    def receive(self, decoded: Mapping[str, Any]) -> None:
        """Process a message of a topic."""
        content = decoded.get("msg")
        for reader in self._by_topic.get(str(decoded.get("topic")), ()):
            if reader.schema is None or not isinstance(content, dict):
                continue
            data = content.get("bytes")
            if not isinstance(data, bytes):
                with contextlib.suppress(ValueError):
                    data = reader.schema.codec.encode(message_of(reader.schema, content), self._client.encoding)
            if isinstance(data, bytes):
                reader.take(data, reader.schema.ref)
