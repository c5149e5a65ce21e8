"""The contract of recording formats: connections, a table of the places of messages, and limits on opening a file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rosld.adapters.model import Encoding

RosVersion: TypeAlias = Literal[1, 2]
_LAST_TIME = (1 << 63) - 1
_PACKED = 1 << 16


class Damaged(Exception):
    """Bytes of a recording are not what its format says; the text says which."""


class RecordedConnection(NamedTuple):
    """One publisher's (ROS 1) or all publishers' (ROS 2) connection to a topic, as it was recorded.

    `publisher` is the node, or empty if unknown; `definition` is empty if the file has none, `syntax` is its syntax:
    "msg", "idl", or another name in the file. `odd` is the reason why its messages cannot be read regardless of the
    definition. `is_opening`: its messages precede the file, and open it as latched.
    """

    topic: str
    type: str
    encoding: Encoding
    definition: str = ""
    syntax: str = "msg"
    hash: str | None = None
    publisher: str = ""
    latched: bool = False
    odd: str | None = None
    is_opening: bool = False


class MessageTable(NamedTuple):
    """Places of messages, one per row: time (ns), connection, place in the file, and offset in it.

    Place 0 is the file itself, the others are its compressed chunks; the format defines the meaning of offsets.
    """

    times: NDArray[np.int64]
    connections: NDArray[np.int32]
    places: NDArray[np.int32]
    offsets: NDArray[np.int64]

    def in_recorded_order(self) -> MessageTable:
        """Return the rows by time; those of one time as they lie in the file."""
        return self.rows(np.argsort(self.times, kind="stable"))

    def rows(self, rows: NDArray[np.int64] | NDArray[np.bool_]) -> MessageTable:
        """Return the rows with these numbers in order, or those for which the condition holds."""
        return MessageTable(self.times[rows], self.connections[rows], self.places[rows], self.offsets[rows])


def message_table(
    times: Sequence[int], connections: Sequence[int], places: Sequence[int], offsets: Sequence[int]
) -> MessageTable:
    """Return the table of these columns."""
    return MessageTable(
        np.asarray(times, np.int64),
        np.asarray(connections, np.int32),
        np.asarray(places, np.int32),
        np.asarray(offsets, np.int64),
    )


class TableBuilder:
    """Rows that are found one by one, as tables: they are packed now and then, for a row as a tuple is larger."""

    def __init__(self) -> None:
        self._rows: list[tuple[int, int, int, int]] = []
        self._tables: list[MessageTable] = []

    def add(self, time: int, connection: int, place: int, offset: int) -> None:
        """Take a row. Raises Damaged for a time that is none."""
        if time > _LAST_TIME:
            raise Damaged(f"the time {time} ns is later than can be")
        self._rows.append((time, connection, place, offset))
        if len(self._rows) >= _PACKED:
            self._pack()

    def tables(self) -> list[MessageTable]:
        """Return all rows so far."""
        if self._rows:
            self._pack()
        return self._tables

    def _pack(self) -> None:
        self._tables.append(message_table(*zip(*self._rows, strict=True)))
        self._rows.clear()


def concatenate(tables: Iterable[MessageTable]) -> MessageTable:
    """Return these tables one below the other."""
    parts = [message_table([], [], [], []), *tables]
    return MessageTable(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


class Storage(Protocol):
    """An open recording of one format. `read` may be called from any thread.

    `notes` are sentences about what was wrong with the file and what was done about it.
    """

    @property
    def format(self) -> str:
        """The format in words, for people."""
        ...

    @property
    def ros_version(self) -> RosVersion:
        """Which ROS wrote it, and so what a hash of a type is."""
        ...

    @property
    def connections(self) -> Sequence[RecordedConnection]:
        """The connections; the table refers to them by their index here."""
        ...

    @property
    def messages(self) -> MessageTable:
        """All messages, in any order."""
        ...

    @property
    def places(self) -> int:
        """The number of places, including the file itself."""
        ...

    @property
    def silent(self) -> Sequence[str]:
        """Chosen topics without a message."""
        ...

    @property
    def notes(self) -> Sequence[str]:
        """The defects of the file."""
        ...

    def read(self, place: int, offset: int) -> bytes:
        """Return the bytes of the message there. Raises Damaged."""
        ...

    def close(self) -> None:
        """Let go of the file. Idempotent."""
        ...


@dataclass(frozen=True)
class Contents:
    """Content of a file: the values of `Storage`."""

    format: str
    ros_version: RosVersion
    connections: Sequence[RecordedConnection]
    messages: MessageTable
    places: int = 1
    notes: tuple[str, ...] = ()
    silent: tuple[str, ...] = ()


MESSAGE_BYTES = 40
"""What one message takes in the index."""
PART_BYTES = 1024
"""About what a chunk, an index, a connection or a note takes beside its own bytes."""
_BASE_WORK = 1 << 30
"""Units of work that any file may take, of about a nanosecond: a byte that is decompressed is one."""
_WORK_PER_BYTE = 1024
"""Units that each byte of a file may take beyond: short messages without an index come to 30, compressed to 300."""
_RECORD_WORK = 1024
"""Units of looking at one record."""
_TYPE_WORK = 1_000_000
"""Units of compiling a type, which takes half a millisecond and 10 kB."""
_TEXT_WORK = 200
"""Work units per character of a definition; most characters are comments."""


class OpeningRefused(Exception):
    """A recording is not opened: its index is too large, or opening was cancelled."""


class OpenBudget:
    """The memory that the index of a recording may still take, and the work: reading the index takes from both.

    A file of a few kilobytes can index any number of messages, and name what inflates to much again and again. How
    much work there may be depends on how long the file is, not on how fast the machine is. Any thread may cancel it.
    """

    def __init__(self, limit: int | None = None) -> None:
        """Without a limit any file may have as large an index as its work allows."""
        self._limit = limit
        self._spent = 0
        self._allowed = _BASE_WORK
        self.worked = 0
        """Units of work that were done so far."""
        self._is_cancelled = False

    @property
    def is_cancelled(self) -> bool:
        """Whether the reading is to end."""
        return self._is_cancelled

    def cancel(self) -> None:
        """Request the end of reading."""
        self._is_cancelled = True

    def check(self) -> None:
        """Raise OpeningRefused once it is cancelled."""
        if self._is_cancelled:
            raise OpeningRefused("reading it was called off")

    def allow(self, size: int) -> None:
        """Allow the work that a file of this size justifies."""
        self._allowed += size * _WORK_PER_BYTE

    def work(self, units: int = _RECORD_WORK) -> None:
        """Account for work, by default that of a record. Raises OpeningRefused where that is too much, or cancelled."""
        self.check()
        self.worked += units
        if self.worked > self._allowed:
            raise OpeningRefused("reading it takes more work than a file of its size justifies")

    def learn(self, types: int, characters: int) -> None:
        """Account for the definitions of types. Raises OpeningRefused where there are too many, or cancelled."""
        try:
            self.work(types * _TYPE_WORK + characters * _TEXT_WORK)
        except OpeningRefused as error:
            raise OpeningRefused(f"of its {types} types, {error}") from error

    def spend(self, *, messages: int = 0, parts: int = 0, octets: int = 0) -> None:
        """Account for memory. Raises OpeningRefused above the limit, or if cancelled."""
        self.check()
        self._spent += messages * MESSAGE_BYTES + parts * PART_BYTES + octets
        if self._limit is not None and self._spent > self._limit:
            raise OpeningRefused(f"its index takes more than {self._limit} bytes of memory")
