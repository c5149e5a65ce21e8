"""What the server and the query process send each other: pickled tuples, each after its length."""

from __future__ import annotations

import mmap
import pickle
import struct
from collections.abc import Iterator, Mapping, Sequence
from enum import IntEnum
from typing import NamedTuple, TypeAlias

from rosld.server.dataset.base import Edit
from rosld.server.sparql.process.work import Work

_LENGTH = struct.Struct("<I")
_NUMBER = struct.Struct("<Q")


class Change(NamedTuple):
    """Replace graphs of a dataset by N-Triples (None: drop them), then do edits: as `Store.replace`."""

    dataset: int
    graphs: Mapping[str, str | None]
    edits: Sequence[Edit]


class Job(NamedTuple):
    """Do work over a dataset, within so many seconds and bytes of memory."""

    number: int
    dataset: int
    work: Work
    seconds: float
    memory: int


class Cancel(NamedTuple):
    """The result of a job is not wanted any more."""

    number: int


class Drop(NamedTuple):
    """A dataset is not wanted any more."""

    dataset: int


class ReduceMemory(NamedTuple):
    """Memory is short: return what can be returned, and end where a new process would need less than half of it."""


Request: TypeAlias = "Change | Job | Cancel | Drop | ReduceMemory"


class Kind(IntEnum):
    """What the process says of a job, or of a change."""

    DONE = 0
    """The result, which is bytes."""
    RAISED = 1
    """The exception that the work raised."""
    FORKED = 2
    """It is done in a fork, whose pipe comes with this."""
    WAITING = 3
    """As many forks are at work as may be: it waits for its turn."""
    ENDED = 4
    """The fork has ended: how (`fork.ExitStatus`)."""
    REFUSED = 5
    """A graph cannot be stored, and is left out: why."""


class Reply(NamedTuple):
    """What the process says. `value` depends on the kind."""

    kind: Kind
    number: int
    value: object = None


def pack(message: Request | Reply) -> bytes:
    """A message as a frame. Exceptions that cannot be pickled raise what pickle raises."""
    data = pickle.dumps(message, protocol=5)
    return _LENGTH.pack(len(data)) + data


class FrameBuffer:
    """Bytes as they come, cut into the messages that they are."""

    def __init__(self) -> None:
        self._bytes = bytearray()

    def feed(self, data: bytes) -> Iterator[Request | Reply]:
        """Take bytes; the messages that are whole by now."""
        self._bytes += data
        at = 0
        try:
            while len(self._bytes) - at >= _LENGTH.size:
                end = at + _LENGTH.size + _LENGTH.unpack_from(self._bytes, at)[0]
                if end > len(self._bytes):
                    break
                message = pickle.loads(memoryview(self._bytes)[at + _LENGTH.size : end])  # from our own other end
                at = end
                yield message
        finally:
            del self._bytes[:at]


class SharedStatus:
    """What the process does just now, in memory that survives it: a job, and how many changes it has made."""

    def __init__(self, descriptor: int) -> None:
        """A file of `SIZE` bytes, which may be closed then."""
        self._memory = mmap.mmap(descriptor, self.SIZE)

    SIZE = 2 * _NUMBER.size

    def set_job(self, number: int) -> None:
        """It is at this job from now on, 0 for none."""
        _NUMBER.pack_into(self._memory, 0, number)

    def count_change(self) -> None:
        """It has made another change."""
        _NUMBER.pack_into(self._memory, _NUMBER.size, self.changes + 1)

    @property
    def changes(self) -> int:
        """The changes that it has made, of those that it was sent."""
        found: int = _NUMBER.unpack_from(self._memory, _NUMBER.size)[0]
        return found

    @property
    def number(self) -> int:
        """The job that it is at, or was at when it ended."""
        found: int = _NUMBER.unpack_from(self._memory)[0]
        return found
