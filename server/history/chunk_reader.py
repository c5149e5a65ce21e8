"""Reads the messages of a chunk."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from rosld.server.history import mcap_records as mcap
from rosld.server.history.segment_file import SegmentFile


class ChunkMessage(NamedTuple):
    """A message of a chunk; `sequence` are the lower 32 bits of its number."""

    channel: int
    sequence: int
    time_ns: int
    data: bytes


def read_records(file: SegmentFile, at: int, length: int) -> bytes:
    """The records of the chunk record at `at`. Raises OSError, and ValueError where it is damaged."""
    data = file.read(at, length)
    if len(data) != length or data[0] != mcap.CHUNK:
        raise ValueError(f"there is no chunk at {at}")
    head = mcap.chunk_head(data, mcap.RECORD_HEAD.size)
    return mcap.decompress(data[head.records_at :], head.size)


def read_chunk(file: SegmentFile, at: int, length: int) -> Iterator[ChunkMessage]:
    """The messages of the chunk record at `at`. Raises OSError, and ValueError where it is damaged."""
    yield from messages_in(read_records(file, at, length))


def messages_in(inner: bytes) -> Iterator[ChunkMessage]:
    """The messages among the records of a chunk."""
    for record in mcap.records_in(inner):
        if record.op == mcap.MESSAGE:
            start = record.at - mcap.RECORD_HEAD.size
            _, _, channel, sequence, time_ns, _ = mcap.MESSAGE_HEAD.unpack_from(inner, start)
            yield ChunkMessage(channel, sequence, time_ns, inner[start + mcap.MESSAGE_HEAD.size : record.end])
