"""ROS 1 bags (format 2.0), with or without an index, in all compressions.

A bag with an index is opened by the index alone. If the index is missing or damaged (the recorder was killed, the file
truncated), the complete chunks are scanned instead, and a note says so.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

import numpy as np

from rosld.adapters.model import Encoding
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
from rosld.adapters.recording.storage import Damaged, MessageTable, RecordedConnection, TableBuilder

MAGIC = b"#ROSBAG V"
_MESSAGE, _BAG, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 3, 4, 5, 6, 7
_MAX_HEADER = 1 << 20
_ENTRY = np.dtype([("sec", "<u4"), ("nsec", "<u4"), ("offset", "<u4")])
_UINT32 = struct.Struct("<I")
_UINT64 = struct.Struct("<Q")
_IS_MESSAGE = _UINT32.pack(4) + b"op=" + bytes([_MESSAGE])


class _Record(NamedTuple):
    """A record: its opcode, its header fields, and the start and size of its data in bytes."""

    op: int
    header: Mapping[bytes, bytes]
    data_at: int
    size: int

    @property
    def end(self) -> int:
        return self.data_at + self.size

    def uint32(self, name: bytes) -> int:
        return _uint(_UINT32, self.header, name)

    def uint64(self, name: bytes) -> int:
        return _uint(_UINT64, self.header, name)

    def time(self, name: bytes = b"time") -> int:
        value = self.uint64(name)
        return (value & 0xFFFFFFFF) * 10**9 + (value >> 32)


class Rosbag1(ChunkedFile):
    """An open ROS 1 bag."""

    format = "ROS 1 bag 2.0"
    ros_version = 1
    encoding = Encoding.ROS1
    kind = "connection"

    def read(self, place: int, offset: int) -> bytes:
        """Return the bytes of the message at `offset` in the file or in a chunk. Raises Damaged."""
        source = self._source(place)
        head = source.read_up_to(offset, 256)
        if (size := _header_size(head)) and _IS_MESSAGE in head[4 : size + 4] and len(head) >= size + 8:
            # fast path for nearly every message, without parsing the header
            return read_exactly(source, offset + size + 8, _UINT32.unpack_from(head, size + 4)[0])
        record = _record_at(source, offset)
        while record.op == _CONNECTION:
            record = _record_at(source, record.end)
        if record.op != _MESSAGE:
            raise Damaged(f"there is no message at {offset}")
        return read_exactly(source, record.data_at, record.size)

    def _read_header(self, file: RandomFile) -> int:
        line = file.read_up_to(0, 32).partition(b"\n")[0] + b"\n"
        version = line.strip()[len(MAGIC) :].decode("ascii", "replace")
        if version != "2.0":
            raise Damaged(f"it is a bag of version {version}, but only 2.0 is supported: convert it with `rosbag fix`")
        self._header = _record_at(file, len(line))
        if self._header.header.get(b"encryptor"):
            raise Damaged("it is encrypted")
        return self._header.end

    def _read_index(self, file: RandomFile, scan: Scan) -> None:
        at = self._header.uint64(b"index_pos")
        if at == 0:
            raise Damaged("the recording was never finished")
        chunk_infos: list[_Record] = []
        for record in _records(file, at):
            scan.budget.work()
            if record.op == _CONNECTION:
                _add_connection(file, record, scan)
            elif record.op == _CHUNK_INFO:
                scan.budget.spend(parts=1)
                chunk_infos.append(record)
        if len(chunk_infos) < self._header.uint32(b"chunk_count"):
            raise Damaged(f"it lists {len(chunk_infos)} of {self._header.uint32(b'chunk_count')} chunks")
        if scan.only_totals and _has_totals(file, chunk_infos, scan):
            return
        for info in chunk_infos:
            _chunk_by_index(file, info, scan)

    def _read_through(self, file: RandomFile, at: int, scan: Scan) -> None:
        try:
            for record in _records(file, at):
                scan.budget.work()
                if record.op == _CONNECTION:
                    _add_connection(file, record, scan)
                elif record.op == _CHUNK:
                    _walk_chunk(file, record, *_place(record, scan), scan)
        except Damaged as damage:
            scan.notes.append(f"it ends early: {damage}")


def _has_totals(file: RandomFile, chunk_infos: Iterable[_Record], scan: Scan) -> bool:
    """Use the totals in the descriptions of chunks; return whether they are complete."""
    counts: Counter[int] = Counter()
    times: list[int] = []
    for info in chunk_infos:
        data = read_exactly(file, info.data_at, info.size)
        scan.budget.work(len(data))
        pairs = np.frombuffer(data[: len(data) // 8 * 8], "<u4").reshape(-1, 2).tolist()
        counts.update(dict(pairs))
        if pairs:
            times += info.time(b"start_time"), info.time(b"end_time")
    return scan.set_totals(counts, min(times, default=0), max(times, default=0))


def _chunk_by_index(file: RandomFile, info: _Record, scan: Scan) -> None:
    record = _record_at(file, info.uint64(b"chunk_pos"))
    place, base = _place(record, scan)
    at = record.end
    tables: list[MessageTable] = []
    try:
        for _ in range(info.uint32(b"count")):
            scan.budget.work()
            index = _record_at(file, at)
            if index.op != _INDEX or index.size % _ENTRY.itemsize:
                raise Damaged(f"there is no index record at {at}")
            tables.append(_index_table(file, index, place, base, scan))
            at = index.end
    except Damaged:
        _walk_chunk(file, record, place, base, scan)
    else:
        scan.tables.extend(tables)


def _index_table(file: RandomFile, index: _Record, place: int, base: int, scan: Scan) -> MessageTable:
    scan.budget.spend(messages=index.size // _ENTRY.itemsize, parts=1)
    entries = np.frombuffer(read_exactly(file, index.data_at, index.size), _ENTRY)
    times = entries["sec"].astype(np.int64) * 10**9 + entries["nsec"]
    return scan.table(index.uint32(b"conn"), place, times, entries["offset"].astype(np.int64) + base)


def _place(record: _Record, scan: Scan) -> tuple[int, int]:
    """Return the place of a chunk, and the base of its offsets: of uncompressed messages, offsets are in place 0."""
    if record.op != _CHUNK:
        raise Damaged(f"there is no chunk at the indexed position, at {record.data_at}")
    scan.budget.spend(parts=1)
    compression = _text(record.header, b"compression")
    if compression == "none":
        return 0, record.data_at
    scan.chunks.append(Chunk(record.data_at, record.size, compression, record.uint32(b"size")))
    return len(scan.chunks), 0


def _walk_chunk(file: RandomFile, record: _Record, place: int, base: int, scan: Scan) -> None:
    """Find the messages and connections of a chunk by scanning; a damaged chunk is skipped, with a note."""
    rows = TableBuilder()
    try:
        if place:
            data = inflate(file, scan.chunks[place - 1], scan.budget)
        else:
            scan.budget.work(record.size)
            data = read_exactly(file, record.data_at, record.size)
        source = BytesSource(data)
        at = 0
        while at < source.size:
            scan.budget.work()
            inner = _record_at(source, at)
            if inner.op == _CONNECTION:
                _add_connection(source, inner, scan)
            elif inner.op == _MESSAGE:
                scan.budget.spend(messages=1)
                rows.add(inner.time(), scan.connection(inner.uint32(b"conn")), place, at + base)
            at = inner.end
    except Damaged as damage:
        scan.budget.spend(parts=1)
        scan.notes.append(f"a chunk of it is damaged: {damage}")
    scan.tables.extend(rows.tables())


def _records(source: ByteSource, at: int) -> Iterator[_Record]:
    while at < source.size:
        record = _record_at(source, at)
        yield record
        at = record.end


def _record_at(source: ByteSource, at: int) -> _Record:
    head = source.read_up_to(at, 256)
    size = _header_size(head)
    if not 0 < size <= _MAX_HEADER:
        raise Damaged(f"there is no record at {at}")
    if len(head) < size + 8:
        head = read_exactly(source, at, size + 8)
    header = _fields(head[4 : 4 + size])
    (data_size,) = _UINT32.unpack_from(head, 4 + size)
    data_at = at + size + 8
    if data_at + data_size > source.size:
        raise Damaged(f"the record at {at} is cut off")
    op = header.get(b"op", b"")
    return _Record(op[0] if op else -1, header, data_at, data_size)


def _header_size(head: bytes) -> int:
    """Return the size of the header at the start of these bytes, or 0."""
    return int(_UINT32.unpack_from(head)[0]) if len(head) >= 4 else 0


def _fields(data: bytes) -> dict[bytes, bytes]:
    """Return the fields of a header: `NAME=VALUE`, each after its length."""
    fields: dict[bytes, bytes] = {}
    at = 0
    while at + 4 <= len(data):
        (size,) = _UINT32.unpack_from(data, at)
        name, equals, value = data[at + 4 : at + 4 + size].partition(b"=")
        if not equals or at + 4 + size > len(data):
            raise Damaged("a record's header has a broken field")
        fields[name] = value
        at += 4 + size
    return fields


def _add_connection(source: ByteSource, record: _Record, scan: Scan) -> None:
    """Add a connection to a scan. An incomplete header makes it odd, not the file unreadable."""
    number = record.uint32(b"conn")
    if number in scan.numbers:
        return
    try:
        fields = _fields(read_exactly(source, record.data_at, record.size))
        odd = None
    except Damaged as damage:
        fields, odd = {}, f"its connection header cannot be read: {damage}"
    md5 = _text(fields, b"md5sum")
    connection = RecordedConnection(
        topic=_text(record.header, b"topic") or _text(fields, b"topic"),
        type=_text(fields, b"type"),
        encoding=Encoding.ROS1,
        definition=_text(fields, b"message_definition"),
        hash=md5 if md5 not in ("", "*") else None,
        publisher=_text(fields, b"callerid"),
        latched=_text(fields, b"latching") == "1",
        odd=odd,
    )
    scan.budget.spend(octets=len(connection.definition))
    scan.add(number, connection)


def _text(fields: Mapping[bytes, bytes], name: bytes) -> str:
    return fields.get(name, b"").decode("utf-8", "replace")


def _uint(kind: struct.Struct, header: Mapping[bytes, bytes], name: bytes) -> int:
    value = header.get(name, b"")
    if len(value) != kind.size:
        raise Damaged(f"a record has no {name.decode()}")
    number: int = kind.unpack(value)[0]
    return number
