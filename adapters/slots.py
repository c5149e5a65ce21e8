"""Feeds: the newest samples of each publisher of one topic, and the watches of those who wait for more.

A feed belongs to the server's loop. Nothing here is thread-safe, and nothing costs more than a few microseconds: a
sample that nobody looks at replaces one entry.
"""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from rosld.adapters.base import Watch
from rosld.adapters.model import Sample


class LoopWatch:
    """One running watch: coalesces what arrives in one turn of the loop into one wake."""

    def __init__(self, wake: Callable[[], None], among: dict[LoopWatch, None]) -> None:
        self._wake: Callable[[], None] | None = wake
        self._among = among
        self._loop = asyncio.get_running_loop()
        self._due = False
        among[self] = None

    def notify(self) -> None:
        """Wake in the next turn of the loop."""
        if not self._due:
            self._due = True
            self._loop.call_soon(self._run)

    def _run(self) -> None:
        self._due = False
        if self._wake is not None:
            self._wake()

    def close(self) -> None:
        """Stop waking, one that is already due included. Idempotent."""
        self._wake = None
        self._among.pop(self, None)


class Feed(ABC):
    """The newest samples of one topic, for all its subscriptions.

    `changed` is called with the feed when `depth`, the greatest of its subscriptions, changes, and after the last one.
    """

    def __init__(self, changed: Callable[[Any], None] = lambda _: None) -> None:
        self.depth = 1
        self.subscriptions: list[TopicSubscription] = []
        self.watches: dict[LoopWatch, None] = {}
        self._changed = changed

    @abstractmethod
    def latest(self, depth: int = 1) -> Sequence[Sample]:
        """Return the newest `depth` samples of each publisher by time of receipt, the same object until one arrives."""

    def watch(self, wake: Callable[[], None]) -> LoopWatch:
        """Wake on the loop after something new arrived, until the watch is closed. To be called on the loop."""
        return LoopWatch(wake, self.watches)

    def notify(self) -> None:
        """Wake the watches."""
        for watch in self.watches:
            watch.notify()

    def subscribe(self, depth: int = 1) -> TopicSubscription:
        """Keep at least `depth` samples of each publisher until the subscription is closed.

        Raises ValueError for a depth below 1.
        """
        if depth < 1:
            raise ValueError(f"a depth of {depth} holds no sample: it must be 1 or more")
        subscription = TopicSubscription(self, depth)
        self.subscriptions.append(subscription)
        self.fit()
        return subscription

    def fit(self) -> None:
        """Keep as many samples as the deepest subscription needs."""
        depth = max((each.depth for each in self.subscriptions), default=1)
        if depth != self.depth or not self.subscriptions:
            self.depth = depth
            self._changed(self)


class TopicSubscription:
    """Subscription to a topic. After `close` it is empty and wakes nothing."""

    def __init__(self, feed: Feed, depth: int) -> None:
        self.depth = depth
        self._feed: Feed | None = feed
        self._watches: list[LoopWatch] = []

    def latest(self) -> Sequence[Sample]:
        """Return the newest samples of each publisher, in order of receipt."""
        return () if self._feed is None else self._feed.latest(self.depth)

    def watch(self, wake: Callable[[], None]) -> Watch:
        """Wake on the loop after something new arrived; ends with the subscription."""
        if self._feed is None:
            return LoopWatch(wake, {})
        watch = self._feed.watch(wake)
        self._watches.append(watch)
        return watch

    def close(self) -> None:
        """End the subscription. Idempotent."""
        if self._feed is not None:
            feed, self._feed = self._feed, None
            for watch in self._watches:
                watch.close()
            feed.subscriptions.remove(self)
            feed.fit()


class Slot(Feed):
    """A feed of samples that are put there one by one."""

    def __init__(self) -> None:
        super().__init__(Slot._resize)
        self._samples: dict[str, deque[Sample]] = {}
        self._views: dict[int, tuple[Sample, ...]] = {}

    def put(self, sample: Sample) -> None:
        """Keep a sample as its publisher's newest."""
        samples = self._samples.get(sample.publisher)
        if samples is None:
            samples = self._samples[sample.publisher] = deque(maxlen=self.depth)
        samples.append(sample)
        self._on_change()

    def drop(self, publisher: str) -> None:
        """Forget what a publisher sent; nothing happens where it sent nothing."""
        if self._samples.pop(publisher, None) is not None:
            self._on_change()

    def latest(self, depth: int = 1) -> Sequence[Sample]:
        """Return the newest samples of each publisher, the same object until one arrives."""
        view = self._views.get(depth)
        if view is None:
            newest = [sample for samples in self._samples.values() for sample in tuple(samples)[-depth:]]
            view = self._views[depth] = tuple(sorted(newest, key=received_ns))
        return view

    def _resize(self) -> None:
        self._samples = {name: deque(samples, maxlen=self.depth) for name, samples in self._samples.items()}
        self._views.clear()

    def _on_change(self) -> None:
        self._views.clear()
        self.notify()


def received_ns(sample: Sample) -> int:
    """Return the time of receipt, the key to sort samples by."""
    return sample.received_ns
