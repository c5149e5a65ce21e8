"""Messages between the server, the query process and its workers: pickled tuples, each after its length."""

from __future__ import annotations

import mmap
import pickle
import struct
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from rosld.server.dataset.base import Edit
from rosld.server.sparql.process.work import Work

_LENGTH = struct.Struct("<I")
_NUMBER = struct.Struct("<Q")

# --- to the query process and to workers


class Change(NamedTuple):
    """Replace graphs of a dataset by N-Triples (None: drop them), then make edits, as `MemoryStore.replace` does."""

    dataset: int
    graphs: Mapping[str, str | None]
    edits: Sequence[Edit]


class Drop(NamedTuple):
    """Forget a dataset."""

    dataset: int


# --- to the query process


class Fork(NamedTuple):
    """Fork a worker of this number; its end of a socket pair comes with the message."""

    number: int


class Kill(NamedTuple):
    """Kill a worker."""

    number: int


class ReduceMemory(NamedTuple):
    """Return memory to the system; end if a new process would need less than half of it."""


# --- to a worker


class Job(NamedTuple):
    """Do work over a dataset, limited in seconds and in bytes of memory."""

    dataset: int
    work: Work
    seconds: float
    memory: int


# --- from the query process


class Refused(NamedTuple):
    """A graph cannot be stored, and is left out of its dataset."""

    graph: str
    reason: str


class ExitStatus(NamedTuple):
    """Exit of a worker: its status from `os.waitpid`, and its last output on stderr."""

    status: int
    words: str


class Ended(NamedTuple):
    """A worker has ended, or could not be forked; `why` is then the pickled exception."""

    number: int
    why: ExitStatus | bytes


# --- from a worker


class Ready(NamedTuple):
    """The worker exists: the query process has made all changes that were sent before the order to fork."""


class Data(NamedTuple):
    """Bytes of a result."""

    data: bytes


class Done(NamedTuple):
    """The last bytes of a result. After `is_last` the worker ends."""

    data: bytes
    is_last: bool


class Raised(NamedTuple):
    """The pickled exception that a job raised."""

    error: bytes
    is_last: bool


def pack(message: object) -> bytes:
    """Return a message as a frame."""
    data = pickle.dumps(message, protocol=5)
    return _LENGTH.pack(len(data)) + data


def pickle_error(error: Exception) -> bytes:
    """Pickle an exception without its traceback; replace one that cannot be pickled by a RuntimeError."""
    bare = error.with_traceback(None)
    bare.__cause__ = bare.__context__ = None
    try:
        data = pickle.dumps(bare, protocol=5)
        pickle.loads(data)
    except Exception:
        return pickle.dumps(RuntimeError(f"{type(error).__name__}: {error}"))
    return data


class FrameBuffer:
    """Buffer that splits a stream of bytes into messages."""

    def __init__(self) -> None:
        self._bytes = bytearray()

    def feed(self, data: bytes) -> Iterator[object]:
        """Add bytes; yield the messages that are complete."""
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
    """Count of the changes that the query process has made, in memory shared with the server."""

    SIZE = _NUMBER.size

    def __init__(self, descriptor: int) -> None:
        """Map a file of `SIZE` bytes, which the caller may close afterwards."""
        self._memory = mmap.mmap(descriptor, self.SIZE)

    def count_change(self) -> None:
        """Increment the count."""
        _NUMBER.pack_into(self._memory, 0, self.changes + 1)

    @property
    def changes(self) -> int:
        """The number of changes made."""
        found: int = _NUMBER.unpack_from(self._memory)[0]
        return found
