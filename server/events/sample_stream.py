"""Event stream of numeric fields, with every message of their topics instead of only the newest."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Awaitable, Callable, Mapping, Sequence
from itertools import islice
from typing import NamedTuple, TypeAlias

import numpy as np
import orjson

from rosld.adapters.base import Adapter
from rosld.adapters.model import Message, MessageSchema, RosError, Sample, TypeRef
from rosld.ontology.fields import field_at
from rosld.server.events.broadcaster import Broadcasters
from rosld.server.events.event_stream import HEADERS, EndlessResponse, EventWriter, SendChunk, event_frame
from rosld.server.history.topic_feed import MAX_BYTES, TopicFeed

PERIOD = 0.1
"""Seconds between two events."""
MAX_ELEMENTS = 16
"""Maximum number of array elements in an event."""
_DEPTH = 32
_MOST = 200
"""Maximum number of messages of a topic per event; of more, every second, third etc. is sent, and the newest."""

NAMED_ARRAYS: Mapping[str, tuple[str, ...]] = {"sensor_msgs/msg/JointState": ("position", "velocity", "effort")}
"""Arrays of a type whose elements are named by the neighbouring array `name`."""

Numbers: TypeAlias = "float | list[float | None] | None"
"""A number, or those of an array; None for anything but a finite number."""
SchemaOf: TypeAlias = Callable[[TypeRef], Awaitable[MessageSchema]]


class FollowedTopic(NamedTuple):
    """A topic and the paths of its numbers, each with its index in the stream."""

    topic: str
    fields: tuple[tuple[int, str], ...]


class SampleStream(EndlessResponse):
    """Stream of the numbers of topics, until its reader disconnects or the server ends.

    Each event is a JSON list with an object for each topic that has new messages: `times` in milliseconds since 1970,
    `values` by index, each as long as `times`, and `lost`, the number of skipped messages. `names` by index are the
    robot's names of array elements, if its messages contain them.
    """

    def __init__(
        self,
        broadcasters: Broadcasters,
        adapter: Adapter,
        schema_of: SchemaOf,
        topics: Sequence[FollowedTopic],
        is_valid: Callable[[], bool],
    ) -> None:
        """Initialize; `is_valid` returns whether the reader is still permitted to read."""
        super().__init__(broadcasters, HEADERS)
        self._adapter = adapter
        self._numbers = [TopicNumbers(each, schema_of) for each in topics]
        self._is_valid = is_valid

    async def write(self, send_chunk: SendChunk) -> None:
        writer = EventWriter(send_chunk)
        await writer.open()
        try:
            while self._is_valid():
                points = [found for each in self._numbers if (found := await each.take(self._adapter)) is not None]
                await (writer.send(event_frame(orjson.dumps(points))) if points else writer.keep_alive())
                await asyncio.sleep(PERIOD)
        finally:
            for each in self._numbers:
                each.close()


class TopicNumbers:
    """New numbers of one topic."""

    def __init__(self, followed: FollowedTopic, schema_of: SchemaOf) -> None:
        self._followed = followed
        self._schema_of = schema_of
        self._schemas: dict[TypeRef, MessageSchema] = {}
        self._feed: TopicFeed | None = None

    async def take(self, adapter: Adapter) -> dict[str, object] | None:
        """Return the new values; None without any, or if the topic cannot be subscribed to now."""
        with contextlib.suppress(RosError):
            if self._feed is None:
                subscription = await adapter.subscribe(self._followed.topic, depth=_DEPTH)
                self._feed = TopicFeed(self._followed.topic, subscription, _DEPTH)
            return await self._take(adapter, self._feed)
        return None

    def close(self) -> None:
        """Close the subscription. Idempotent."""
        feed, self._feed = self._feed, None
        if feed is not None:
            feed.subscription.close()

    async def _take(self, adapter: Adapter, feed: TopicFeed) -> dict[str, object] | None:
        new = feed.take()
        lost, feed.dropped = feed.dropped, 0
        depth = feed.next_depth(new, MAX_BYTES) if new else feed.depth
        if depth != feed.depth:
            await feed.resubscribe(adapter, depth)
        selected = _thinned(new)
        lost += len(new) - len(selected)
        if not selected and not lost:
            return None
        rows, names, fields = list[list[Numbers]](), dict[str, list[str]](), self._followed.fields
        for sample in selected:
            message = await self._decode(sample)
            rows.append([None if message is None else number_at(*message, path) for _, path in fields])
            if message is not None and sample is selected[-1]:
                names = {str(place): found for place, path in fields if (found := element_names(*message, path))}
        return {
            "times": [each.received_ns / 1e6 for each in selected],
            "values": {str(place): [row[column] for row in rows] for column, (place, _) in enumerate(fields)},
            "lost": lost,
            **({"names": names} if names else {}),
        }

    async def _decode(self, sample: Sample) -> tuple[MessageSchema, Message] | None:
        """Return the message of a sample and its schema, None if it cannot be decoded."""
        schema = self._schemas.get(sample.schema)
        if schema is None:
            schema = self._schemas[sample.schema] = await self._schema_of(sample.schema)
        try:
            return schema, schema.codec.decode(sample.data, sample.encoding)
        except ValueError:
            return None


def number_at(schema: MessageSchema, message: Message, path: str) -> Numbers:
    """Return the number, or the first numbers of the array, at a path of a message; None if there is none."""
    try:
        _, value = field_at(schema, message, path)
    except ValueError:
        return None
    if isinstance(value, list | tuple | np.ndarray):
        return [_finite(each) for each in islice(value, MAX_ELEMENTS)]
    return _finite(value)


def element_names(schema: MessageSchema, message: Message, path: str) -> list[str]:
    """Return the robot's names of the numbers at a path of a message; empty unless each has one."""
    if path not in NAMED_ARRAYS.get(schema.ref.name, ()):
        return []
    names, values = list(getattr(message, "name", ())), getattr(message, path, ())
    return [str(each) for each in names[:MAX_ELEMENTS]] if len(names) == len(values) else []


def _finite(value: object) -> float | None:
    if isinstance(value, str) or not hasattr(value, "__float__"):
        return None
    number = float(value)
    return number if math.isfinite(number) else None


def _thinned(samples: Sequence[Sample]) -> Sequence[Sample]:
    """Return a limited number of values, evenly spaced, including the newest."""
    if len(samples) <= _MOST:
        return samples
    step = -(-len(samples) // _MOST)
    return samples[::-1][::step][::-1]
