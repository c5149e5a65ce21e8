"""Writer of an MCAP file whose chunks contain one topic each; an unfinished file can be recovered."""

from __future__ import annotations

import struct
import zlib
from array import array
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from importlib.metadata import version
from typing import NamedTuple

import numpy as np
from msgspec import Struct, field

from rosld.adapters.model import Encoding, Sample, TypeRef
from rosld.adapters.model.mcap import MAGIC, SILENT_TOPICS, Fields
from rosld.server.history import mcap_records as mcap
from rosld.server.history.channel import PROFILES, Channel, channel_record, model_name, read_channel, schema_record
from rosld.server.history.mcap_records import MESSAGE, MESSAGE_FIXED, MESSAGE_HEAD
from rosld.server.history.segment_file import ChunkMessage, DiskFile, SegmentFile, read_records

MAX_MESSAGES = 500
MAX_BYTES = 4 * 1024 * 1024
MAX_SECONDS = 1.0
"""Maximum age of a chunk in seconds: with the delays of a busy machine, less than two seconds are lost."""


class TopicChunk:
    """Messages of one topic as MCAP records, with the times and offsets of each channel. Filled by one thread.

    The `sequence` of a record is the lower 32 bits of the message's number.
    """

    __slots__ = ("channels", "count", "end_ns", "entries", "numbers", "opened", "parts", "size", "start_ns", "topic")

    def __init__(self, topic: str, opened: float) -> None:
        """Create an empty chunk. `opened` is the time of its first message, in seconds of the monotonic clock."""
        self.topic = topic
        self.opened = opened
        self.parts: list[bytes] = []
        self.entries: dict[int, array[int]] = {}
        self.numbers: array[int] = array("Q")
        self.channels: array[int] = array("H")
        self.size = 0
        self.count = 0
        self.start_ns = 1 << 63
        self.end_ns = 0

    def add(self, channel: int, number: int, time_ns: int, data: bytes, published_ns: int | None = None) -> None:
        """Append a message. `published_ns` is its time of publication, if it differs from `time_ns`."""
        length, published = len(data), time_ns if published_ns is None else published_ns
        head = MESSAGE_HEAD.pack(MESSAGE, MESSAGE_FIXED + length, channel, number & 0xFFFFFFFF, time_ns, published)
        self.parts.append(head)
        self.parts.append(data)
        entries = self.entries.get(channel)
        if entries is None:
            entries = self.entries[channel] = array("Q")
        entries.append(time_ns)
        entries.append(self.size)
        self.numbers.append(number)
        self.channels.append(channel)
        self.size += MESSAGE_HEAD.size + length
        self.count += 1
        if time_ns < self.start_ns:
            self.start_ns = time_ns
        if time_ns > self.end_ns:
            self.end_ns = time_ns

    def is_due(self, now: float) -> bool:
        """Whether the chunk must be written now."""
        return self.count >= MAX_MESSAGES or self.size >= MAX_BYTES or now - self.opened >= MAX_SECONDS

    def messages(self) -> list[ChunkMessage]:
        """Return all messages; their `sequence` is the full number."""
        heads = map(MESSAGE_HEAD.unpack, self.parts[::2])
        messages = zip(heads, self.numbers, self.parts[1::2], strict=False)
        return [ChunkMessage(head[2], number, head[4], data) for head, number, data in messages]

    def message(self, number: int) -> tuple[int, int, bytes] | None:
        """Return the channel, time and data of the message of this number, or None (thread-safe)."""
        for at, each in enumerate(self.numbers):
            if each == number:
                head = self.parts[2 * at]
                _, _, channel, _, time_ns, _ = MESSAGE_HEAD.unpack(head)
                return channel, time_ns, self.parts[2 * at + 1]
        return None


NUMBERS = "rosld.numbers"
"""Name of the metadata record with the number of a file's first message."""
_MAX_CHANNELS = 65_535


class Place(NamedTuple):
    """Place of a chunk in its file."""

    at: int
    length: int


class McapWriter:
    """Writer of one file. `definition_of` returns the text of a type, or an empty string if it is unknown.

    Every write is a single `append`; if it fails, nothing is written, and writing can go on.
    """

    def __init__(
        self, file: SegmentFile, encoding: Encoding, definition_of: Callable[[TypeRef], str], first: int
    ) -> None:
        """Begin a file whose first message will have the number `first`. Raises OSError."""
        self.file = file
        self.channels: dict[Channel, int] = {}
        self._definition_of = definition_of
        self._schemas: dict[TypeRef, int] = {}
        self._written: set[int] = set()
        self._records: dict[int, bytes] = {}
        self._summary = Summary()
        begin = MAGIC + mcap.header(PROFILES[encoding], f"rosld {version('rosld')}")
        file.append(begin + mcap.metadata(NUMBERS, {"first": str(first)}))

    @property
    def count(self) -> int:
        """Number of messages written, except opening ones."""
        opening = (number for one, number in self.channels.items() if one.is_opening)
        return sum(self._summary.counts.values()) - sum(self._summary.counts[number] for number in opening)

    def has_room(self) -> bool:
        """Whether the file can take another channel."""
        return len(self.channels) < _MAX_CHANNELS

    def channel(self, channel: Channel) -> int:
        """Return the number of a channel in this file, assigned on first use."""
        number = self.channels.get(channel)
        if number is None:
            number = self.channels[channel] = len(self.channels) + 1
        return number

    def write(self, chunk: TopicChunk) -> Place:
        """Write a chunk with its indexes, preceded by the channels that are new in the file."""
        new = [number for number in chunk.entries if number not in self._written]
        prefix = self._describe(new)
        data = b"".join([prefix, *chunk.parts])
        compressed = mcap.compress(data)
        at = self.file.size
        written = mcap.chunk(chunk.start_ns, chunk.end_ns, len(data), zlib.crc32(data), compressed)
        parts, end, index_at = [written], at + len(written), dict[int, int]()
        for number, entries in chunk.entries.items():
            part = mcap.message_index(number, _shifted(entries, len(prefix)))
            index_at[number] = end
            parts.append(part)
            end += len(part)
        self.file.append(b"".join(parts))
        self._written.update(new)
        counts = {number: len(entries) // 2 for number, entries in chunk.entries.items()}
        index = mcap.ChunkIndex(
            chunk.start_ns,
            chunk.end_ns,
            at,
            len(written),
            index_at,
            end - at - len(written),
            len(compressed),
            len(data),
        )
        self._summary.add(index, counts)
        return Place(at, len(written))

    def finish(self, silent: Sequence[str] = ()) -> None:
        """Write the summary and close the file. Raises OSError; the file can then still be recovered.

        The summary names the `silent` topics: selected for the file, but without messages.
        """
        if silent:
            named = mcap.metadata(SILENT_TOPICS, dict.fromkeys(silent, ""))
            self._summary.metadata.append(mcap.metadata_index(self.file.size, len(named), SILENT_TOPICS))
            self.file.append(named)
        self.file.append(self._summary.end_of_file(self.file.size, self._records.values()))
        self.file.close()

    def _describe(self, new: Iterable[int]) -> bytes:
        """Return the records of new channels and their schemas, which precede the messages of a chunk."""
        named = {number: channel for channel, number in self.channels.items()} if new else {}
        records: list[bytes] = []
        for number in new:
            channel = named[number]
            schema = self._schemas.get(channel.type)
            if schema is None:
                schema = self._schemas[channel.type] = len(self._schemas) + 1
                described = schema_record(schema, channel.type, channel.encoding, self._definition_of(channel.type))
                self._records[-schema] = described
            records.append(self._records[-schema])
            self._records[number] = channel_record(number, schema, channel)
            records.append(self._records[number])
        return b"".join(records)


class Summary:
    """Summary of a file: the places of its chunks, and the number of messages of each channel."""

    def __init__(self) -> None:
        self.chunks: list[mcap.ChunkIndex] = []
        self.counts: Counter[int] = Counter()
        self.metadata: list[bytes] = []
        """Index records of the metadata, except the one with the number of the first message."""

    def add(self, chunk: mcap.ChunkIndex, counts: Mapping[int, int]) -> None:
        """Add a chunk, with its numbers of messages by channel."""
        self.chunks.append(chunk)
        self.counts.update(counts)

    def end_of_file(self, at: int, described: Iterable[bytes]) -> bytes:
        """Return the end of a file of `at` bytes; `described` are its schemas and channels."""
        records = list(described)
        schemas = [each for each in records if each[0] == mcap.SCHEMA]
        channels = [each for each in records if each[0] == mcap.CHANNEL]
        groups = (
            (mcap.SCHEMA, b"".join(schemas)),
            (mcap.CHANNEL, b"".join(channels)),
            (mcap.STATISTICS, mcap.statistics(self.counts, len(schemas), 1 + len(self.metadata), self.chunks)),
            (mcap.CHUNK_INDEX, b"".join(map(mcap.chunk_index, self.chunks))),
            (mcap.METADATA_INDEX, b"".join(self.metadata)),
        )
        data_end = mcap.record(mcap.DATA_END, struct.pack("<I", 0))
        start = offset = at + len(data_end)
        offsets: list[bytes] = []
        for op, group in groups:
            if group:
                offsets.append(mcap.record(mcap.SUMMARY_OFFSET, struct.pack("<BQQ", op, offset, len(group))))
                offset += len(group)
        summary = b"".join([*(group for _, group in groups), *offsets])
        footer = mcap.RECORD_HEAD.pack(mcap.FOOTER, 20) + struct.pack("<QQ", start, offset)
        crc = struct.pack("<I", zlib.crc32(footer, zlib.crc32(summary)))
        return data_end + summary + footer + crc + MAGIC


def _shifted(entries: array[int], offset: int) -> bytes:
    """Return the entries of a message index with `offset` added to their offsets."""
    if not offset:
        return entries.tobytes()
    pairs = np.frombuffer(entries, np.uint64).copy()
    pairs[1::2] += np.uint64(offset)
    return bytes(pairs.tobytes())


class ScannedChunk(Struct):
    """A chunk found by the scan: its place, its channel, and the numbers of its messages."""

    place: Place
    topic: str
    start_ns: int
    end_ns: int
    numbers: array[int]


class Scan(Struct):
    """The complete contents of a file up to `end`; `definitions` are the texts of types by name."""

    first: int = 0
    end: int = 0
    is_finished: bool = False
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[ScannedChunk] = field(default_factory=list)
    definitions: dict[str, str] = field(default_factory=dict)
    summary: Summary = field(default_factory=Summary)
    described: dict[bytes, None] = field(default_factory=dict)


def scan(data: bytes) -> Scan:
    """Return the contents up to the last complete chunk. Raises ValueError for another format."""
    if not data.startswith(MAGIC):
        raise ValueError("it is not an MCAP file")
    result = Scan(end=len(MAGIC))
    names: dict[int, str] = {}
    pending: tuple[mcap.Record, ScannedChunk, Counter[int]] | None = None
    index_at: dict[int, int] = {}
    for record in mcap.records_in(data, len(MAGIC)):
        begin = record.at - mcap.RECORD_HEAD.size
        if record.op == mcap.MESSAGE_INDEX and pending is not None:
            index_at[int.from_bytes(data[record.at : record.at + 2], "little")] = begin
            if set(index_at) == set(pending[2]):
                _accept(result, data, pending, index_at, record.end)
                pending, index_at = None, {}
        elif record.op == mcap.CHUNK and pending is None:
            try:
                chunk, counts = _chunk(result, data, record, names)
            except (ValueError, KeyError):
                break
            pending = record, chunk, counts
        elif record.op == mcap.DATA_END and pending is None:
            result.is_finished = data.endswith(MAGIC) and len(data) > record.end
            break
        elif record.op == mcap.METADATA and pending is None:
            fields = Fields(data[record.at : record.end])
            if fields.text() == NUMBERS:
                result.first = int(fields.texts()["first"])
            result.end = record.end
        elif record.op == mcap.HEADER:
            result.end = record.end
        else:
            break
    return result


def recover(file: DiskFile) -> Scan:
    """Complete an unfinished file, without its incomplete end. Raises ValueError, OSError."""
    result = scan(file.read(0, file.size))
    if not result.is_finished:
        file.truncate(result.end)
        file.append(result.summary.end_of_file(result.end, result.described))
        result.is_finished = True
    file.close()
    return result


def opening_messages(file: SegmentFile) -> Iterator[tuple[Channel, Sample]]:
    """Yield the opening messages of a file, with their original times of receipt.

    Raises OSError, and ValueError or KeyError if it is damaged.
    """
    at = len(MAGIC)
    names: dict[int, str] = {}
    while len(head := file.read(at, mcap.RECORD_HEAD.size)) == mcap.RECORD_HEAD.size:
        op, length = mcap.RECORD_HEAD.unpack(head)
        if op == mcap.CHUNK:
            messages = list(_opening(read_records(file, at, mcap.RECORD_HEAD.size + length), names))
            if not messages:
                return
            yield from messages
        at += mcap.RECORD_HEAD.size + length


def _opening(data: bytes, names: dict[int, str]) -> Iterator[tuple[Channel, Sample]]:
    """Yield the opening messages of a chunk; `names` collects the names of types by schema number."""
    channels: dict[int, Channel] = {}
    for record in mcap.records_in(data):
        if record.op == mcap.SCHEMA:
            fields = Fields(data[record.at : record.end])
            schema = fields.uint(2)
            names[schema] = model_name(fields.text())
        elif record.op == mcap.CHANNEL:
            number, channel = read_channel(Fields(data[record.at : record.end]), names)
            channels[number] = channel
        elif record.op == mcap.MESSAGE:
            begin = record.at - mcap.RECORD_HEAD.size
            _, _, number, sequence, _, received_ns = mcap.MESSAGE_HEAD.unpack_from(data, begin)
            source, content = channels.get(number), data[begin + mcap.MESSAGE_HEAD.size : record.end]
            if source is None or not source.is_opening:
                return
            yield (
                source,
                Sample(content, source.encoding, source.type, source.publisher, received_ns, sequence, latched=True),
            )


def _accept(
    result: Scan,
    data: bytes,
    pending: tuple[mcap.Record, ScannedChunk, Counter[int]],
    index_at: dict[int, int],
    end: int,
) -> None:
    record, chunk, counts = pending
    head = mcap.chunk_head(data, record.at)
    compressed = record.end - head.records_at
    place = chunk.place
    index = mcap.ChunkIndex(
        head.start_ns,
        head.end_ns,
        place.at,
        place.length,
        index_at,
        end - place.at - place.length,
        compressed,
        head.size,
    )
    result.summary.add(index, counts)
    if chunk.numbers:
        result.chunks.append(chunk)
    result.end = end


def _chunk(result: Scan, data: bytes, record: mcap.Record, names: dict[int, str]) -> tuple[ScannedChunk, Counter[int]]:
    """Return a chunk with the number of messages of each channel. Raises ValueError, KeyError if it is damaged."""
    head = mcap.chunk_head(data, record.at)
    inner = mcap.decompress(data[head.records_at : record.end], head.size)
    if zlib.crc32(inner) != head.crc:
        raise ValueError("its checksum is wrong")
    numbers, counts, topic = array("Q"), Counter[int](), ""
    for each in mcap.records_in(inner):
        if each.op == mcap.SCHEMA:
            fields = Fields(inner[each.at : each.end])
            number, name, _, text = fields.uint(2), fields.text(), fields.text(), fields.text()
            names[number] = name
            result.definitions[name] = text
            result.described[inner[each.at - mcap.RECORD_HEAD.size : each.end]] = None
        elif each.op == mcap.CHANNEL:
            number, channel = read_channel(Fields(inner[each.at : each.end]), names)
            result.channels[number] = channel
            result.described[inner[each.at - mcap.RECORD_HEAD.size : each.end]] = None
        elif each.op == mcap.MESSAGE:
            _, _, number, sequence, _, _ = mcap.MESSAGE_HEAD.unpack_from(inner, each.at - mcap.RECORD_HEAD.size)
            topic = result.channels[number].topic
            counts[number] += 1
            if not result.channels[number].is_opening:  # opening messages have no number
                numbers.append(result.first + ((sequence - result.first) & 0xFFFFFFFF))
    begin = record.at - mcap.RECORD_HEAD.size
    return ScannedChunk(Place(begin, record.end - begin), topic, head.start_ns, head.end_ns, numbers), counts
