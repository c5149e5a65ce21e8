"""Blocks of messages, with columns of numbers if all messages of a chunk have the same layout.

The offset of a number depends on the lengths of the strings and arrays before it. So the first message is walked, and
the others must have the same lengths at the same offsets and in total; otherwise there are no columns, and messages are
decoded one by one.
"""

from __future__ import annotations

import struct
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from copy import copy
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rosld.adapters.base import RecordedMessage
from rosld.adapters.model import Array, Encoding, FieldType, MessageSchema, MessageType, Nested, Primitive
from rosld.server.history import mcap_records as mcap
from rosld.server.history.channel import Channel, channel_of
from rosld.server.history.chunk_index import ChunkRow
from rosld.server.history.segment_file import messages_in
from rosld.server.history.segments import Segments, sample_of

_DTYPES = {"bool": "?", "byte": "i1", "char": "u1", "float32": "f4", "float64": "f8"} | {
    f"{sign}int{bits}": f"{sign or 'i'}{bits // 8}" for sign in ("", "u") for bits in (8, 16, 32, 64)
}
_MAX_ELEMENTS = 64
"""Maximum number of elements in an array of messages that is walked."""
_CDR_HEAD = 4
_PADDING = 3
"""Maximum number of padding bytes after a message in CDR."""


class ChunkRows(NamedTuple):
    """Messages of a chunk with the same channel and length: one row of `data` per message, times in ns."""

    channel: int
    sequences: NDArray[np.uint64]
    times: NDArray[np.int64]
    data: NDArray[np.uint8]

    def select(self, from_ns: int, until_ns: int) -> ChunkRows:
        """Return the messages between two times (inclusive)."""
        within = (self.times >= from_ns) & (self.times <= until_ns)
        if within.all():
            return self
        return ChunkRows(self.channel, self.sequences[within], self.times[within], self.data[within])


def rows_of(records: bytes) -> ChunkRows | None:
    """Return the message records of a chunk, or None if they differ in channel or length."""
    first = next((each for each in mcap.records_in(records) if each.op == mcap.MESSAGE), None)
    if first is None:
        return None
    start, length = first.at - mcap.RECORD_HEAD.size, first.end - first.at
    kind = _record_type(length)
    if (len(records) - start) % kind.itemsize:
        return None
    rows = np.frombuffer(records, kind, offset=start)
    is_alike = (rows["op"] == mcap.MESSAGE) & (rows["length"] == length) & (rows["channel"] == rows["channel"][0])
    if not is_alike.all():
        return None
    return ChunkRows(
        int(rows["channel"][0]), rows["sequence"].astype(np.uint64), rows["time"].astype(np.int64), rows["data"]
    )


def _record_type(length: int) -> np.dtype[Any]:
    """Return the dtype of a message record of this length."""
    return np.dtype(
        [
            ("op", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("time", "<u8"),
            ("published", "<u8"), ("data", "u1", (length - mcap.MESSAGE_FIXED,)),
        ]
    )  # fmt: skip


def columns_of(
    rows: ChunkRows, schema: MessageSchema, encoding: Encoding, paths: Sequence[tuple[str, ...]]
) -> Sequence[NDArray[Any]] | None:
    """Return a column of numbers for each path of fields, or None if the layouts of the messages differ."""
    layout = layout_of(rows, schema, encoding, frozenset(paths))
    if layout is None or not layout.places.keys() >= set(paths):
        return None
    return [layout.cells(rows.data, path).reshape(-1) for path in paths]


def layout_of(
    rows: ChunkRows, schema: MessageSchema, encoding: Encoding, paths: frozenset[tuple[str, ...]] | None = None
) -> Layout | None:
    """Return the layout of all messages with the places of numbers, of all fields if `paths` is None.

    None if the layouts of the messages differ.
    """
    layout = Layout(schema.types, encoding, rows.data[0].tobytes(), paths)
    try:
        layout.message(schema.ref.name, ())
        layout.end()
    except (struct.error, ValueError, KeyError):
        return None
    for at, size in layout.guards:
        if (rows.data[:, at : at + size] != rows.data[0, at : at + size]).any():
            return None
    return layout


class Layout:
    """Layout of a message: `guards` are the offsets of bytes that must be equal in all, `places` those of values.

    `counts` are the lengths of arrays, and of strings in bytes.
    """

    def __init__(
        self,
        types: Mapping[str, MessageType],
        encoding: Encoding,
        data: bytes,
        paths: frozenset[tuple[str, ...]] | None,
    ) -> None:
        self.guards: list[tuple[int, int]] = []
        self.places: dict[tuple[str, ...], tuple[int, str]] = {}
        self.counts: dict[tuple[str, ...], int] = {}
        self._types = types
        self._is_cdr = encoding is Encoding.CDR
        self._order = ">" if self._is_cdr and data[1:2] == b"\0" else "<"
        self._data = data
        self._start = _CDR_HEAD if self._is_cdr else 0
        self._at = self._start
        self._paths = paths
        if self._is_cdr:
            self.guards.append((0, _CDR_HEAD))

    def message(self, name: str, path: tuple[str, ...]) -> None:
        """Walk a message of a type."""
        fields = self._types[name].fields
        if not fields and self._is_cdr:
            self._at += 1
        for field in fields:
            self._field(field.type, (*path, field.name))

    def end(self) -> None:
        """Raise ValueError unless the message ends here."""
        if not 0 <= len(self._data) - self._at <= (_PADDING if self._is_cdr else 0):
            raise ValueError("the length of the message does not match its type")

    def cells(self, data: NDArray[np.uint8], path: tuple[str, ...]) -> NDArray[Any]:
        """Return the numbers, or the bytes of strings, at a path: a row for each message."""
        at, kind = self.places[path]
        dtype, count = np.dtype(kind), self.counts.get(path, 1)
        if not count:
            return np.empty((len(data), 0), dtype.newbyteorder("="))
        cells = np.ascontiguousarray(data[:, at : at + count * dtype.itemsize])
        return cells != 0 if kind.endswith("?") else cells.view(dtype).astype(dtype.newbyteorder("="), copy=False)

    def _field(self, kind: FieldType, path: tuple[str, ...]) -> None:
        if isinstance(kind, Nested):
            self.message(kind.name, path)
        elif isinstance(kind, Array):
            self._array(kind, path)
        elif kind.name in _DTYPES:
            code = _DTYPES[kind.name]
            self._align(np.dtype(code).itemsize)
            if self._paths is None or path in self._paths:
                self.places[path] = self._at, self._order + code
            self._at += np.dtype(code).itemsize
        else:
            length = self._length()
            if self._paths is None:
                self.places[path], self.counts[path] = (self._at, "u1"), max(length - self._is_cdr, 0)
            self._at += length

    def _array(self, kind: Array, path: tuple[str, ...]) -> None:
        length = self._length() if kind.length is None else kind.length
        if self._paths is None:
            self.counts[path] = length
        if isinstance(kind.element, Primitive) and kind.element.name in _DTYPES:
            code = _DTYPES[kind.element.name]
            size = np.dtype(code).itemsize
            if length:
                self._align(size)
            if self._paths is None:
                self.places[path] = self._at, self._order + code
            self._at += length * size
            return
        if length > _MAX_ELEMENTS:
            raise ValueError("too many elements")
        for number in range(length):
            self._field(kind.element, (*path, str(number)))

    def _length(self) -> int:
        self._align(4)
        (length,) = struct.unpack_from(f"{self._order}I", self._data, self._at)
        self.guards.append((self._at, 4))
        self._at += 4
        return int(length)

    def _align(self, size: int) -> None:
        if self._is_cdr:
            self._at += -(self._at - self._start) % size


def number_paths(schema: MessageSchema) -> Iterator[tuple[str, ...]]:
    """Yield the paths of all numbers outside of arrays."""

    def within(name: str, path: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
        for field in schema.types[name].fields:
            if isinstance(field.type, Nested):
                yield from within(field.type.name, (*path, field.name))
            elif isinstance(field.type, Primitive) and field.type.name in _DTYPES and field.type.name != "bool":
                yield (*path, field.name)

    return within(schema.ref.name, ())


class MessageBlock:
    """Messages between two times. `rows` are all of them as an array, or None if their layouts differ."""

    def __init__(self, segments: Segments, row: ChunkRow, from_ns: int, until_ns: int) -> None:
        """Read the messages of a chunk. Raises OSError, ValueError if it is damaged, KeyError if it was removed."""
        self._at_hand: Sequence[RecordedMessage] = ()
        self._row = row
        self._from_ns, self._until_ns = from_ns, until_ns
        self._records = segments.records_of(row)
        self._channels = segments.channels_of(row.segment)
        rows = rows_of(self._records)
        self.rows: ChunkRows | None = None if rows is None else rows.select(from_ns, until_ns)

    @classmethod
    def of(cls, messages: Sequence[RecordedMessage]) -> MessageBlock:
        """Return a block of messages in memory, without rows."""
        block = cls.__new__(cls)
        block.rows, block._at_hand, block._records = None, messages, b""
        return block

    @classmethod
    def grouped(cls, messages: Iterable[RecordedMessage]) -> Iterator[MessageBlock]:
        """Yield messages in memory as blocks of one channel and length, with rows."""
        groups: dict[Hashable, list[RecordedMessage]] = {}
        for each in messages:
            data, encoding, schema, publisher, *_, latched = each.sample
            key = (
                each.topic,
                id(encoding),
                id(schema),
                publisher,
                latched,
                len(data),
            )  # these hash in C, unlike a Channel
            groups.setdefault(key, []).append(each)
        for members in groups.values():
            length = len(members[0].sample.data)
            block = cls.of(members)
            block._channels = {0: channel_of(members[0].topic, members[0].sample)}
            block.rows = ChunkRows(
                0,
                np.array([each.sample.sequence for each in members], np.uint64),
                np.array([each.sample.received_ns for each in members], np.int64),
                np.frombuffer(b"".join(each.sample.data for each in members), np.uint8).reshape(len(members), length),
            )
            yield block

    def where(self, is_wanted: NDArray[np.bool_]) -> MessageBlock:
        """Return the block with only some of its rows; `messages` may yield more."""
        assert self.rows is not None
        block = copy(self)
        channel, sequences, times, data = self.rows
        block.rows = ChunkRows(channel, sequences[is_wanted], times[is_wanted], data[is_wanted])
        block._at_hand = [each for each, one in zip(self._at_hand, is_wanted.tolist(), strict=False) if one]
        return block

    @property
    def channel(self) -> Channel:
        """The channel of the rows."""
        assert self.rows is not None
        return self._channels[self.rows.channel]

    def numbers(self) -> Sequence[int]:
        """Return the numbers of the messages, in the order of the rows, if any."""
        if self.rows is None or not self._records:
            return [each.index for each in self.messages()]
        first = self._row.first
        return [first + ((each - first) & 0xFFFFFFFF) for each in self.rows.sequences.tolist()]

    def sequences(self) -> Sequence[int]:
        """Return the sequence numbers of the messages, in the order of the rows."""
        if not self._records:
            return [each.sample.sequence for each in self._at_hand]
        return [number + 1 for number in self.numbers()]

    def messages(self) -> Iterator[RecordedMessage]:
        """Yield the messages one by one."""
        if not self._records:
            yield from self._at_hand
            return
        first = self._row.first
        for each in messages_in(self._records):
            if self._from_ns <= each.time_ns <= self._until_ns:
                number = first + ((each.sequence - first) & 0xFFFFFFFF)
                channel = self._channels[each.channel]
                yield RecordedMessage(number, channel.topic, sample_of(channel, each, number))
