"""Recording of live topics: which sinks record which topics, their subscriptions, and the writer thread."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Awaitable, Callable, Collection, Sequence
from fnmatch import fnmatchcase

from rosld.adapters.base import Adapter
from rosld.adapters.model import Sample, TypeRef
from rosld.server.history.recorder import Recorder, Sink
from rosld.server.history.topic_feed import LiveFeed


class LiveRecorder:
    """Recorder of a robot's topics to sinks. Starts with the first sink. Belongs to the event loop."""

    def __init__(self, adapter: Adapter, learn: Callable[[TypeRef], Awaitable[object]]) -> None:
        self._adapter = adapter
        self._recorder = Recorder()
        self._feed = LiveFeed(adapter, self._recorder, self._sinks_of, learn)
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
        self._feed.assign()
        latched = self._feed.latched.messages(selects)

        def start() -> None:
            self._recorder.add_sink(sink)
            copied = () if begin is None else begin()
            for topic, sample in latched:
                if topic not in copied:
                    sink.add(topic, sample)

        self._recorder.run(start)
        if not self._running:
            self._running = True
            self._recorder.start()
            self._feed.start()

    def latched(self, sink: Sink) -> list[tuple[str, Sample]]:
        """Return the latched messages of a sink's topics, in the order of receipt (thread-safe)."""
        selects = self._selectors.get(sink)
        return [] if selects is None else self._feed.latched.messages(selects)

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
        self._feed.take()
        self._feed.assign()
        loop, done = asyncio.get_running_loop(), asyncio.Event()

        def close() -> None:
            self._recorder.remove_sink(sink)
            try:
                sink.close()
            finally:
                loop.call_soon_threadsafe(done.set)

        self._recorder.run(close)
        await done.wait()

    def dropped(self) -> Counter[str]:
        """Return the numbers of lost messages by topic."""
        counts: Counter[str] = Counter()
        for each in (self._recorder.dropped, self._feed.dropped):
            counts.update(dict(each))
        return counts

    def topics(self) -> Collection[str]:
        """Return the topics that are recorded now."""
        return self._feed.topics()

    def refresh(self) -> None:
        """Update the recorded topics, after a change of the graph."""
        self._feed.refresh()

    async def stop(self) -> None:
        """Record pending messages, and close all sinks. Idempotent."""
        if self._running:
            self._running = False
            await self._feed.stop()
            await asyncio.to_thread(self._recorder.stop)

    def _sinks_of(self, topic: str) -> tuple[Sink, ...]:
        return tuple(sink for sink, selects in self._selectors.items() if selects(topic))
