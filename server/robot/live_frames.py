"""The frames of a live robot: `/tf` and `/tf_static` are followed while somebody looks, and a while longer."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable

from rosld.adapters.base import Adapter, Watch
from rosld.adapters.model import RosError
from rosld.server.history.topic_feed import PERIOD, TopicFeed
from rosld.server.robot.fold import QUEUE_DEPTH
from rosld.server.robot.schemas import Schemas
from rosld.server.runtime.tasks import Signal, end_tasks, loop_time
from rosld.server.space.frame_buffer import STATIC_TOPIC, TOPICS, TYPES, FrameBuffer


class LiveFrames:
    """The frames of one robot, shared by all who look.

    `buffer` is as new as the last `refresh`. `idle`: seconds after the last look until nothing is followed any more;
    `first_value`: how long the first look waits for a transform.
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
        self._looked_at = 0.0
        self._task: asyncio.Task[None] | None = None
        self._turn = asyncio.Lock()

    async def look(self) -> FrameBuffer:
        """The frames as of now; the first call waits a moment for what is published."""
        self._looked_at = loop_time()
        if self._task is None:
            self._task = asyncio.get_running_loop().create_task(self._run())
            await self._wait()
        await self.refresh()
        return self.buffer

    def watch(self, wake: Callable[[], None]) -> Watch:
        """Call `wake` after a transform came, as long as somebody looks."""
        return self._changes.watch(wake)

    async def refresh(self) -> None:
        """Take the transforms that came since."""
        async with self._turn:
            for topic in TOPICS:
                with contextlib.suppress(RosError):
                    await self._take(topic)

    async def stop(self) -> None:
        """Give the subscriptions back. Idempotent."""
        task, self._task = self._task, None
        if task is not None:
            await end_tasks([task])
        self._close()

    async def _run(self) -> None:
        while loop_time() - self._looked_at < self._idle:
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
        """Until all topics of frames have told something, at most as long as may be."""
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
                with contextlib.suppress(ValueError):  # bytes that are no such message tell of no frame
                    message = schema.codec.decode(sample.data, sample.encoding)
                    self.buffer.add(message, sample, is_static=topic == STATIC_TOPIC)
