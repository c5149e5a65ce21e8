"""The scene of the robot: its frames, and the drawings of messages in them."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable, Sequence

import orjson
from msgspec import Struct

from rosld.adapters.base import Adapter, Watch
from rosld.adapters.model import MessageSchema, RosError, Sample
from rosld.server.history.topic_feed import PERIOD, TopicFeed
from rosld.server.robot.live_topics import LiveTopics
from rosld.server.robot.schemas import Schemas
from rosld.server.robot.session import Session
from rosld.server.robot.topic_view import QUEUE_DEPTH
from rosld.server.runtime.tasks import Signal, end_tasks, loop_time
from rosld.server.space.drawing import Drawing, drawing_json, place_sample
from rosld.server.space.transforms import STATIC_TOPIC, TOPICS, TYPES, FrameBuffer, FrameRow

_LARGE = 64 * 1024
"""Minimum number of bytes of a message that is drawn in a thread."""
_MAX_CACHED = 256
_SETTLE_SECONDS = 0.1
"""Maximum time to wait for transforms as new as the latest messages: two periods of 20 Hz."""
_ACTIVE_NS = 1_000_000_000
"""Age of a moving frame's last transform above which none is waited for."""


class DrawnSample(Struct, frozen=True, eq=False):
    """A sample and its drawing, also as JSON; or a sentence on why there is no drawing."""

    sample: Sample
    drawing: Drawing | None
    json: bytes
    problem: str = ""


class Drawings:
    """Drawings of one robot's topics."""

    def __init__(self, topics: LiveTopics, schemas: Schemas) -> None:
        self._topics = topics
        self._schemas = schemas
        self._cached: dict[str, DrawnSample] = {}
        self._turns: dict[str, asyncio.Lock] = {}

    async def newest(self, topic: str) -> DrawnSample | None:
        """Return the drawing of the newest message of a subscribed topic, None without a message."""
        view = self._topics.find_view(topic)
        sample = None if view is None else view.newest
        if sample is None:
            return None
        cached = self._cached.get(topic)
        if cached is not None and cached.sample is sample:
            return cached
        async with self._turns.setdefault(topic, asyncio.Lock()):
            cached = self._cached.get(topic)  # another task may have drawn it in the meantime
            if cached is None or cached.sample is not sample:
                cached = await self._draw(sample)
                self._cached.pop(topic, None)
                self._cached[topic] = cached
                while len(self._cached) > _MAX_CACHED:
                    oldest = next(iter(self._cached))
                    del self._cached[oldest]
                    self._turns.pop(oldest, None)
        return cached

    async def _draw(self, sample: Sample) -> DrawnSample:
        try:
            schema = await self._schemas.message(sample.schema)
            if len(sample.data) > _LARGE:
                return await asyncio.to_thread(_draw_sample, schema, sample)
            return _draw_sample(schema, sample)
        except (RosError, ValueError, MemoryError) as error:
            return DrawnSample(sample, None, b"null", f"{error}" or "This cannot be displayed")


def _draw_sample(schema: MessageSchema, sample: Sample) -> DrawnSample:
    drawing = place_sample(schema, sample)
    return DrawnSample(sample, drawing, orjson.dumps(drawing_json(drawing), option=orjson.OPT_SERIALIZE_NUMPY))


class LiveFrames:
    """The frames of one robot, shared by all readers.

    `buffer` is as new as the last `refresh`. `idle`: seconds after the last read until nothing is followed any more;
    `first_value`: seconds that the first read waits for a transform.
    """

    def __init__(self, adapter: Adapter, schemas: Schemas, *, idle: float, first_value: float) -> None:
        self.buffer = FrameBuffer()
        self._adapter = adapter
        self._schemas = schemas
        self._idle = idle
        self._first_value = first_value
        self._feeds: dict[str, TopicFeed] = {}
        self._changes = Signal()
        self._watches: list[Watch] = []
        self._read_at = 0.0
        self._task: asyncio.Task[None] | None = None
        self._turn = asyncio.Lock()

    async def look(self) -> FrameBuffer:
        """Return the current frames; the first call waits a moment for transforms."""
        self._read_at = loop_time()
        if self._task is None:
            self._task = asyncio.get_running_loop().create_task(self._run())
            await self._wait()
        await self.refresh()
        return self.buffer

    async def settle(self) -> Sequence[FrameRow]:
        """Return all transforms, after waiting a moment for those that are newer than this call."""
        now, end = time.time_ns(), loop_time() + _SETTLE_SECONDS
        moving = [each for each in (await self.look()).newest.values() if not each.is_static]
        names = [each.child for each in moving if each.source.received_ns > now - _ACTIVE_NS]
        while loop_time() < end:
            newest = self.buffer.newest
            if all(name not in newest or newest[name].source.received_ns >= now for name in names):
                break
            await asyncio.sleep(_SETTLE_SECONDS / 10)
            await self.refresh()
        return self.buffer.rows()

    def watch(self, wake: Callable[[], None]) -> Watch:
        """Call `wake` after each new transform, as long as the frames are read."""
        return self._changes.watch(wake)

    async def refresh(self) -> None:
        """Read the transforms received since the last refresh."""
        async with self._turn:
            for topic in TOPICS:
                with contextlib.suppress(RosError):
                    await self._take(topic)

    async def stop(self) -> None:
        """Close the subscriptions. Idempotent."""
        task, self._task = self._task, None
        if task is not None:
            await end_tasks([task])
        self._close()

    async def _run(self) -> None:
        while loop_time() - self._read_at < self._idle:
            await self.refresh()
            await asyncio.sleep(PERIOD)
        self._close()
        self._task = None

    def _close(self) -> None:
        for watch in self._watches:
            watch.close()
        for feed in self._feeds.values():
            feed.subscription.close()
        self._watches, self._feeds, self.buffer = [], {}, FrameBuffer()

    async def _wait(self) -> None:
        """Wait until all frame topics have a message, or the deadline."""
        there = [topic for topic in TOPICS if self._is_there(topic)]
        end = loop_time() + self._first_value
        while there and loop_time() < end:
            await self.refresh()
            if all((feed := self._feeds.get(topic)) is not None and feed.subscription.latest() for topic in there):
                return
            await asyncio.sleep(0.02)

    def _is_there(self, topic: str) -> bool:
        entry = self._adapter.graph.topics.get(topic)
        return entry is not None and any(ref.name in TYPES for ref in entry.types)

    async def _take(self, topic: str) -> None:
        feed = self._feeds.get(topic)
        if feed is None:
            if not self._is_there(topic):
                return
            subscription = await self._adapter.subscribe(topic, depth=QUEUE_DEPTH)
            feed = self._feeds[topic] = TopicFeed(topic, subscription, QUEUE_DEPTH)
            self._watches.append(subscription.watch(self._changes.emit))
        for sample in feed.take():
            schema = await self._schemas.message(sample.schema)
            if schema.ref.name in TYPES:
                with contextlib.suppress(ValueError):  # undecodable messages contain no frames
                    message = schema.codec.decode(sample.data, sample.encoding)
                    self.buffer.add(message, sample, is_static=topic == STATIC_TOPIC)


class Scene:
    """Frames and drawings of one robot."""

    def __init__(self, session: Session) -> None:
        settings = session.settings
        self.frames = LiveFrames(
            session.adapter, session.schemas, idle=settings.idle_time, first_value=settings.first_value_wait
        )
        self.drawings = Drawings(session.topics, session.schemas)
