"""Subscriptions: the newest samples of each publisher, written by the reading thread and read by the server's.

No locks: a single thread replaces the `values` of a slot with one assignment; readers get either tuple.
"""

from __future__ import annotations

import asyncio
import contextlib
import operator
import time
from collections.abc import Callable, Mapping, Sequence

from rosld.adapters.model import Encoding, Sample, TypeRef
from rosld.adapters.ros1.tcpros import Frame


class Value:
    """A received frame, which is converted to a sample on first use."""

    __slots__ = ("_sample", "data", "epoch", "latched", "publisher", "received_ns", "schema", "sequence")

    def __init__(
        self, data: Frame, schema: TypeRef, publisher: str, received_ns: int, sequence: int, epoch: int, latched: bool
    ) -> None:
        self.data = data
        self.schema = schema
        self.publisher = publisher
        self.received_ns = received_ns
        self.sequence = sequence
        self.epoch = epoch
        self.latched = latched
        self._sample: Sample | None = None

    def sample(self) -> Sample:
        """Return the sample, always the same object."""
        if self._sample is None:
            self._sample = Sample(
                bytes(self.data),
                Encoding.ROS1,
                self.schema,
                self.publisher,
                self.received_ns,
                self.sequence,
                self.epoch,
                self.latched,
            )
            self.data = self._sample.data
        return self._sample


class Slot:
    """The newest values of one publisher on one topic, oldest first."""

    __slots__ = ("epoch", "latched", "publisher", "schema", "sequence", "uri", "values")

    def __init__(self, publisher: str, epoch: int) -> None:
        self.publisher = publisher
        self.epoch = epoch
        self.uri: str | None = None
        self.schema = TypeRef("*")
        self.latched = False
        self.sequence = 0
        self.values: tuple[Value, ...] = ()

    def take(self, frames: Sequence[Frame], count: int, depth: int) -> None:
        """Add the newest frames of a batch of `count`, and retain the newest `depth` values."""
        now = time.time_ns()
        self.sequence += count
        first = self.sequence - len(frames) + 1
        values = tuple(
            Value(data, self.schema, self.publisher, now, first + offset, self.epoch, self.latched)
            for offset, data in enumerate(frames)
        )
        self.values = values[-depth:] if len(values) >= depth else (*self.values, *values)[-depth:]

    def restart(self, epoch: int) -> None:
        """Restart the count, because the publisher is another process."""
        self.epoch = epoch
        self.sequence = 0


class Feed:
    """Messages received on one topic, for all its subscriptions.

    The reading thread replaces `slots` and their values, and calls `arrived`; everything else belongs to the server's
    event loop. `own` maps topics to rosld's own publications.
    """

    caller_suffix = ""
    """Suffix of the node name in the connections' caller id."""

    def __init__(self, topic: str, server: asyncio.AbstractEventLoop, own: Mapping[str, Slot]) -> None:
        self.topic = topic
        self.depth = 1
        self.slots: tuple[Slot, ...] = ()
        self.subscriptions: list[TopicSubscription] = []
        self._server = server
        self._own = own
        self._watches: tuple[WakingWatch, ...] = ()
        self._woken = False

    def values(self) -> tuple[tuple[Value, ...], ...]:
        """Return the newest values of each publisher, including rosld."""
        own = self._own.get(self.topic)
        slots = self.slots if own is None else (*self.slots, own)
        return tuple([slot.values for slot in slots])

    def arrived(self) -> None:
        """Wake the watches; called on the reading thread for each batch, so it is cheap without watches."""
        if self._watches and not self._woken:
            self._woken = True
            try:
                self._server.call_soon_threadsafe(self._wake)
            except RuntimeError:  # the server's event loop has ended
                pass

    def arrived_here(self) -> None:
        """Wake the watches for a sample of rosld; called on the server's event loop."""
        if self._watches and not self._woken:
            self._woken = True
            self._server.call_soon(self._wake)

    def watch(self, watch: WakingWatch) -> None:
        """Add a watch."""
        self._watches = (*self._watches, watch)

    def unwatch(self, watch: WakingWatch) -> None:
        """Remove a watch."""
        self._watches = tuple(each for each in self._watches if each is not watch)

    def _wake(self) -> None:
        self._woken = False
        for watch in self._watches:
            watch.wake()


class MessageFeed(Feed):
    """Messages received on one topic for the reading thread itself, each passed on once.

    `take` raises ValueError for unreadable messages, which are skipped.
    """

    caller_suffix = "_follower"
    """rospy publishers silently drop the older of two connections with the same caller id."""

    def __init__(self, topic: str, take: Callable[[bytes], None], depth: int) -> None:
        super().__init__(topic, asyncio.get_running_loop(), {})
        self.depth = depth
        self._take = take
        self._positions: dict[Slot, tuple[int, int]] = {}

    def arrived(self) -> None:
        """Pass on new messages."""
        for slot in self.slots:
            epoch, sequence = self._positions.get(slot, (-1, 0))
            for value in slot.values:
                if value.epoch != epoch or value.sequence > sequence:
                    with contextlib.suppress(ValueError):
                        self._take(bytes(value.data))
            if slot.values:
                self._positions[slot] = slot.values[-1].epoch, slot.values[-1].sequence
        self._positions = {slot: position for slot, position in self._positions.items() if slot in self.slots}


class WakingWatch:
    def __init__(self, feed: Feed, wake: Callable[[], None]) -> None:
        self._feed = feed
        self.wake = wake
        feed.watch(self)

    def close(self) -> None:
        """Stop waking. Idempotent."""
        self._feed.unwatch(self)


class TopicSubscription:
    """A subscription to a topic; implements `Subscription`."""

    def __init__(self, feed: Feed, depth: int, release: Callable[[TopicSubscription], None]) -> None:
        self.feed = feed
        self.depth = depth
        self._release = release
        self._closed = False
        self._values: tuple[tuple[Value, ...], ...] = ()
        self._latest: Sequence[Sample] = ()
        self._watches: list[WakingWatch] = []

    def latest(self) -> Sequence[Sample]:
        """Return the newest `depth` samples of each publisher, oldest first; the same object if nothing is new."""
        values = self.feed.values()
        if not _same(values, self._values):
            self._values = values
            newest = [value for each in values for value in each[-self.depth :]]
            newest.sort(key=_received_ns)
            samples = [value.sample() for value in newest]
            if not _same(samples, self._latest):
                self._latest = tuple(samples)
        return self._latest

    def watch(self, wake: Callable[[], None]) -> WakingWatch:
        """Call `wake` on the server's event loop after new messages."""
        watch = WakingWatch(self.feed, wake)
        self._watches.append(watch)
        return watch

    def close(self) -> None:
        """End the subscription. Idempotent."""
        if not self._closed:
            self._closed = True
            for watch in self._watches:
                watch.close()
            self._release(self)


def _received_ns(value: Value) -> int:
    return value.received_ns


def _same(these: Sequence[object], those: Sequence[object]) -> bool:
    """Whether two sequences have identical elements, without comparing contents."""
    return len(these) == len(those) and all(map(operator.is_, these, those))
