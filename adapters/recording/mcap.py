"""MCAP files of ROS 2 and ROS 1, with or without a summary.

A file with a summary is opened by its chunk and message indexes. Without one (the recorder was killed, the file
truncated), or if the indexes are incomplete, the whole file is scanned, and a note says so.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from typing import NamedTuple, TypeAlias

import numpy as np

from rosld.adapters.model import Encoding
from rosld.adapters.model.mcap import MAGIC, OPENING, SILENT_TOPICS, Fields
from rosld.adapters.recording.byte_source import (
    ByteSource,
    BytesSource,
    Chunk,
    ChunkedFile,
    RandomFile,
    Scan,
    inflate,
    read_exactly,
)
from rosld.adapters.recording.storage import Damaged, MessageTable, OpenBudget, RecordedConnection, TableBuilder

_HEADER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _MESSAGE_INDEX, _CHUNK_INDEX = 1, 3, 4, 5, 6, 7, 8
_STATISTICS, _METADATA, _METADATA_INDEX, _DATA_END = 0x0B, 0x0C, 0x0D, 0x0F
_FOOTER_SIZE = 1 + 8 + 20 + len(MAGIC)
_ENTRY = np.dtype([("time", "<u8"), ("offset", "<u8")])
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_SYNTAXES = {"ros1msg": "msg", "ros2msg": "msg", "ros2idl": "idl", "omgidl": "idl", "": "msg"}
_DURABILITY = re.compile(r"""^(?:- |  )durability: *["']?(\w+)""", re.MULTILINE)
_PROFILE = re.compile(r"^- ", re.MULTILINE)
_ENCODINGS = {"cdr": Encoding.CDR, "ros1": Encoding.ROS1}


class _Record(NamedTuple):
    """A record: its opcode, and the start and size of its content in bytes."""

    op: int
    data_at: int
    size: int

    @property
    def end(self) -> int:
        return self.data_at + self.size


class _Schema(NamedTuple):
    """A schema record: the name of a type, the encoding of its definition, and the definition."""

    name: str
    encoding: str
    data: str


_Schemas: TypeAlias = dict[int, _Schema]
"""Schemas by their number in the file."""


class _Fields(Fields):
    """Reader of a record's fields in an untrusted file."""

    too_short = Damaged
    errors = "replace"


def _fields(source: ByteSource, record: _Record) -> _Fields:
    return _Fields(read_exactly(source, record.data_at, record.size))


class Mcap(ChunkedFile):
    """An open MCAP file."""

    format = "MCAP"
    encoding = Encoding.CDR
    kind = "channel"

    def read(self, place: int, offset: int) -> bytes:
        """Return the bytes of the message record at `offset` in the file or in a chunk. Raises Damaged."""
        source = self._source(place)
        head = read_exactly(source, offset, 9)
        size = int.from_bytes(head[1:], "little") - _MESSAGE_HEAD.size
        if head[0] != _MESSAGE or size < 0:
            raise Damaged(f"there is no message at {offset}")
        return read_exactly(source, offset + 9 + _MESSAGE_HEAD.size, size)

    def _read_header(self, file: RandomFile) -> int:
        header = _record_at(file, len(MAGIC))
        if header.op != _HEADER:
            raise Damaged("it does not begin with a header")
        self.ros_version = 1 if _fields(file, header).text() == "ros1" else 2
        return header.end

    def _read_index(self, file: RandomFile, scan: Scan) -> None:
        schemas: _Schemas = {}
        indexes: list[_Fields] = []
        counted: int | None = None
        statistics: _Fields | None = None
        for record in _records(file, _summary(file), file.size - _FOOTER_SIZE):
            scan.budget.work()
            if record.op in (_SCHEMA, _CHANNEL):
                _describe(record, file, schemas, scan)
            elif record.op == _CHUNK_INDEX:
                scan.budget.spend(parts=1, octets=record.size)
                indexes.append(_fields(file, record))
            elif record.op == _METADATA_INDEX:
                scan.silent += _silent(file, _fields(file, record), scan.budget)
            elif record.op == _STATISTICS:
                statistics = _fields(file, record)
                counted = statistics.uint(8)
        if scan.only_totals and statistics is not None and _has_totals(statistics, counted, scan):
            return
        for index in indexes:
            _chunk_by_index(file, index, schemas, scan)
        messages = sum(len(each.times) for each in scan.tables)
        if counted is None or messages != counted:
            raise Damaged(f"it indexes {messages} messages, not {'a known number' if counted is None else counted}")

    def _read_through(self, file: RandomFile, at: int, scan: Scan) -> None:
        _walk(file, at, 0, {}, scan)


def _has_totals(statistics: _Fields, counted: int | None, scan: Scan) -> bool:
    """Use the totals in statistics, after the number of messages; return whether they are complete."""
    for size in (2, 4, 4, 4, 4):
        statistics.uint(size)
    start_ns, end_ns, pairs = statistics.uint(8), statistics.uint(8), _Fields(statistics.octets())
    counts: dict[int, int] = {}
    while pairs.more():
        number = pairs.uint(2)
        counts[number] = pairs.uint(8)
    return sum(counts.values()) == counted and scan.set_totals(counts, start_ns, end_ns)


def _describe(record: _Record, source: ByteSource, schemas: _Schemas, scan: Scan) -> None:
    """Add a schema or a channel."""
    scan.budget.spend(octets=record.size)
    fields = _fields(source, record)
    number = fields.uint(2)
    if record.op == _SCHEMA:
        scan.budget.spend(parts=1)
        schemas.setdefault(number, _Schema(fields.text(), fields.text(), fields.text()))
    else:
        scan.add(number, _connection(schemas.get(fields.uint(2)), fields))


def _summary(file: RandomFile) -> int:
    footer = read_exactly(file, file.size - _FOOTER_SIZE, _FOOTER_SIZE)
    if not footer.endswith(MAGIC):
        raise Damaged("the recording was never finished")
    at = int.from_bytes(footer[9:17], "little")
    if not at:
        raise Damaged("it has no summary")
    return at


def _silent(file: RandomFile, index: _Fields, budget: OpenBudget) -> tuple[str, ...]:
    """Return the selected topics without a message, from the file's metadata record."""
    at, _length = index.uint(8), index.uint(8)
    if index.text() != SILENT_TOPICS:
        return ()
    record = _record_at(file, at)
    budget.spend(octets=record.size)
    fields = _fields(file, record)
    if record.op != _METADATA or fields.text() != SILENT_TOPICS:
        raise Damaged("metadata is not at its indexed position")
    return tuple(fields.texts())


def _chunk_by_index(file: RandomFile, index: _Fields, schemas: _Schemas, scan: Scan) -> None:
    index.uint(8), index.uint(8)
    at, _length = index.uint(8), index.uint(8)
    offsets = _Fields(index.octets())
    place = _place(file, _record_at(file, at), scan)
    before = len(scan.tables)
    while offsets.more():
        offsets.uint(2)
        record = _record_at(file, offsets.uint(8))
        if record.op != _MESSAGE_INDEX:
            raise Damaged("a message index is not at the position in its chunk")
        scan.tables.append(_index_table(file, record, place, scan))
    if len(scan.tables) == before:
        _walk(BytesSource(inflate(file, scan.chunks[place - 1], scan.budget)), 0, place, schemas, scan)


def _index_table(file: RandomFile, record: _Record, place: int, scan: Scan) -> MessageTable:
    fields = _fields(file, record)
    number, data = fields.uint(2), fields.octets()
    scan.budget.spend(messages=len(data) // _ENTRY.itemsize, parts=1)
    entries = np.frombuffer(data[: len(data) // _ENTRY.itemsize * _ENTRY.itemsize], _ENTRY)
    return scan.table(number, place, entries["time"], entries["offset"])


def _walk(source: ByteSource, at: int, place: int, schemas: _Schemas, scan: Scan) -> None:
    """Scan everything from `at` on; stop, with a note, if the records are truncated."""
    rows = TableBuilder()
    try:
        for record in _records(source, at, source.size):
            scan.budget.work()
            if record.op == _DATA_END:
                break
            if record.op in (_SCHEMA, _CHANNEL):
                _describe(record, source, schemas, scan)
            elif record.op == _MESSAGE:
                channel, _, time, _ = _MESSAGE_HEAD.unpack(read_exactly(source, record.data_at, _MESSAGE_HEAD.size))
                scan.budget.spend(messages=1)
                rows.add(time, scan.connection(channel), place, record.data_at - 9)
            elif record.op == _CHUNK and place == 0:
                _walk_chunk(source, record, schemas, scan)
    except Damaged as damage:
        scan.notes.append(f"it ends early: {damage}")
    scan.tables.extend(rows.tables())


def _walk_chunk(source: ByteSource, record: _Record, schemas: _Schemas, scan: Scan) -> None:
    place = _place(source, record, scan)
    try:
        data = inflate(source, scan.chunks[place - 1], scan.budget)
    except Damaged as damage:
        scan.budget.spend(parts=1)
        scan.notes.append(f"a chunk of it is damaged: {damage}")
    else:
        _walk(BytesSource(data), 0, place, schemas, scan)


def _place(source: ByteSource, record: _Record, scan: Scan) -> int:
    if record.op != _CHUNK:
        raise Damaged("there is no chunk at the indexed position")
    scan.budget.spend(parts=1)
    head = _Fields(source.read_up_to(record.data_at, min(record.size, 256)))
    head.uint(8), head.uint(8)
    inflated, crc, compression, size = head.uint(8), head.uint(4), head.text(), head.uint(8)
    at = record.data_at + 8 + 8 + 8 + 4 + 4 + len(compression.encode()) + 8
    scan.chunks.append(Chunk(at, size, compression, inflated, crc))
    return len(scan.chunks)


def _records(source: ByteSource, at: int, end: int) -> Iterator[_Record]:
    while at < end:
        record = _record_at(source, at)
        yield record
        at = record.end


def _record_at(source: ByteSource, at: int) -> _Record:
    head = read_exactly(source, at, 9)
    record = _Record(head[0], at + 9, int.from_bytes(head[1:], "little"))
    if record.end > source.size:
        raise Damaged(f"the record at {at} is cut off")
    return record


def _connection(schema: _Schema | None, channel: _Fields) -> RecordedConnection:
    """Return a channel as a connection; a format unknown to ROS makes it odd, not the file unreadable."""
    topic, encoding, metadata = channel.text(), channel.text(), channel.texts()
    name, syntax, definition = schema or _Schema("", "", "")
    odd = None
    if encoding not in _ENCODINGS:
        odd = f"its messages are in {encoding!r}, which is neither of {', '.join(_ENCODINGS)}"
    elif syntax not in _SYNTAXES:
        odd = f"its schema is in {syntax!r}, not in one of {', '.join(filter(None, _SYNTAXES))}"
    return RecordedConnection(
        topic=topic,
        type=name,
        encoding=_ENCODINGS.get(encoding, Encoding.CDR),
        definition=definition if odd is None else "",
        syntax=_SYNTAXES.get(syntax, syntax),
        hash=metadata.get("md5sum") if encoding == "ros1" else metadata.get("topic_type_hash") or None,
        publisher=metadata.get("callerid", ""),
        latched=metadata.get("latching") == "1" or latched(metadata.get("offered_qos_profiles", "")),
        odd=odd,
        is_opening=metadata.get(OPENING) == "1",
    )


def latched(profiles: str) -> bool:
    """Whether every publisher of a ROS 2 topic was latched (transient local).

    The profiles are YAML, from which only the lines that rosbag2 writes are read: a full YAML parser can take seconds
    for a small malicious text.
    """
    durabilities = _DURABILITY.findall(profiles)
    return (
        bool(durabilities)
        and len(durabilities) == len(_PROFILE.findall(profiles))
        and {*durabilities} <= {"1", "transient_local"}
    )
