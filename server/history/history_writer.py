"""Writer of the history: numbers messages, fills chunks, starts and finishes segments."""

from __future__ import annotations

import errno
import logging
import os
import sqlite3
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from rosld.adapters.model import Sample, TypeRef
from rosld.server.history.channel import Channel, channel_of
from rosld.server.history.chunk_index import ChunkRow, pack_numbers
from rosld.server.history.mcap_writer import McapWriter, TopicChunk
from rosld.server.history.recorder import LatchedMessages
from rosld.server.history.segment_file import ChunkMessage
from rosld.server.history.segments import Segments, sample_of

log = logging.getLogger("rosld.history")
_RETRY = 5.0
"""Seconds after which a full disk is checked again."""
_RESERVE = 64 * 1024 * 1024
_OVERLAPPING = 2
"""Number of latest chunks of a topic that are searched: receipt times of several publishers overlap."""
_RESERVED_PART = 16
"""Reserved space of a small disk, as a divisor of its size; other disks reserve `_RESERVE`."""
_OPENING_PART = 4
"""Maximum share of opening messages in a segment, as a divisor of its size; larger messages are skipped."""
_Failures = (OSError, sqlite3.Error)


class HistoryWriter:
    """The segments of the history and its unfinished chunks. The recorder's thread writes; any thread reads.

    `dropped` counts lost messages by topic; `problem` is the reason why nothing is written at the moment.
    """

    def __init__(self, segments: Segments, definition_of: Callable[[TypeRef], str]) -> None:
        self.segments = segments
        self.next = 0
        self.start_ns = 0
        self.end_ns = 0
        self.counts: dict[str, int] = {}
        self.types: dict[str, TypeRef] = {}
        self.dropped: Counter[str] = Counter()
        self.problem: str | None = None
        self._definition_of = definition_of
        self._lock = threading.Lock()
        self._open: dict[str, TopicChunk] = {}
        self._closing: tuple[TopicChunk, ...] = ()
        self._current: tuple[int, McapWriter, float] | None = None
        self._retry_at = 0.0

    def open(self) -> None:
        """Open the stored history. Raises OSError."""
        self.next = self.segments.open()
        for topic, (count, type) in self.segments.index.counts().items():
            self.counts[topic], self.types[topic] = count, type
        self.start_ns, self.end_ns = self.segments.start_ns, self.segments.end_ns

    @property
    def first(self) -> int:
        """Number of the oldest message."""
        first = self.segments.first
        return self.next if first is None else first

    def add(self, topic: str, sample: Sample) -> None:
        """Add a message; while nothing can be written, count it as dropped."""
        if self.problem is not None and time.monotonic() < self._retry_at:
            self.dropped[topic] += 1
            return
        if self._current is not None and not self._current[1].has_room():
            self.write_due(time.monotonic())
        try:
            _, writer, _ = self._current or self._begin(sample)
        except _Failures as error:
            self._fail(error)
            self.dropped[topic] += 1
            return
        channel = writer.channel(channel_of(topic, sample))
        with self._lock:
            chunk = self._open.get(topic)
            if chunk is None:
                chunk = self._open[topic] = TopicChunk(topic, time.monotonic())
            chunk.add(channel, self.next, sample.received_ns, sample.data)
        self.next += 1
        self.start_ns = self.start_ns or sample.received_ns
        self.end_ns = max(self.end_ns, sample.received_ns)
        self.counts[topic] = self.counts.get(topic, 0) + 1
        self.types[topic] = sample.schema
        if chunk.size > 2 * self.segments.limits.segment_size // 3:
            self.write_due(time.monotonic())

    def write_due(self, now: float) -> None:
        """Write the chunks that are due at `now` (monotonic clock); start a new segment when it is time."""
        if self._current is None:
            return
        _, writer, began = self._current
        limits = self.segments.limits
        is_full = writer.file.size >= limits.segment_size or not writer.has_room()
        ends = is_full or now - began >= limits.segment_seconds
        # Chunks refer to channels by their numbers in this file, so none may move to the next file.
        self._write([chunk for chunk in self._open.values() if ends or chunk.is_due(now)])
        if ends and self._current is not None:
            self._finish()

    def close(self) -> None:
        """Write all chunks, and finish the segment. Idempotent."""
        self.write_all()
        if self._current is not None:
            self._finish()

    def write_all(self) -> None:
        """Write all chunks, due or not."""
        self._write(list(self._open.values()))

    def message(self, number: int) -> tuple[Channel, Sample] | None:
        """Return a message by number, or None. Raises OSError, ValueError."""
        for _ in range(2):  # a chunk may be written between the two lookups
            found = self._unwritten(number) or self.segments.message(number)
            if found is not None:
                return found
        return None

    def topic_of(self, number: int) -> str | None:
        """Return the topic of a message by number, or None, without reading the message."""
        for _ in range(2):  # see `message`
            with self._lock:
                chunks = (*self._closing, *self._open.values())
                topic = next((chunk.topic for chunk in chunks if number in chunk.numbers), None)
            row = self.segments.index.find(number) if topic is None else None
            if topic is not None or row is not None:
                return topic if row is None else row.topic
        return None

    def unwritten(self, topic: str) -> list[Sample]:
        """Return the messages of a topic that are not indexed yet, in the order of receipt."""
        with self._lock:
            chunks = [chunk for chunk in (*self._closing, *self._open.values()) if chunk.topic == topic]
            current = self._current
            samples = [each for chunk in chunks for each in chunk.messages()]
        if current is None:
            return []
        channels = list(current[1].channels)
        return [sample_of(channels[each.channel - 1], each, each.sequence) for each in samples]

    def unwritten_messages(self) -> list[tuple[int, Channel, Sample]]:
        """Return all messages that are not indexed yet, with their numbers, ascending."""
        with self._lock:
            current = self._current
            messages = [each for chunk in (*self._closing, *self._open.values()) for each in chunk.messages()]
        if current is None:
            return []
        channels = list(current[1].channels)
        messages.sort(key=_sequence)
        return [
            (each.sequence, channels[each.channel - 1], sample_of(channels[each.channel - 1], each, each.sequence))
            for each in messages
        ]

    @property
    def settled(self) -> int:
        """Number below which all messages are written."""
        with self._lock:
            numbers = [chunk.numbers[0] for chunk in (*self._closing, *self._open.values()) if chunk.count]
            return min(numbers, default=self.next)

    def latest_at(self, topic: str, time_ns: int) -> Sample | None:
        """Return the latest message of a topic at a time, or None. Raises OSError, ValueError."""
        samples = [each for each in self.unwritten(topic) if each.received_ns <= time_ns]
        if not samples:
            rows = self.segments.index.newest(topic, time_ns, _OVERLAPPING)
            samples = [each for row in rows for _, each in self.segments.messages_of(row)]
        return max((each for each in samples if each.received_ns <= time_ns), key=_received, default=None)

    def latched_at(self, time_ns: int, selects: Callable[[str], bool]) -> list[tuple[str, Sample]]:
        """Return the latest latched messages from before a time, of wanted topics, in the order of receipt.

        Reads those that open the segment of that time, and those received in it. Raises OSError, ValueError.
        """
        rows, index = self.segments.rows, self.segments.index
        row = next((each for each in reversed(rows) if 0 < each.start_ns <= time_ns), rows[0] if rows else None)
        latched = LatchedMessages()
        if row is not None:
            for channel, sample in self.segments.opening(row.id):
                latched.take(channel.topic, sample)
            for topic in {one.topic for one in index.channels(row.id).values() if one.latched and selects(one.topic)}:
                chunks = [each for each in index.of_topic(topic, 0, time_ns) if each.segment == row.id]
                for _, sample in (one for each in chunks for one in self.segments.messages_of(each)):
                    if sample.received_ns < time_ns:
                        latched.take(topic, sample)
        return latched.messages(selects)

    def _unwritten(self, number: int) -> tuple[Channel, Sample] | None:
        with self._lock:
            chunks = (*self._closing, *self._open.values())
            current = self._current
            found = next((one for chunk in chunks if (one := chunk.message(number)) is not None), None)
        if found is None or current is None:
            return None
        channel = list(current[1].channels)[found[0] - 1]
        return channel, sample_of(channel, ChunkMessage(found[0], number, *found[1:]), number)

    def _begin(self, sample: Sample) -> tuple[int, McapWriter, float]:
        require_room(self.segments.folder)
        segment, file = self.segments.begin(self.next)
        try:
            writer = McapWriter(file, sample.encoding, self._definition, self.next)
            self._write_opening(writer, sample.received_ns)
        except OSError:
            self.segments.remove(segment)
            raise
        self._current = segment, writer, time.monotonic()
        self.segments.refresh()
        if self.problem is not None:
            log.warning("recording of the history has resumed")
            self.problem = None
        return self._current

    def _write_opening(self, writer: McapWriter, time_ns: int) -> None:
        """Write the earlier latched messages, without numbers and not indexed: they are in the history already."""
        chunks: dict[str, TopicChunk] = {}
        left = self.segments.limits.segment_size // _OPENING_PART
        for topic, sample in self.segments.latched():
            if sample.received_ns < time_ns and len(sample.data) <= left:
                left -= len(sample.data)
                channel = writer.channel(channel_of(topic, sample, is_opening=True))
                chunk = chunks.setdefault(topic, TopicChunk(topic, time.monotonic()))
                chunk.add(channel, self.next, time_ns, sample.data, sample.received_ns)
        for chunk in chunks.values():
            writer.write(chunk)

    def _write(self, chunks: list[TopicChunk]) -> None:
        if not chunks or self._current is None:
            return
        segment, writer, _ = self._current
        with self._lock:
            # Until they are indexed, readers find messages here: each is always in one of the three places.
            self._closing = tuple(chunks)
            for chunk in chunks:
                del self._open[chunk.topic]
        rows: list[ChunkRow] = []
        try:
            require_room(self.segments.folder)
            for chunk in chunks:
                place = writer.write(chunk)
                rows.append(_row(segment, chunk, *place))
            channels = {one: number for one, number in writer.channels.items() if not one.is_opening}
            self.segments.index.add_chunks(segment, rows, channels, writer.file.size)
            self.segments.refresh()
        except _Failures as error:
            self._fail(error)
            for chunk in chunks[len(rows) :]:
                self._drop(chunk)
        with self._lock:
            self._closing = ()

    def _finish(self) -> None:
        assert self._current is not None
        segment, writer, _ = self._current
        self._current = None
        try:
            if writer.count:
                writer.finish()
                self.segments.index.finish_segment(segment, writer.file.size)
            else:
                self.segments.remove(segment)
            self.segments.refresh()
            for topic, count in self.segments.remove_oldest(time.time_ns()).items():
                self.counts[topic] -= count
            self.start_ns = self.segments.start_ns
        except _Failures as error:
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        """Stop for `_RETRY` seconds. Open chunks are lost; the segment is completed once there is space."""
        if self.problem is None:
            where = "" if self.segments.folder is None else f" in {self.segments.folder}"
            reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
            self.problem = f"The history is not recorded: {reason}{where}. Recording resumes when space is available."
            log.error("%s", self.problem)
        self._retry_at = time.monotonic() + _RETRY
        with self._lock:
            left, self._open = list(self._open.values()), {}
        for chunk in left:
            self._drop(chunk)
        if self._current is not None:
            self._finish()

    def _drop(self, chunk: TopicChunk) -> None:
        self.dropped[chunk.topic] += chunk.count
        self.counts[chunk.topic] -= chunk.count

    def _definition(self, ref: TypeRef) -> str:
        text = self._definition_of(ref)
        if text:
            self.segments.index.define([(ref, text)])
        return text


def _received(sample: Sample) -> int:
    return sample.received_ns


def _sequence(message: ChunkMessage) -> int:
    return message.sequence


def _row(segment: int, chunk: TopicChunk, at: int, length: int) -> ChunkRow:
    return ChunkRow(
        segment,
        at,
        length,
        chunk.topic,
        chunk.count,
        chunk.numbers[0],
        chunk.numbers[-1],
        chunk.start_ns,
        chunk.end_ns,
        pack_numbers(chunk.numbers),
    )


def require_room(folder: Path | None) -> None:
    """Raise OSError (ENOSPC) if the disk has no space beyond the reserve for everything else."""
    if folder is None:
        return
    status = os.statvfs(folder)
    if status.f_bavail * status.f_frsize < min(_RESERVE, status.f_blocks * status.f_frsize // _RESERVED_PART):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
