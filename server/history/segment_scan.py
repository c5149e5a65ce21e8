"""Scan of an MCAP file that rosld wrote: to rebuild a lost index, and to recover an unfinished file."""

from __future__ import annotations

import zlib
from array import array
from collections import Counter
from collections.abc import Iterator

from msgspec import Struct, field

from rosld.adapters.model import Sample
from rosld.adapters.model.mcap import MAGIC, Fields
from rosld.server.history import mcap_records as mcap
from rosld.server.history.channel import Channel, model_name, read_channel
from rosld.server.history.mcap_writer import NUMBERS, Place, Summary
from rosld.server.history.segment_file import DiskFile, SegmentFile, read_records


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
