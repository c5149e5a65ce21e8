"""Subscriptions: the newest samples of each publisher, written by the reading thread and read by the server's.

No locks: a single thread replaces the `values` of a slot with one assignment; readers get either tuple.
"""

from __future__ import annotations

import asyncio
import contextlib
import operator
import time
from collections.abc import Callable, Sequence
from typing import Any

from msgspec import Struct

from rosld.adapters.model import Encoding, Sample, TypeRef
from rosld.adapters.ros1.tcpros import Frame
from rosld.adapters.slots import received_ns
from rosld.adapters.thread import LiveFeed


class Value(Struct, eq=False):
    """A received frame, which is converted to a sample on first use: most are replaced before anybody reads them."""

    data: Frame
    schema: TypeRef
    publisher: str
    received_ns: int
    sequence: int
    epoch: int
    latched: bool
    _sample: Sample | None = None

    def sample(self) -> Sample:
        """Return the sample, always the same object."""
        if self._sample is None:
            data = self.data = bytes(self.data)
            origin = self.schema, self.publisher, self.received_ns, self.sequence, self.epoch, self.latched
            self._sample = Sample(data, Encoding.ROS1, *origin)
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


class TopicFeed(LiveFeed):
    """Messages received on one topic, for all its subscriptions.

    The reading thread replaces `slots` and their values, and calls `arrived`; everything else belongs to the server's
    event loop.
    """

    caller_suffix = ""
    """Suffix of the node name in the connections' caller id."""

    def __init__(self, topic: str, changed: Callable[[Any], None] = lambda _: None) -> None:
        super().__init__(topic, changed)
        self.slots: tuple[Slot, ...] = ()
        self._server = asyncio.get_running_loop()
        self._woken = False
        self._values: tuple[tuple[Value | Sample, ...], ...] = ()
        self._views: dict[int, Sequence[Sample]] = {}

    def latest(self, depth: int = 1) -> Sequence[Sample]:
        """Return the newest samples of each publisher, including rosld; the same object if nothing is new."""
        values: tuple[tuple[Value | Sample, ...], ...] = (*[slot.values for slot in self.slots], self.own)
        if not _same(values, self._values):
            self._values = values
            self._views = {each: self._view(each, view) for each, view in self._views.items()}
        if depth not in self._views:
            self._views[depth] = self._view(depth, ())
        return self._views[depth]

    def _view(self, depth: int, before: Sequence[Sample]) -> Sequence[Sample]:
        newest = [value for values in self._values for value in values[-depth:]]
        found = [value.sample() if isinstance(value, Value) else value for value in newest]
        samples = tuple(sorted(found, key=received_ns))
        return before if _same(samples, before) else samples

    def arrived(self) -> None:
        """Wake the watches; called on the reading thread for each batch, so it is cheap without watches."""
        if self.watches and not self._woken:
            self._woken = True
            with contextlib.suppress(RuntimeError):  # the server's event loop has ended
                self._server.call_soon_threadsafe(self._wake)

    def _wake(self) -> None:
        self._woken = False
        self.notify()


class MessageFeed(TopicFeed):
    """Messages received on one topic for the reading thread itself, each passed on once.

    `take` raises ValueError for unreadable messages, which are skipped.
    """

    caller_suffix = "_follower"
    """rospy publishers silently drop the older of two connections with the same caller id."""

    def __init__(self, topic: str, take: Callable[[bytes], None], depth: int) -> None:
        super().__init__(topic)
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


def _same(these: Sequence[object], those: Sequence[object]) -> bool:
    """Whether two sequences have identical elements, without comparing contents."""
    return len(these) == len(those) and all(map(operator.is_, these, those))
