"""The segments of a history: MCAP files of a minute each with an index; the oldest are removed."""

from __future__ import annotations

import contextlib
import logging
import sqlite3
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

from msgspec import Struct

from rosld.adapters.model import Sample, TypeRef
from rosld.server.history.channel import Channel, model_name
from rosld.server.history.chunk_index import ChunkIndex, ChunkRow, SegmentRow, pack_numbers
from rosld.server.history.mcap_writer import Scan, opening_messages, recover
from rosld.server.history.segment_file import ChunkMessage, DiskFile, MemoryFile, SegmentFile, read_chunk, read_records

log = logging.getLogger("rosld.history")
_INDEX = "index.sqlite"
_SUFFIX = ".mcap"


class HistoryLimits(Struct, frozen=True):
    """Limits of the history: the last `seconds` in `size` bytes, in files of `segment_seconds` or `segment_size`."""

    seconds: float
    size: int
    segment_seconds: float = 60.0
    segment_size: int = 64 * 1024 * 1024


class Segments:
    """The segment files and their index; `folder` is None in memory. Written by one thread, read by any.

    `latched` returns the current latched messages with their topics, which open each file.
    """

    def __init__(
        self,
        folder: Path | None,
        limits: HistoryLimits,
        latched: Callable[[], Iterable[tuple[str, Sample]]] = tuple,
    ) -> None:
        self.folder = folder
        self.limits = limits
        self.latched = latched
        self._index: ChunkIndex | None = None
        self._files: dict[int, SegmentFile] = {}
        self.rows: list[SegmentRow] = []
        """The segments, oldest first (thread-safe)."""
        self._channels: Mapping[int, Mapping[int, Channel]] = {}
        """Channels of the finished segment that was read last."""

    @property
    def index(self) -> ChunkIndex:
        """The index, after `open`."""
        assert self._index is not None, "the history is not open"
        return self._index

    @property
    def first(self) -> int | None:
        """Number of the oldest stored message, or None if there is no segment."""
        return self.rows[0].first if self.rows else None

    @property
    def start_ns(self) -> int:
        """Time of receipt of the oldest stored message in ns, or 0."""
        return next((row.start_ns for row in self.rows if row.start_ns), 0)

    @property
    def end_ns(self) -> int:
        """Time of receipt of the newest stored message in ns, or 0."""
        return max((row.end_ns for row in self.rows), default=0)

    @property
    def size(self) -> int:
        """Bytes of all segments."""
        return sum(file.size for file in list(self._files.values()))

    def open(self) -> int:
        """Open the segments, complete unfinished ones, return the number of the next message. Raises OSError."""
        if self.folder is None:
            self._index = ChunkIndex(None)
            return 0
        self.folder.mkdir(parents=True, exist_ok=True)
        self._index = _open_index(self.folder / _INDEX)
        indexed = {row.name: row for row in self._index.segments()}
        for path in sorted(self.folder.glob(f"*{_SUFFIX}")):
            row = indexed.pop(path.name, None)
            file = DiskFile(path)
            if row is not None and row.finished and row.size == file.size:
                file.close()
                self._files[row.id] = file
            else:
                self._recover(file, row)
        for missing in indexed.values():
            self._index.remove_segment(missing.id)
        self.refresh()
        return self.rows[-1].next if self.rows else 0

    def begin(self, first: int) -> tuple[int, SegmentFile]:
        """Begin a segment with this first number; return its id and file. Raises OSError, sqlite3.Error."""
        name = f"{time.strftime('%Y%m%dT%H%M%SZ', time.gmtime())}-{first:012d}{_SUFFIX}"
        if self.folder is None:
            file: SegmentFile = MemoryFile()
        else:
            (self.folder / name).unlink(missing_ok=True)  # left by a failed start: no message has this number
            file = DiskFile(self.folder / name)
        segment = self.index.add_segment(name, first)
        self._files[segment] = file
        return segment, file

    def file(self, segment: int) -> SegmentFile:
        """Return the file of a segment. Raises KeyError if it was removed."""
        return self._files[segment]

    def refresh(self) -> None:
        """Read the segments from the index again."""
        self.rows = self.index.segments()

    def remove_oldest(self, now_ns: int) -> Counter[str]:
        """Remove whole segments beyond the limits, but never the last; return the numbers of lost messages by topic."""
        removed: Counter[str] = Counter()
        horizon = now_ns - int(self.limits.seconds * 1e9)
        excess = self.size - self.limits.size
        for row in self.rows[:-1]:
            if not row.finished or (excess <= 0 and row.end_ns >= horizon):
                break
            excess -= self._files[row.id].size
            removed.update(self.index.counts_of_segment(row.id))
            self.index.remove_segment(row.id)
            self._files.pop(row.id).remove()
        if removed:
            self.refresh()
        return removed

    def remove(self, segment: int) -> None:
        """Remove an empty segment."""
        self.index.remove_segment(segment)
        self._files.pop(segment).remove()

    def records_of(self, row: ChunkRow) -> bytes:
        """Return the records of a chunk. Raises OSError, ValueError, and KeyError if its segment was removed."""
        return read_records(self._files[row.segment], row.at, row.length)

    def channels_of(self, segment: int) -> Mapping[int, Channel]:
        """Return the indexed channels of a segment by number."""
        channels = self._channels.get(segment)
        is_finished = any(row.id == segment and row.finished for row in self.rows)
        if channels is None or not is_finished:
            channels = self.index.channels(segment)
            if is_finished:
                self._channels = {segment: channels}
        return channels

    def message(self, number: int) -> tuple[Channel, Sample] | None:
        """Return a message by number, or None. Raises OSError, ValueError."""
        row = self.index.find(number)
        return None if row is None else next(self.messages_of(row, number), None)

    def messages_of(self, row: ChunkRow, number: int | None = None) -> Iterator[tuple[Channel, Sample]]:
        """Yield a chunk's messages, or the one with a number.

        Raises OSError, ValueError; KeyError if it was removed.
        """
        channels = self.index.channels(row.segment)
        sequence = None if number is None else number & 0xFFFFFFFF
        for each in read_chunk(self._files[row.segment], row.at, row.length):
            if sequence is None or each.sequence == sequence:
                channel = channels[each.channel]
                yield channel, sample_of(channel, each, row.first + ((each.sequence - row.first) & 0xFFFFFFFF))

    def opening(self, segment: int) -> Iterator[tuple[Channel, Sample]]:
        """Yield the opening messages of a segment with their times. Raises OSError, ValueError, KeyError."""
        yield from opening_messages(self._files[segment])

    def close(self) -> None:
        """Close the index. Idempotent."""
        if self._index is not None:
            self._index.close()

    def _recover(self, file: DiskFile, row: SegmentRow | None) -> None:
        """Complete and index a file that is not completely indexed."""
        if row is not None:
            self.index.remove_segment(row.id)
        try:
            scan = recover(file)
        except (ValueError, KeyError, OSError) as error:
            log.warning("the history file %s cannot be used: %s", file.path.name, error)
            with contextlib.suppress(OSError):
                file.close()
            return
        if not scan.chunks:
            file.remove()
            return
        segment = self.index.add_segment(file.path.name, scan.first)
        self._files[segment] = file
        _index_scan(self.index, segment, scan, file.size)


def sample_of(channel: Channel, message: ChunkMessage, number: int) -> Sample:
    """Return a recorded message as a sample; its sequence is its number plus one."""
    return Sample(
        message.data,
        channel.encoding,
        channel.type,
        channel.publisher,
        message.time_ns,
        number + 1,
        latched=channel.latched,
    )


def _index_scan(index: ChunkIndex, segment: int, scan: Scan, size: int) -> None:
    rows = [
        ChunkRow(
            segment,
            *chunk.place,
            chunk.topic,
            len(chunk.numbers),
            min(chunk.numbers),
            max(chunk.numbers),
            chunk.start_ns,
            chunk.end_ns,
            pack_numbers(chunk.numbers),
        )
        for chunk in scan.chunks
    ]
    channels = {
        one._replace(type=TypeRef(model_name(one.type.name), one.type.hash)): number
        for number, one in scan.channels.items()
        if not one.is_opening
    }
    texts = {model_name(name): text for name, text in scan.definitions.items() if text}
    index.add_chunks(segment, rows, channels, size)
    index.define((one.type, texts[one.type.name]) for one in channels if one.type.name in texts)
    index.finish_segment(segment, size)


def _open_index(path: Path) -> ChunkIndex:
    """Return the index at `path`; an unreadable one is rebuilt from the segments. Raises OSError."""
    try:
        return ChunkIndex(path)
    except sqlite3.Error as error:
        log.warning("rebuilding the index of the history: %s", error)
    for each in path.parent.glob(f"{path.name}*"):
        each.unlink()
    try:
        return ChunkIndex(path)
    except sqlite3.Error as error:
        raise OSError(f"the index {path} cannot be created: {error}") from error
