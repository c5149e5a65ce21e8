"""MCAP files of ROS 2 and ROS 1, with or without a summary.

A file with a summary is opened by its chunk and message indexes. Without one (the recorder was killed, the file
truncated), or if the indexes are incomplete, the whole file is scanned, and a note says so.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from rosld.adapters.model import Encoding
from rosld.adapters.model.mcap import MAGIC, OPENING, SILENT_TOPICS, Fields
from rosld.adapters.recording.byte_source import (
    MAX_PIECE,
    ByteSource,
    BytesSource,
    ChunkCache,
    RandomFile,
    decompress,
    read_exactly,
)
from rosld.adapters.recording.storage import (
    Contents,
    Damaged,
    MessageTable,
    OpenBudget,
    RecordedConnection,
    RosVersion,
    TableBuilder,
    concatenate,
)

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


class _Chunk(NamedTuple):
    """A chunk: start, size and compression of its compressed bytes, and size and CRC of the uncompressed ones."""

    at: int
    size: int
    compression: str
    inflated: int
    crc: int


class _Schema(NamedTuple):
    """A schema record: the name of a type, the encoding of its definition, and the definition."""

    name: str
    encoding: str
    data: str


class _Fields(Fields):
    """Reader of a record's fields in an untrusted file."""

    too_short = Damaged
    errors = "replace"


class _Scan:
    """Results of scanning so far: schemas, channels as connections, chunks, and tables of messages."""

    def __init__(self, budget: OpenBudget) -> None:
        self.budget = budget
        self.schemas: dict[int, _Schema] = {}
        self.numbers: dict[int, int] = {}
        self.connections: list[RecordedConnection] = []
        self.chunks: list[_Chunk] = []
        self.tables: list[MessageTable] = []
        self.notes: list[str] = []
        self.silent: tuple[str, ...] = ()

    def describe(self, record: _Record, source: ByteSource) -> None:
        """Add a schema or a channel."""
        self.budget.spend(octets=record.size)
        fields = _Fields(read_exactly(source, record.data_at, record.size))
        number = fields.uint(2)
        if record.op == _SCHEMA:
            self.budget.spend(parts=1)
            self.schemas.setdefault(number, _Schema(fields.text(), fields.text(), fields.text()))
        elif number not in self.numbers:
            self._add(number, _connection(self.schemas.get(fields.uint(2)), fields))

    def connection(self, number: int) -> int:
        """Return the index of channel `number`; an undescribed channel is added as an odd one."""
        if number not in self.numbers:
            odd = f"the recording does not describe its channel {number}"
            self._add(number, RecordedConnection(f"/channel_{number}", "", Encoding.CDR, odd=odd))
        return self.numbers[number]

    def _add(self, number: int, connection: RecordedConnection) -> None:
        self.budget.spend(parts=1)
        self.numbers[number] = len(self.connections)
        self.connections.append(connection)


class Mcap:
    """An open MCAP file: a `Storage`."""

    def __init__(self, path: Path, budget: OpenBudget) -> None:
        self._file = RandomFile(path)
        try:
            contents, self._chunks = _read(self._file, budget)
        except BaseException:
            self._file.close()
            raise
        self._cache = ChunkCache(self._load)
        self.format = contents.format
        self.ros_version = contents.ros_version
        self.connections = contents.connections
        self.messages = contents.messages
        self.places = contents.places
        self.notes = contents.notes
        self.silent = contents.silent

    def read(self, place: int, offset: int) -> bytes:
        """Return the bytes of the message record at `offset` in the file or in a chunk. Raises Damaged."""
        source: ByteSource = self._cache.get(place - 1) if place else self._file
        record = _record_at(source, offset)
        if record.op != _MESSAGE or record.size < _MESSAGE_HEAD.size:
            raise Damaged(f"there is no message at {offset}")
        return read_exactly(source, record.data_at + _MESSAGE_HEAD.size, record.size - _MESSAGE_HEAD.size)

    def close(self) -> None:
        self._file.close()

    def _load(self, chunk: int) -> bytes:
        return _inflate(self._file, self._chunks[chunk], OpenBudget())


def _read(file: RandomFile, budget: OpenBudget) -> tuple[Contents, list[_Chunk]]:
    header = _record_at(file, len(MAGIC))
    if header.op != _HEADER:
        raise Damaged("it does not begin with a header")
    profile = _Fields(read_exactly(file, header.data_at, header.size)).text()
    try:
        scan = _by_summary(file, budget)
    except Damaged as damage:
        scan = _by_walking(file, header.end, budget)
        scan.notes.append(f"its index cannot be used ({damage}), so it was read through")
        if not scan.connections:
            raise Damaged(f"{damage}, and no complete channel was found in it either") from damage
    version: RosVersion = 1 if profile == "ros1" else 2
    messages = concatenate(scan.tables)
    notes, places = tuple(scan.notes), 1 + len(scan.chunks)
    return Contents("MCAP", version, scan.connections, messages, places, notes, scan.silent), scan.chunks


def _by_summary(file: RandomFile, budget: OpenBudget) -> _Scan:
    at = _summary(file)
    scan = _Scan(budget)
    indexes: list[_Fields] = []
    counted: int | None = None
    for record in _records(file, at, file.size - _FOOTER_SIZE):
        budget.work()
        if record.op in (_SCHEMA, _CHANNEL):
            scan.describe(record, file)
        elif record.op == _CHUNK_INDEX:
            budget.spend(parts=1, octets=record.size)
            indexes.append(_Fields(read_exactly(file, record.data_at, record.size)))
        elif record.op == _METADATA_INDEX:
            scan.silent += _silent(file, _Fields(read_exactly(file, record.data_at, record.size)), budget)
        elif record.op == _STATISTICS:
            counted = _Fields(read_exactly(file, record.data_at, record.size)).uint(8)
    for index in indexes:
        _chunk_by_index(file, index, scan)
    messages = sum(len(each.times) for each in scan.tables)
    if counted is None or messages != counted:
        raise Damaged(f"it indexes {messages} messages, not {'a known number' if counted is None else counted}")
    return scan


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
    fields = _Fields(read_exactly(file, record.data_at, record.size))
    if record.op != _METADATA or fields.text() != SILENT_TOPICS:
        raise Damaged("metadata is not at its indexed position")
    return tuple(fields.texts())


def _chunk_by_index(file: RandomFile, index: _Fields, scan: _Scan) -> None:
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
        _walk(BytesSource(_inflate(file, scan.chunks[place - 1], scan.budget)), 0, place, scan)


def _index_table(file: RandomFile, record: _Record, place: int, scan: _Scan) -> MessageTable:
    fields = _Fields(read_exactly(file, record.data_at, record.size))
    connection = scan.connection(fields.uint(2))
    data = fields.octets()
    scan.budget.spend(messages=len(data) // _ENTRY.itemsize, parts=1)
    entries = np.frombuffer(data[: len(data) // _ENTRY.itemsize * _ENTRY.itemsize], _ENTRY)
    return MessageTable(
        entries["time"].astype(np.int64),
        np.full(len(entries), connection, np.int32),
        np.full(len(entries), place, np.int32),
        entries["offset"].astype(np.int64),
    )


def _by_walking(file: RandomFile, at: int, budget: OpenBudget) -> _Scan:
    scan = _Scan(budget)
    _walk(file, at, 0, scan)
    return scan


def _walk(source: ByteSource, at: int, place: int, scan: _Scan) -> None:
    """Scan everything from `at` on; stop, with a note, if the records are truncated."""
    rows = TableBuilder()
    try:
        for record in _records(source, at, source.size):
            scan.budget.work()
            if record.op == _DATA_END:
                break
            if record.op in (_SCHEMA, _CHANNEL):
                scan.describe(record, source)
            elif record.op == _MESSAGE:
                channel, _, time, _ = _MESSAGE_HEAD.unpack(read_exactly(source, record.data_at, _MESSAGE_HEAD.size))
                scan.budget.spend(messages=1)
                rows.add(time, scan.connection(channel), place, record.data_at - 9)
            elif record.op == _CHUNK and place == 0:
                _walk_chunk(source, record, scan)
    except Damaged as damage:
        scan.notes.append(f"it ends early: {damage}")
    scan.tables.extend(rows.tables())


def _walk_chunk(source: ByteSource, record: _Record, scan: _Scan) -> None:
    place = _place(source, record, scan)
    try:
        data = _inflate(source, scan.chunks[place - 1], scan.budget)
    except Damaged as damage:
        scan.budget.spend(parts=1)
        scan.notes.append(f"a chunk of it is damaged: {damage}")
    else:
        _walk(BytesSource(data), 0, place, scan)


def _place(source: ByteSource, record: _Record, scan: _Scan) -> int:
    if record.op != _CHUNK:
        raise Damaged("there is no chunk at the indexed position")
    scan.budget.spend(parts=1)
    head = _Fields(source.read_up_to(record.data_at, min(record.size, 256)))
    head.uint(8), head.uint(8)
    inflated, crc, compression, size = head.uint(8), head.uint(4), head.text(), head.uint(8)
    at = record.data_at + 8 + 8 + 8 + 4 + 4 + len(compression.encode()) + 8
    scan.chunks.append(_Chunk(at, size, compression, inflated, crc))
    return len(scan.chunks)


def _inflate(source: ByteSource, chunk: _Chunk, budget: OpenBudget) -> bytes:
    budget.work(min(chunk.inflated, MAX_PIECE))
    data = decompress(chunk.compression, read_exactly(source, chunk.at, chunk.size), chunk.inflated)
    if chunk.crc and zlib.crc32(data) != chunk.crc:
        raise Damaged(f"the checksum of the chunk at {chunk.at} is wrong")
    return data


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
