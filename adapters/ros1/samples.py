"""The newest samples of each publisher of a topic, written by the thread that reads, read by the server's.

No locks: a slot's `values` is replaced whole, by one thread, in one assignment; whoever reads sees the old tuple or
the new one. A message costs at most that; the `Sample` is made when somebody looks.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

from rosld.adapters.model import Encoding, Sample, TypeRef
from rosld.adapters.ros1.tcpros import Frame


class Value:
    """A received frame, and its sample once somebody asked for it."""

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
        """The sample: always the same one."""
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
        """Take the newest frames of a batch of `count`, keeping the newest `depth` values."""
        now = time.time_ns()
        self.sequence += count
        first = self.sequence - len(frames) + 1
        taken = tuple(
            Value(data, self.schema, self.publisher, now, first + offset, self.epoch, self.latched)
            for offset, data in enumerate(frames)
        )
        self.values = taken[-depth:] if len(taken) >= depth else (*self.values, *taken)[-depth:]

    def restart(self, epoch: int) -> None:
        """Begin to count anew: the publisher is another process than before."""
        self.epoch = epoch
        self.sequence = 0
