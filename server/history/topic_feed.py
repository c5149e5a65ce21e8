"""Recording of live topics: deep subscriptions, polled ten times a second, and the sinks that record them."""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from collections.abc import Awaitable, Callable, Collection, Iterable, Sequence
from fnmatch import fnmatchcase

from rosld.adapters.base import Adapter, Subscription
from rosld.adapters.model import RosError, Sample, TypeRef
from rosld.server.history.recorder import SAMPLE_OVERHEAD, Arrival, LatchedMessages, Recorder, Sink
from rosld.server.runtime.tasks import Background, end_tasks

log = logging.getLogger("rosld.history")
PERIOD = 0.1
"""Seconds between polls."""
_DEPTH = 32
_MAX_DEPTH = 4096
MAX_BYTES = 32 * 1024 * 1024
"""Maximum bytes of a subscription's queue: a deep one of large messages would exhaust the robot's memory."""
_MAX_ALL_BYTES = 64 * 1024 * 1024
"""Maximum bytes of all queues together, in equal shares, beyond their initial depth."""
_CALM = 300
"""Number of polls, half a minute, after which an underused queue is made shallower."""
_MAX_DELAYED = 1000


class TopicFeed:
    """Feed of one topic: the position reached in its queue, and the depth that it needs."""

    def __init__(self, topic: str, subscription: Subscription, depth: int) -> None:
        self.topic = topic
        self.depth = depth
        self.subscription = subscription
        self.dropped = 0
        """Number of messages that left the queue before they were read."""
        self._latest: Sequence[Sample] = ()
        self._positions: dict[str, tuple[int, int]] = {}
        self._most = 0
        self._polls = 0

    def take(self) -> list[Sample]:
        """Return the new messages, in the order of receipt."""
        latest = self.subscription.latest()
        if latest is self._latest:
            return []
        self._latest = latest
        new: list[Sample] = []
        single = len(self._positions) == 1
        for sample in reversed(latest):
            position = self._positions.get(sample.publisher)
            if position is None or (sample.epoch, sample.sequence) > position:
                new.append(sample)
            elif single:
                break  # all others are older
        new.reverse()
        for sample in new:
            self._note(sample)
        return new

    def next_depth(self, new: Sequence[Sample], max_bytes: int) -> int:
        """Return the depth that the queue needs for the messages of four polls, within `max_bytes`.

        The depth decreases only after `_CALM` polls that needed much less, so that a burst does not use memory forever.
        """
        self._polls += 1
        self._most = max(self._most, len(new))
        if len(new) * 4 >= self.depth:
            largest = max(len(sample.data) for sample in new) + SAMPLE_OVERHEAD
            return max(min(self.depth * 4, _MAX_DEPTH, max_bytes // largest), self.depth)
        if self._polls < _CALM:
            return self.depth
        most, self._most, self._polls = self._most, 0, 0
        return max(self.depth // 4, _DEPTH) if most * 32 < self.depth else self.depth

    async def resubscribe(self, adapter: Adapter, depth: int) -> None:
        """Subscribe with another depth, then close the previous subscription."""
        subscription = await adapter.subscribe(self.topic, depth=depth)
        self.subscription.close()
        self.subscription, self.depth = subscription, depth

    def _note(self, sample: Sample) -> None:
        name, now = sample.publisher, (sample.epoch, sample.sequence)
        previous = self._positions.get(name)
        if previous is not None and previous[0] == now[0]:
            self.dropped += max(now[1] - previous[1] - 1, 0)
        if previous is None and name and "" in self._positions:
            del self._positions[""]  # the name of the publisher is known by now
        self._positions[name] = now


class LiveFeed(Background):
    """Feeds of all recorded topics. `sinks_of` returns the sinks of a topic; without any, it is not recorded.

    `learn` loads the type of a message before the first message of it is recorded.
    """

    def __init__(
        self,
        adapter: Adapter,
        recorder: Recorder,
        sinks_of: Callable[[str], tuple[Sink, ...]],
        learn: Callable[[TypeRef], Awaitable[object]],
    ) -> None:
        self.dropped: Counter[str] = Counter()
        """Messages that left the queues before they were read, by topic."""
        self.latched = LatchedMessages()
        """Latched messages of recorded topics whose publishers exist and whose types are known."""
        self._adapter = adapter
        self._recorder = recorder
        self._sinks_of = sinks_of
        self._learn = learn
        self._feeds: dict[str, TopicFeed] = {}
        self._sinks: dict[str, tuple[Sink, ...]] = {}
        self._loaded_types: set[TypeRef] = set()
        self._delayed: dict[TypeRef, list[Arrival]] = {}
        self._learning: set[asyncio.Task[None]] = set()
        self._changed = True

    def assign(self) -> None:
        """Assign topics to sinks after a change of recordings."""
        self._sinks = {topic: sinks for topic in self._feeds if (sinks := self._sinks_of(topic))}
        self._changed = True

    def topics(self) -> Collection[str]:
        """Return the topics that are recorded now."""
        return self._feeds.keys()

    def take(self) -> None:
        """Pass new messages to the recorder now."""
        self._poll()

    def refresh(self) -> None:
        """Update the recorded topics at the next poll, after a change of the graph or of the recordings."""
        self._changed = True

    async def stop(self) -> None:
        """Pass the remaining messages on, and close every subscription. Idempotent."""
        if self._task is None:
            return
        await super().stop()
        await end_tasks(self._learning)
        self._poll()
        for feed in self._feeds.values():
            feed.subscription.close()
        self._feeds.clear()

    async def _run(self) -> None:
        while True:
            if self._changed:
                self._changed = False
                await self._follow(self._adapter.graph.topics)
            for feed, depth in self._poll():
                await feed.resubscribe(self._adapter, depth)
            await asyncio.sleep(PERIOD)

    async def _follow(self, topics: Iterable[str]) -> None:
        """Subscribe to recorded topics, and unsubscribe from all others."""
        self._sinks = {topic: sinks for topic in topics if (sinks := self._sinks_of(topic))}
        for topic in self._sinks.keys() - self._feeds.keys():
            try:
                self._feeds[topic] = TopicFeed(topic, await self._adapter.subscribe(topic, depth=_DEPTH), _DEPTH)
            except RosError as error:
                log.warning("%s cannot be recorded: %s", topic, error)
                self._changed = True
        for topic in self._feeds.keys() - self._sinks.keys():
            self._feeds.pop(topic).subscription.close()
        self.latched.keep(self._is_published)

    def _is_published(self, topic: str, publisher: str) -> bool:
        """Whether a topic is recorded and published by a node; an unnamed publisher matches any."""
        entry = self._adapter.graph.topics.get(topic)
        publishers = () if entry is None else entry.publishers
        return topic in self._feeds and any(publisher in (each.node, "") for each in publishers)

    def _poll(self) -> list[tuple[TopicFeed, int]]:
        """Pass new messages to the recorder; return the feeds whose depth should change, with the new depth."""
        arrivals: list[Arrival] = []
        changes: list[tuple[TopicFeed, int]] = []
        max_bytes = min(MAX_BYTES, _MAX_ALL_BYTES // max(len(self._feeds), 1))
        for topic, feed in self._feeds.items():
            new = feed.take()
            depth = feed.next_depth(new, max_bytes)
            if depth != feed.depth:
                changes.append((feed, depth))
            sinks = self._sinks.get(topic, ())
            for sample in new:
                arrival = Arrival(topic, sample, sinks)
                if sample.schema in self._loaded_types:
                    self.latched.take(topic, sample)
                    arrivals.append(arrival)
                else:
                    self._delay(arrival)
            if feed.dropped:
                self.dropped[topic] += feed.dropped
                feed.dropped = 0
        if arrivals:
            self._recorder.put(arrivals)
        return changes

    def _delay(self, arrival: Arrival) -> None:
        type = arrival.sample.schema
        delayed = self._delayed.get(type)
        if delayed is None:
            delayed = self._delayed[type] = []
            task = asyncio.get_running_loop().create_task(self._learn_type(type))
            self._learning.add(task)
            task.add_done_callback(self._learning.discard)
        if len(delayed) < _MAX_DELAYED:
            delayed.append(arrival)
        else:
            self.dropped[arrival.topic] += 1

    async def _learn_type(self, type: TypeRef) -> None:
        try:
            await self._learn(type)
        except RosError:
            pass  # recorded without its definition
        finally:
            self._loaded_types.add(type)
            delayed = self._delayed.pop(type, [])
            for topic, sample, _ in delayed:
                self.latched.take(topic, sample)
            self._recorder.put([each._replace(sinks=self._sinks_since(each)) for each in delayed])

    def _sinks_since(self, arrival: Arrival) -> tuple[Sink, ...]:
        """Return the sinks of a delayed message, including those added meanwhile, which it may open."""
        return tuple(dict.fromkeys((*arrival.sinks, *self._sinks.get(arrival.topic, ()))))


class LiveRecorder:
    """Recorder of a robot's topics to sinks. Starts with the first sink. Belongs to the event loop."""

    def __init__(self, adapter: Adapter, learn: Callable[[TypeRef], Awaitable[object]]) -> None:
        self._adapter = adapter
        self.recorder = Recorder()
        self.feed = LiveFeed(adapter, self.recorder, self._sinks_of, learn)
        self._selectors: dict[Sink, Callable[[str], bool]] = {}
        self._running = False

    def add(
        self, sink: Sink, selects: Callable[[str], bool], begin: Callable[[], Collection[str]] | None = None
    ) -> None:
        """Record the topics for which `selects` is true to a sink from now on.

        `begin` is called first, on the recorder's thread; it passes earlier messages to the sink and returns their
        topics. For all other topics the sink receives the earlier latched messages.
        """
        self._selectors[sink] = selects
        self.feed.assign()
        latched = self.feed.latched.messages(selects)

        def start() -> None:
            self.recorder.add_sink(sink)
            copied = () if begin is None else begin()
            for topic, sample in latched:
                if topic not in copied:
                    sink.add(topic, sample)

        self.recorder.run(start)
        if not self._running:
            self._running = True
            self.recorder.start()
            self.feed.start()

    def latched(self, sink: Sink) -> list[tuple[str, Sample]]:
        """Return the latched messages of a sink's topics, in the order of receipt (thread-safe)."""
        selects = self._selectors.get(sink)
        return [] if selects is None else self.feed.latched.messages(selects)

    def silent(self, sink: Sink, globs: Sequence[str], recorded: Collection[str]) -> Sequence[str]:
        """Return the topics and globs of a sink that are not in `recorded`."""
        selects, topics = self._selectors.get(sink), self._adapter.graph.topics
        if selects is None:
            return ()
        idle = [glob for glob in globs if not any(fnmatchcase(topic, glob) for topic in (*topics, *recorded))]
        return sorted({*idle, *(topic for topic in topics if topic not in recorded and selects(topic))})

    async def remove(self, sink: Sink) -> None:
        """Stop recording to a sink, and close it."""
        if self._selectors.pop(sink, None) is None:
            return
        # In this order: messages received so far still belong to the sink, later ones do not.
        self.feed.take()
        self.feed.assign()
        loop, done = asyncio.get_running_loop(), asyncio.Event()

        def close() -> None:
            self.recorder.remove_sink(sink)
            try:
                sink.close()
            finally:
                loop.call_soon_threadsafe(done.set)

        self.recorder.run(close)
        await done.wait()

    def dropped(self) -> Counter[str]:
        """Return the numbers of lost messages by topic."""
        counts: Counter[str] = Counter()
        for each in (self.recorder.dropped, self.feed.dropped):
            counts.update(dict(each))
        return counts

    async def stop(self) -> None:
        """Record pending messages, and close all sinks. Idempotent."""
        if self._running:
            self._running = False
            await self.feed.stop()
            await asyncio.to_thread(self.recorder.stop)

    def _sinks_of(self, topic: str) -> tuple[Sink, ...]:
        return tuple(sink for sink, selects in self._selectors.items() if selects(topic))
