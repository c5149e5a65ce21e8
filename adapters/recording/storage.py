"""Interface of recording formats: connections, a table of the places of messages, and limits on opening a file."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rosld.adapters.model import Encoding

RosVersion: TypeAlias = Literal[1, 2]
_LAST_TIME = (1 << 63) - 1
_PACKED = 1 << 16


class Damaged(Exception):
    """Invalid bytes in a recording; the message describes them."""


class RecordedConnection(NamedTuple):
    """Recorded connection of one publisher (ROS 1) or all publishers (ROS 2) to a topic.

    `publisher` is the node, or empty if unknown; `definition` is empty if the file has none; `syntax` is its syntax:
    "msg", "idl", or another name in the file. `odd` is the reason why its messages cannot be read regardless of the
    definition. `is_opening`: its messages precede the file, and open it as latched ones.
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
        """Return the rows by time, with the order in the file for equal times."""
        return self.rows(np.argsort(self.times, kind="stable"))

    def rows(self, rows: NDArray[np.int64] | NDArray[np.bool_]) -> MessageTable:
        """Return the rows with these numbers, or those selected by a mask."""
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
    """Builder of tables from rows. Rows are packed regularly, because tuples need more memory."""

    def __init__(self) -> None:
        self._rows: list[tuple[int, int, int, int]] = []
        self._tables: list[MessageTable] = []

    def add(self, time: int, connection: int, place: int, offset: int) -> None:
        """Add a row. Raises Damaged for an invalid time."""
        if time > _LAST_TIME:
            raise Damaged(f"the time {time} ns is out of range")
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
    """Return the concatenation of these tables."""
    parts = [message_table([], [], [], []), *tables]
    return MessageTable(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


class Totals(NamedTuple):
    """Numbers of messages by connection, and the first and the last time in ns (0 if there are none)."""

    counts: Sequence[int]
    start_ns: int
    end_ns: int


class Storage(ABC):
    """An open recording of one format: its connections, to which the table of all messages (in any order) refers.

    `ros_version`, that of the ROS that wrote it, determines the kind of type hashes. `places` counts those of the
    table. `silent` are selected topics without a message, `notes` sentences about defects and how they were handled.
    `totals` are those in the summary of a file that was opened for them only, and has no table then.
    """

    format: str
    ros_version: RosVersion = 2
    connections: Sequence[RecordedConnection]
    messages: MessageTable
    places: int = 1
    silent: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    totals: Totals | None = None

    @abstractmethod
    def read(self, place: int, offset: int) -> bytes:
        """Return the bytes of a message (thread-safe). Raises Damaged."""

    def limit_cache(self, max_bytes: int) -> None:
        """Limit the memory for recent chunks, if the format has such."""
        return

    @abstractmethod
    def close(self) -> None:
        """Close the file. Idempotent."""


MESSAGE_BYTES = 40
"""Bytes of a message in the index."""
PART_BYTES = 1024
"""Approximate bytes of a chunk, an index, a connection or a note, in addition to its own data."""
_BASE_WORK = 1 << 30
"""Work units allowed for any file. A unit is about a nanosecond, or one decompressed byte."""
_WORK_PER_BYTE = 1024
"""Additional work units per byte of a file. Short messages without an index need 30, or 300 if compressed."""
_RECORD_WORK = 1024
"""Work units of reading a record."""
_TYPE_WORK = 1_000_000
"""Work units of compiling a type, which takes half a millisecond and 10 kB."""
_TEXT_WORK = 200
"""Work units per character of a definition; most characters are comments."""


class OpeningRefused(Exception):
    """A recording that is not opened: its index is too large, or opening was cancelled."""


class OpenBudget:
    """Limits of memory and work for reading the index of a recording. Any thread may cancel it.

    A file of a few kilobytes can index any number of messages, and refer to a large compressed chunk repeatedly. The
    allowed work depends on the size of the file, not on the speed of the machine.
    """

    def __init__(self, limit: int | None = None) -> None:
        """Create a budget. `limit` is the maximum of memory in bytes, None for no limit."""
        self._limit = limit
        self._spent = 0
        self._allowed = _BASE_WORK
        self.work_done = 0
        """Work units done so far."""
        self._is_cancelled = False

    def cancel(self) -> None:
        """End reading soon."""
        self._is_cancelled = True

    def check(self) -> None:
        """Raise OpeningRefused if reading was cancelled."""
        if self._is_cancelled:
            raise OpeningRefused("reading it was cancelled")

    def allow(self, size: int) -> None:
        """Allow the work for a file of this size."""
        self._allowed += size * _WORK_PER_BYTE

    def work(self, units: int = _RECORD_WORK) -> None:
        """Account for work, by default that of a record. Raises OpeningRefused above the limit, or if cancelled."""
        self.check()
        self.work_done += units
        if self.work_done > self._allowed:
            raise OpeningRefused("reading it takes too much work for a file of its size")

    def learn(self, types: int, characters: int) -> None:
        """Account for the definitions of types. Raises OpeningRefused if there are too many, or if cancelled."""
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
