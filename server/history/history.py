"""History of a robot: the recording named `history`, written continuously within limits."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import logging
import sqlite3
import threading
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TypeAlias

from rosld.adapters.base import PAGE_BYTES, Adapter, MessageFilter, MessagePage, RecordedMessage, RecordedTopic, Watch
from rosld.adapters.model import Encoding, NotFound, Sample, Schema, TypeRef, UnknownType, Unreachable
from rosld.adapters.model.library import TypeLibrary
from rosld.server.history.bag_export import BagExports
from rosld.server.history.chunk_index import ChunkIndex, ChunkRow, unpack_numbers
from rosld.server.history.history_writer import HistoryWriter
from rosld.server.history.message_block import MessageBlock
from rosld.server.history.recorder import Sink
from rosld.server.history.segments import HistoryLimits, Segments
from rosld.server.history.topic_feed import LiveRecorder
from rosld.server.runtime.tasks import Signal
from rosld.server.settings import Settings


def select_messages(writer: HistoryWriter, criteria: MessageFilter, limit: int) -> MessagePage:
    """Return at most `limit` messages of the history, of about `PAGE_BYTES` in total."""
    at_hand = _unwritten(writer, criteria)  # first: what is written meanwhile is then in both, not in neither
    rows = _written(writer, criteria, limit + 1)
    messages: list[RecordedMessage] = []
    read: dict[int, RecordedMessage] = {}
    size = 0
    for number in sorted({*at_hand, *rows}):
        if len(messages) == limit or size >= PAGE_BYTES:
            return MessagePage(messages, number)
        row = rows.get(number)
        if row is not None and number not in read:
            numbers = {each for each, one in rows.items() if one is row}
            read |= {each: message for each, message in _messages(writer, row).items() if each in numbers}
        message = at_hand.get(number) or read.pop(number, None)
        if message is not None:
            messages.append(message)
            size += len(message.sample.data)
    return MessagePage(messages, None)


def _unwritten(writer: HistoryWriter, criteria: MessageFilter) -> dict[int, RecordedMessage]:
    return {
        number: RecordedMessage(number, channel.topic, sample)
        for number, channel, sample in writer.unwritten_messages()
        if (criteria.topics is None or channel.topic in criteria.topics) and _matches(number, sample, criteria)
    }


def _written(writer: HistoryWriter, criteria: MessageFilter, limit: int) -> dict[int, ChunkRow]:
    """Return the chunks of the first `limit` messages in the index, by number."""
    rows: dict[int, ChunkRow] = {}
    for segment in writer.segments.rows:
        if segment.next <= criteria.start or segment.first >= criteria.end:
            continue
        if not segment.end_ns or segment.end_ns < criteria.from_ns or segment.start_ns > criteria.to_ns:
            continue
        for topic in (None,) if criteria.topics is None else sorted(criteria.topics):
            rows |= _of_segment(writer, segment.id, topic, criteria, limit)
        if len(rows) >= limit:
            break  # numbers increase from segment to segment
    return {number: rows[number] for number in sorted(rows)[:limit]}


def _of_segment(
    writer: HistoryWriter, segment: int, topic: str | None, criteria: MessageFilter, limit: int
) -> dict[int, ChunkRow]:
    """Return the chunks of the first `limit` messages of a topic (None: of all) in a segment, by number."""
    rows: dict[int, ChunkRow] = {}
    after = -1
    while True:
        batch = writer.segments.index.of_numbers(
            segment, topic, criteria.start, criteria.from_ns, criteria.to_ns, after, limit
        )
        for row in batch:
            if len(rows) >= limit and row.first > sorted(rows)[limit - 1]:
                return rows  # this chunk and the following ones start after the last wanted message
            rows |= dict.fromkeys(_numbers(writer, row, criteria), row)
        if len(batch) < limit:
            return rows
        after = batch[-1].first


def _numbers(writer: HistoryWriter, row: ChunkRow, criteria: MessageFilter) -> list[int]:
    """Return the wanted numbers of a chunk, which is read only if it is partly outside the times."""
    if criteria.from_ns <= row.start_ns and row.end_ns <= criteria.to_ns:
        return [each for each in unpack_numbers(row).tolist() if criteria.start <= each < criteria.end]
    read = _messages(writer, row).values()
    return [each.index for each in read if _matches(each.index, each.sample, criteria)]


def _matches(number: int, sample: Sample, criteria: MessageFilter) -> bool:
    return criteria.start <= number < criteria.end and criteria.from_ns <= sample.received_ns <= criteria.to_ns


def _messages(writer: HistoryWriter, row: ChunkRow) -> dict[int, RecordedMessage]:
    """Return the messages of a chunk by number; none if it is damaged or was removed."""
    messages: dict[int, RecordedMessage] = {}
    try:
        for channel, sample in writer.segments.messages_of(row):
            number = sample.sequence - 1
            messages[number] = RecordedMessage(number, channel.topic, sample)
    except (OSError, ValueError) as error:
        log.warning("a part of the history cannot be read: %s", error)
    except KeyError:  # the segment was removed
        pass
    return messages


_CHUNK = 1024 * 1024
_DATA = frozenset({".bag", ".db3", ".mcap"})
_log = logging.getLogger("rosld")


class FileDigests:
    """Digests of recordings. Belongs to the event loop."""

    def __init__(self) -> None:
        self.revision = 0
        """Number that changes when another digest becomes known."""
        self._digests: dict[Path, str | None] = {}
        self._changes = Signal()

    def peek(self, path: Path) -> str | None:
        """Return the hexadecimal digest of a recording's file, or None while it is unknown."""
        return self._digests.get(path)

    def get(self, path: Path) -> str | None:
        """Return the digest if it is known; the first call starts its computation. Always None for several files."""
        if path not in self._digests:
            self._digests[path] = None
            loop = asyncio.get_running_loop()
            # A daemon thread, so that shutdown does not wait for a large file.
            threading.Thread(target=self._compute, args=(path, loop), name="digest", daemon=True).start()
        return self._digests[path]

    def forget(self, path: Path) -> None:
        """Forget the digest of a deleted file, whose name may be reused."""
        self._digests.pop(path, None)

    def watch(self, path: Path, wake: Callable[[], None]) -> Watch:
        """Call `wake` once the digest of a recording is known."""
        return self._changes.watch(wake, lambda about: about == str(path))

    def _compute(self, path: Path, loop: asyncio.AbstractEventLoop) -> None:
        try:
            digest = _digest(path)
        except OSError as error:
            _log.warning("The checksum of %s cannot be computed: %s", path, error)
            return
        if digest is not None:
            with contextlib.suppress(RuntimeError):  # the event loop is closed
                loop.call_soon_threadsafe(self._store, path, digest)

    def _store(self, path: Path, digest: str) -> None:
        self._digests[path] = digest
        self.revision += 1
        self._changes.emit(str(path))


def _digest(path: Path) -> str | None:
    """Return the digest of the only data file, or None if there are several. Raises OSError."""
    files = [path] if path.is_file() else [each for each in path.iterdir() if each.suffix in _DATA]
    if len(files) != 1:
        return None
    digest = hashlib.sha256()
    with files[0].open("rb") as file:
        while chunk := file.read(_CHUNK):
            digest.update(chunk)
    return digest.hexdigest()


log = logging.getLogger("rosld.history")
NAME = "history"
FOLDER = "history"
_FOR_EVER = 1 << 62
_DISK_SIZE = 1024 * 1024 * 1024
_MEMORY_SIZE = 128 * 1024 * 1024
_MEMORY_SEGMENTS = 8
"""Number of segments in memory: only whole segments are removed."""
_Libraries: TypeAlias = "dict[Encoding, TypeLibrary]"


def history_limits(settings: Settings) -> HistoryLimits:
    """Return the limits of the history. A `history_size` of 0 means the default."""
    if settings.data is not None:
        return HistoryLimits(settings.history_time, settings.history_size or _DISK_SIZE)
    size = settings.history_size or _MEMORY_SIZE
    return HistoryLimits(settings.history_time, size, segment_size=max(size // _MEMORY_SEGMENTS, 1))


class HistoryRecording:
    """The history as a `Recording`: its messages are numbered from its start, and the oldest are removed."""

    name = NAME
    format = "MCAP"

    def __init__(
        self,
        writer: HistoryWriter,
        folders: Sequence[Path],
        silent: Callable[[Collection[str]], Sequence[str]] = lambda _: (),
        encoding: Encoding = Encoding.CDR,
    ) -> None:
        """`silent` returns the recorded topics and globs that have no message yet."""
        self.path = writer.segments.folder or Path()  # a folder, because there is no file to send
        self._writer = writer
        self._folders = folders
        self._silent = silent
        self.encoding = encoding
        self._libraries: _Libraries = {}

    @property
    def first(self) -> int:
        """Number of the oldest message."""
        return self._writer.first

    @property
    def count(self) -> int:
        """Number of messages since the first."""
        return self._writer.next - self._writer.first

    @property
    def start_ns(self) -> int:
        """Time of receipt of the oldest message, in ns."""
        return self._writer.start_ns

    @property
    def end_ns(self) -> int:
        """Time of receipt of the newest message, in ns."""
        return self._writer.end_ns

    @property
    def topics(self) -> Mapping[str, RecordedTopic]:
        """Topics with stored messages."""
        types = self._writer.types
        return {
            topic: RecordedTopic(topic, types[topic], count)
            for topic, count in list(self._writer.counts.items())
            if count > 0
        }

    @property
    def silent(self) -> Sequence[str]:
        """Recorded topics and globs without a stored message."""
        return self._silent(self.topics)

    def message(self, index: int) -> RecordedMessage:
        """Return a message by number. Raises NotFound, and Unreachable if it cannot be read."""
        try:
            found = self._writer.message(index)
        except (OSError, ValueError) as error:
            raise Unreachable(f"message {index} of the history cannot be read: {error}") from error
        except KeyError:  # its segment was removed in the meantime
            found = None
        if found is None:
            raise NotFound(f"the history no longer has message {index}")
        channel, sample = found
        return RecordedMessage(index, channel.topic, sample)

    def topic_of(self, index: int) -> str | None:
        """Return the topic of a message by number, or None."""
        return self._writer.topic_of(index)

    def messages(self) -> Iterator[RecordedMessage]:
        """Yield all messages in the order of their numbers, without unreadable ones."""
        for index in range(self._writer.first, self._writer.next):
            try:
                yield self.message(index)
            except (NotFound, Unreachable):
                continue

    @property
    def settled(self) -> int:
        """Number below which all messages are written."""
        return self._writer.settled

    @property
    def identity(self) -> str:
        """Identity of the index; a rebuilt index has another one."""
        return f"{self._writer.segments.index.identity:08x}"

    @property
    def content(self) -> None:
        """None, because it grows."""

    def times_between(self, start: int, end: int) -> tuple[int, int] | None:
        """Return the range of times of the messages numbered `start` to `end` - 1, all of which are written."""
        return self._writer.segments.index.times_between(start, end)

    def latest_at(self, topic: str, time_ns: int) -> RecordedMessage | None:
        """Return the latest message of a topic at a time, or None. Raises Unreachable."""
        try:
            sample = self._writer.latest_at(topic, time_ns)
        except (OSError, ValueError, KeyError) as error:
            raise Unreachable(f"the history of {topic} cannot be read: {error}") from error
        return None if sample is None else RecordedMessage(sample.sequence - 1, topic, sample)

    def density(self, parts: int) -> Mapping[str, Sequence[int]]:
        """Return nothing: it changes all the time."""
        return {}

    def latched_before(self, time_ns: int, selects: Callable[[str], bool]) -> Iterable[tuple[str, Sample]]:
        """Return the latched messages that are in force at a time, with their topics. Raises Unreachable."""
        try:
            return self._writer.latched_at(time_ns, selects)
        except (OSError, ValueError, KeyError) as error:
            raise Unreachable(f"the history cannot be read: {error}") from error

    def select(self, criteria: MessageFilter, limit: int) -> MessagePage:
        """Return at most `limit` messages; reads only the chunks that the index selects."""
        return select_messages(self._writer, criteria, limit)

    def blocks_between(self, topic: str, from_ns: int, until_ns: int) -> Iterator[MessageBlock]:
        """Yield the messages of a topic between two times, in any order and without unreadable ones."""
        rows, unwritten = self.chunks_between(topic, from_ns, until_ns)
        for row in rows:
            block = self.block(row, from_ns, until_ns)
            if block is not None:
                yield block
        yield unwritten

    def chunks_between(self, topic: str, from_ns: int, until_ns: int) -> tuple[Sequence[ChunkRow], MessageBlock]:
        """Return the chunks with messages of a topic between two times, and the messages that are in none yet."""
        at_hand = {each.sequence - 1: each for each in self._writer.unwritten(topic)}
        rows = self._writer.segments.index.of_topic(topic, from_ns, until_ns)
        for row in rows:
            if at_hand and row.last >= min(at_hand):  # written in the meantime
                for number in unpack_numbers(row).tolist():
                    at_hand.pop(number, None)
        left = [RecordedMessage(number, topic, each) for number, each in at_hand.items()]
        return rows, MessageBlock.of([each for each in left if from_ns <= each.sample.received_ns <= until_ns])

    def block(self, row: ChunkRow, from_ns: int, until_ns: int) -> MessageBlock | None:
        """Return the messages of a chunk between two times, or None if it is damaged or was removed."""
        try:
            return MessageBlock(self._writer.segments, row, from_ns, until_ns)
        except (OSError, ValueError, KeyError):
            return None

    @property
    def index(self) -> ChunkIndex:
        """The index of its chunks."""
        return self._writer.segments.index

    def count_between(self, topic: str, from_ns: int, until_ns: int) -> int:
        """Return an upper bound of the number of messages of a topic between two times, without reading them."""
        rows = self._writer.segments.index.of_topic(topic, from_ns, until_ns)
        return sum(row.messages for row in rows)

    def spans_at_end(
        self, topic: str, from_ns: int, until_ns: int, limit: int, *, is_newest: bool
    ) -> list[tuple[int, int, int]]:
        """Return start, end and count of the newest or oldest `limit` chunks of a topic, and of unwritten messages."""
        spans = self._writer.segments.index.spans_at_end(topic, from_ns, until_ns, limit, is_newest=is_newest)
        times = [each.received_ns for each in self._writer.unwritten(topic)]
        times = [each for each in times if from_ns <= each <= until_ns]
        return [*spans, (min(times), max(times), len(times))] if times else spans

    def types_of(self, topic: str) -> frozenset[TypeRef]:
        """Return all types that messages of a topic have had."""
        return self._writer.segments.index.types_of(topic) | {each.schema for each in self._writer.unwritten(topic)}

    def schema(self, ref: TypeRef) -> Schema:
        """Return the recorded schema of a type. Raises UnknownType."""
        text = self._writer.segments.index.definition(ref)
        is_ros1 = ref.hash is not None and not ref.hash.startswith("RIHS")
        library = self._library(Encoding.ROS1 if is_ros1 else Encoding.CDR)
        if text is None:
            return library.find(ref)
        try:
            return library.learn_message(ref.name, text, ref.hash if is_ros1 else None)
        except ValueError as error:
            raise UnknownType(str(error)) from error

    def _library(self, encoding: Encoding) -> TypeLibrary:
        library = self._libraries.get(encoding)
        if library is None:
            library = TypeLibrary(ros_version=1 if encoding is Encoding.ROS1 else 2, folders=self._folders)
            self._libraries[encoding] = library
        return library


class History:
    """Recorder of the topics selected by `--history`, as long as the server runs.

    `definition_of` returns the text of a type, if it is known.
    """

    def __init__(
        self, adapter: Adapter, live: LiveRecorder, settings: Settings, definition_of: Callable[[TypeRef], str]
    ) -> None:
        """Raise ValueError if the source has no live topics to record."""
        if settings.history and adapter.capabilities.system == "recording":
            raise ValueError(
                f"--history {settings.history[0]}: not possible when serving a recording, whose messages "
                "are already stored"
            )
        folder = None if settings.data is None else settings.data / FOLDER
        segments = Segments(folder, history_limits(settings), lambda: live.latched(self.writer))
        self.writer = HistoryWriter(segments, definition_of)
        self.recording = HistoryRecording(
            self.writer,
            settings.types,
            lambda recorded: live.silent(self.writer, settings.history, recorded),
            adapter.capabilities.encoding,
        )
        self.digests = FileDigests()
        """Digests of the recordings other than the history."""
        self.exports = BagExports(settings)
        self._globs = settings.history
        self._live = live
        self._failure: str | None = None

    @property
    def is_enabled(self) -> bool:
        """Whether the history is enabled and could be opened."""
        return bool(self._globs) and self._failure is None

    @property
    def problem(self) -> str | None:
        """Reason why nothing is recorded at the moment, as a sentence, or None."""
        return self._failure or self.writer.problem

    def will_record(self, topic: str) -> bool:
        """Whether the messages of a topic are recorded."""
        return any(fnmatchcase(topic, glob) for glob in self._globs)

    def dropped(self) -> Mapping[str, int]:
        """Return the numbers of lost messages by topic."""
        counts = self._live.dropped()
        counts.update(dict(self.writer.dropped))
        return counts

    async def start(self) -> None:
        """Open the history in a thread, and start recording; on failure the server runs without it."""
        if not self.is_enabled:
            return
        try:
            await asyncio.to_thread(self.writer.open)
        except (OSError, sqlite3.Error) as error:
            self._failure = f"The history is not recorded: {error}. Free some space, then restart rosld."
            log.error("%s", self._failure)
            return
        self._live.add(self.writer, self.will_record)

    def copy_to(self, sink: Sink, selects: Callable[[str], bool], since_ns: int) -> Collection[str]:
        """Copy the messages since a time to a sink, after those latched at that time; return their topics.

        Called on the recorder's thread.
        """
        copied: set[str] = set()
        if not self.is_enabled:
            return copied
        self.writer.write_all()
        segments = self.writer.segments
        with contextlib.suppress(OSError, ValueError, KeyError):  # a damaged or removed segment
            for topic, sample in self.writer.latched_at(since_ns, selects):
                sink.add(topic, sample)
                copied.add(topic)
        for topic in filter(selects, list(self.writer.types)):
            for row in segments.index.of_topic(topic, since_ns, _FOR_EVER):
                with contextlib.suppress(OSError, ValueError, KeyError):  # a damaged or removed segment
                    for channel, sample in segments.messages_of(row):
                        if sample.received_ns >= since_ns:
                            sink.add(channel.topic, sample)
                            copied.add(topic)
        return copied

    def close(self) -> None:
        """Close the files, after recording has ended."""
        if self.is_enabled:
            self.writer.segments.close()
