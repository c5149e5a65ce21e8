"""Records of the MCAP format as bytes (https://mcap.dev/spec): little endian, each with an opcode and a length."""

from __future__ import annotations

import struct
import sys
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = 1, 2, 3, 4, 5, 6, 7, 8
STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = 0x0B, 0x0C, 0x0D, 0x0E, 0x0F
ZSTD = "zstd"
RECORD_HEAD = struct.Struct("<BQ")
MESSAGE_HEAD = struct.Struct("<BQHIQQ")
MESSAGE_FIXED = MESSAGE_HEAD.size - RECORD_HEAD.size
"""Bytes of a message record after its length and before its data: channel, sequence, times."""
_CHUNK_HEAD = struct.Struct("<QQQI")
ZstdError = zstd.ZstdError


class Record(NamedTuple):
    """A record within bytes: its opcode, and the start and end of its content."""

    op: int
    at: int
    end: int


class ChunkHead(NamedTuple):
    """Head of a chunk record: times of its messages, uncompressed size, and checksum."""

    start_ns: int
    end_ns: int
    size: int
    crc: int
    compression: str
    records_at: int


class ChunkIndex(NamedTuple):
    """Place of a chunk in its file, and of the message index of each channel."""

    start_ns: int
    end_ns: int
    at: int
    length: int
    index_at: Mapping[int, int]
    index_length: int
    compressed: int
    size: int


def record(op: int, content: bytes) -> bytes:
    """Return a record with this content."""
    return RECORD_HEAD.pack(op, len(content)) + content


def text(value: str) -> bytes:
    """Return a string with its length."""
    data = value.encode("utf-8", "surrogateescape")
    return struct.pack("<I", len(data)) + data


def texts(values: Mapping[str, str]) -> bytes:
    """Return a map of strings with its length."""
    data = b"".join(text(key) + text(value) for key, value in values.items())
    return struct.pack("<I", len(data)) + data


def header(profile: str, library: str) -> bytes:
    """Return the first record of a file."""
    return record(HEADER, text(profile) + text(library))


def schema(number: int, name: str, encoding: str, definition: str) -> bytes:
    """Return a schema; its encoding is empty if its definition is (MCAP: Schema)."""
    data = definition.encode("utf-8", "surrogateescape")
    named = text(name) + text(encoding if data else "")
    return record(SCHEMA, struct.pack("<H", number) + named + struct.pack("<I", len(data)) + data)


def channel(number: int, schema: int, topic: str, encoding: str, metadata: Mapping[str, str]) -> bytes:
    """Return a channel: one publisher's messages of one topic."""
    return record(CHANNEL, struct.pack("<HH", number, schema) + text(topic) + text(encoding) + texts(metadata))


def metadata(name: str, values: Mapping[str, str]) -> bytes:
    """Return named strings, which readers may ignore."""
    return record(METADATA, text(name) + texts(values))


def metadata_index(at: int, length: int, name: str) -> bytes:
    """Return the summary's record with the place of metadata."""
    return record(METADATA_INDEX, struct.pack("<QQ", at, length) + text(name))


def chunk(start_ns: int, end_ns: int, size: int, crc: int, compressed: bytes) -> bytes:
    """Return a chunk of records, compressed by zstd."""
    head = _CHUNK_HEAD.pack(start_ns, end_ns, size, crc) + text(ZSTD)
    return record(CHUNK, head + struct.pack("<Q", len(compressed)) + compressed)


def message_index(channel: int, entries: bytes) -> bytes:
    """Return the index of a channel's messages in the chunk before it: pairs of time and offset, 8 bytes each."""
    return record(MESSAGE_INDEX, struct.pack("<HI", channel, len(entries)) + entries)


def chunk_index(index: ChunkIndex) -> bytes:
    """Return the summary's index of a chunk."""
    offsets = b"".join(struct.pack("<HQ", channel, at) for channel, at in index.index_at.items())
    return record(
        CHUNK_INDEX,
        struct.pack("<QQQQ", index.start_ns, index.end_ns, index.at, index.length)
        + struct.pack("<I", len(offsets))
        + offsets
        + struct.pack("<Q", index.index_length)
        + text(ZSTD)
        + struct.pack("<QQ", index.compressed, index.size),
    )


def statistics(counts: Mapping[int, int], schemas: int, metadata_count: int, chunks: Sequence[ChunkIndex]) -> bytes:
    """Return the statistics of a file; `counts` are the numbers of messages by channel."""
    by_channel = b"".join(struct.pack("<HQ", channel, count) for channel, count in counts.items())
    start = min((one.start_ns for one in chunks), default=0)
    end = max((one.end_ns for one in chunks), default=0)
    numbers = struct.pack("<QHIIII", sum(counts.values()), schemas, len(counts), 0, metadata_count, len(chunks))
    return record(
        STATISTICS, numbers + struct.pack("<QQ", start, end) + struct.pack("<I", len(by_channel)) + by_channel
    )


def records_in(data: bytes, at: int = 0) -> Iterator[Record]:
    """Yield the complete records from `at` on; a truncated last record is skipped."""
    while at + RECORD_HEAD.size <= len(data):
        op, length = RECORD_HEAD.unpack_from(data, at)
        content = at + RECORD_HEAD.size
        at = content + length
        if at > len(data):
            return
        yield Record(op, content, at)


def chunk_head(data: bytes, at: int = 0) -> ChunkHead:
    """Return the head of a chunk record at `at`. Raises ValueError if it is truncated."""
    try:
        start, end, size, crc = _CHUNK_HEAD.unpack_from(data, at)
        (length,) = struct.unpack_from("<I", data, at + _CHUNK_HEAD.size)
        name = at + _CHUNK_HEAD.size + 4
        compression = data[name : name + length].decode("ascii")
    except (struct.error, UnicodeDecodeError) as error:
        raise ValueError(f"the chunk at {at} has no valid header: {error}") from error
    return ChunkHead(start, end, size, crc, compression, name + length + 8)


def compress(data: bytes) -> bytes:
    """Compress records. Level 1 is faster than 3, and as small for sensor data (bench/history.py)."""
    return zstd.compress(data, level=1)


def decompress(data: bytes, size: int) -> bytes:
    """Decompress the records of a chunk. Raises ValueError unless there are `size` bytes."""
    try:
        output = zstd.decompress(data)
    except ZstdError as error:
        raise ValueError(f"a chunk cannot be decompressed: {error}") from error
    if len(output) != size:
        raise ValueError(f"a chunk has {len(output)} bytes, expected {size}")
    return output
