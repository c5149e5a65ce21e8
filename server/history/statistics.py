"""Statistics of the numbers in recordings: minimum, maximum and sum of each field in blocks of consecutive messages.

They are read once (`rosld index`, or by a server that has nothing else to do) and kept in SQLite. They can be made
again, so they are never synced.
"""

from __future__ import annotations

import os
import sqlite3
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from rosld.adapters.base import AdapterOptions, MessageFilter, RecordedMessage, Recording
from rosld.adapters.model import MessageSchema, RosError, TypeRef
from rosld.ontology.fields import field_at
from rosld.server.history.history import HistoryRecording
from rosld.server.history.message_block import MessageBlock, columns_of, number_paths
from rosld.server.history.uploads import opened_recording

_OPEN_SECONDS = 60.0
BLOCK = 1000
"""Maximum number of messages in a block."""
_EXACT = 2.0**53
"""Sums of integers below this are exact as doubles."""
_TABLE = """
CREATE TABLE IF NOT EXISTS topic_statistic (
    content TEXT, topic TEXT, type TEXT, field TEXT, count INTEGER, minimum, maximum, total REAL, blocks BLOB,
    PRIMARY KEY (topic, field, content, type)) WITHOUT ROWID;
"""
SchemaOf: TypeAlias = Callable[[TypeRef], "MessageSchema | None"]


class Total(NamedTuple):
    """Messages of a topic, and the minimum, maximum and sum of a field in them; `total` is NaN if it is not known.

    Then a number is NaN, or integers are too large.
    """

    messages: int
    minimum: float
    maximum: float
    total: float

    def join(self, other: Total) -> Total:
        """Return the total of both."""
        return Total(
            self.messages + other.messages,
            min(self.minimum, other.minimum),
            max(self.maximum, other.maximum),
            self.total + other.total,
        )


class TopicStatistics(NamedTuple):
    """Readable messages of one type on a topic, in blocks of consecutive messages.

    A block has a row in `blocks` (first and last index, first and last time in ns, number of messages), and one in the
    array of each field in `fields`: minimum, maximum and sum. NaNs do not count; with one the sum is NaN.
    """

    blocks: NDArray[np.int64]
    fields: Mapping[str, NDArray[np.float64]]

    def totals(self) -> dict[str, Total]:
        """Return the totals of all fields, and those of the times in ns as field ``""``."""
        count = int(self.blocks[:, 4].sum())
        times = Total(count, int(self.blocks[:, 2].min()), int(self.blocks[:, 3].max()), 0.0)
        return {"": times} | {
            name: Total(count, float(each[:, 0].min()), float(each[:, 1].max()), float(each[:, 2].sum()))
            for name, each in self.fields.items()
        }

    def rows(self, chosen: NDArray[np.bool_]) -> TopicStatistics:
        """Return only some of the blocks."""
        return TopicStatistics(self.blocks[chosen], {name: each[chosen] for name, each in self.fields.items()})


ByType: TypeAlias = Mapping[str, TopicStatistics]
"""Statistics of a topic by the type of its messages."""


def pages(recording: Recording, criteria: MessageFilter, limit: int) -> Iterator[Sequence[RecordedMessage]]:
    """Yield the messages of a recording that match a filter, at most `limit` at a time."""
    start: int | None = max(criteria.start, recording.first)
    while start is not None:
        page = recording.select(replace(criteria, start=start), limit)
        yield page.messages
        start = page.next


def statistics_of(recording: Recording, topic: str, schema_of: SchemaOf, step: Callable[[int], object]) -> ByType:
    """Return the statistics of a topic; `step` is called with the number of messages of each page before it is used."""
    found: dict[str, list[TopicStatistics]] = {}
    for messages in pages(recording, MessageFilter(frozenset({topic})), BLOCK):
        step(len(messages))
        for type, each in measure(MessageBlock.grouped(messages), schema_of).items():
            found.setdefault(type, []).append(each)
    return {type: _concatenate(each) for type, each in found.items()}


def _concatenate(parts: Sequence[TopicStatistics]) -> TopicStatistics:
    names = parts[0].fields
    fields = {name: np.concatenate([each.fields[name] for each in parts if name in each.fields]) for name in names}
    blocks = np.concatenate([each.blocks for each in parts])
    return TopicStatistics(blocks, {name: each for name, each in fields.items() if len(each) == len(blocks)})


def measure(blocks: Iterable[MessageBlock], schema_of: SchemaOf) -> ByType:
    """Return the statistics of messages as one block of each type, without unreadable messages."""
    parts: dict[str, list[_Columns]] = {}
    for block in blocks:
        for type, columns in _read(block, schema_of):
            parts.setdefault(type, []).append(columns)
    found = {}
    for type, members in parts.items():
        indexes, times = ([one for each in members for one in each[place]] for place in (0, 1))
        row = np.array([[min(indexes), max(indexes), min(times), max(times), len(times)]], np.int64)
        fields = {
            ".".join(path): np.array([_reduce([each[2][path] for each in members])])
            for path in members[0][2]
            if all(path in each[2] for each in members)
        }
        found[type] = TopicStatistics(row, fields)
    return found


_Columns: TypeAlias = "tuple[Sequence[int], Sequence[int], Mapping[tuple[str, ...], NDArray[Any]]]"
"""Indexes, times in ns, and columns of numbers by path."""


def _read(block: MessageBlock, schema_of: SchemaOf) -> Iterator[tuple[str, _Columns]]:
    if block.rows is not None and not len(block.rows.times):
        return
    if block.rows is not None:
        schema = schema_of(block.channel.type)
        if schema is None:
            return
        paths = [*number_paths(schema)]
        columns = columns_of(block.rows, schema, block.channel.encoding, paths)
        if columns is not None:
            found = dict(zip(paths, columns, strict=True))
            yield schema.ref.name, (block.numbers(), block.rows.times.tolist(), found)
            return
    for each in block.messages():
        schema = schema_of(each.sample.schema)
        if schema is None:
            continue
        try:
            decoded = schema.codec.decode(each.sample.data, each.sample.encoding)
        except ValueError:
            continue
        found = {path: np.array([field_at(schema, decoded, ".".join(path))[1]]) for path in number_paths(schema)}
        yield schema.ref.name, ([each.index], [each.sample.received_ns], found)


def _reduce(columns: Sequence[NDArray[Any]]) -> tuple[float, float, float]:
    column = np.concatenate(columns)
    if column.dtype.kind in "iu":
        least, most = float(column.min()), float(column.max())
        is_exact = max(abs(least), abs(most)) * len(column) < _EXACT
        return least, most, float(column.sum(dtype=np.float64)) if is_exact else np.nan
    numbers = column.astype(np.float64)
    is_number = ~np.isnan(numbers)
    if is_number.all():
        with np.errstate(invalid="ignore"):
            return float(numbers.min()), float(numbers.max()), float(numbers.sum())
    numbers = numbers[is_number]
    return float(numbers.min(initial=np.inf)), float(numbers.max(initial=-np.inf)), np.nan


def measure_between(
    recording: Recording,
    topic: str,
    span: tuple[int, int],
    known: ByType,
    schema_of: SchemaOf,
    step: Callable[[int], object],
) -> Iterator[tuple[str, Mapping[str, Total]]]:
    """Yield the totals of a topic's messages between two times in ns by type; blocks at the edges are read."""
    for type, each in known.items():
        is_inside = (each.blocks[:, 2] >= span[0]) & (each.blocks[:, 3] <= span[1])
        is_edge = (each.blocks[:, 3] >= span[0]) & (each.blocks[:, 2] <= span[1]) & ~is_inside
        found = dict(each.rows(is_inside).totals()) if is_inside.any() else {}
        for first, last in each.blocks[is_edge, :2].tolist():
            for messages in pages(recording, MessageFilter(frozenset({topic}), *span, first, last + 1), BLOCK):
                step(len(messages))
                measured = measure(MessageBlock.grouped(messages), schema_of).get(type)
                _add(found, {} if measured is None else measured.totals())
        yield type, found


def index_file(path: Path, options: AdapterOptions, topics: Sequence[str]) -> dict[str, ByType]:
    """Return the statistics of topics of a recording: work for another process, which yields to others from then on.

    Raises RosError.
    """
    with suppress(OSError):
        os.nice(19 - os.nice(0))
    with opened_recording(path, options, _OPEN_SECONDS) as recording:
        schema_of = partial(schema_in, recording)
        return {topic: statistics_of(recording, topic, schema_of, lambda _: None) for topic in topics}


def schema_in(recording: Recording, ref: TypeRef) -> MessageSchema | None:
    """Return the schema of a type of messages, None if it is not known."""
    with suppress(RosError):
        found = recording.schema(ref)
        return found if isinstance(found, MessageSchema) else None
    return None


def history_total(
    recording: HistoryRecording,
    topic: str,
    fields: Sequence[str],
    span: tuple[int, int],
    schema_of: SchemaOf,
    step: Callable[[int], object],
) -> Mapping[str, Total] | None:
    """Return the totals of fields and times (``""``) of a topic between two times in ns, None if they are not known.

    The statistics of whole chunks are kept in the index of the history.
    """
    found: dict[str, Total] = {}
    known = {field: recording.index.statistics(topic, field, *span) for field in fields}
    rows, unwritten = recording.chunks_between(topic, *span)
    for row in rows:
        is_whole = span[0] <= row.start_ns and row.end_ns <= span[1]
        entries = {field: known[field].get((row.segment, row.at)) for field in fields}
        totals = {"": Total(row.messages, row.start_ns, row.end_ns, 0.0)}
        if is_whole and fields and None not in entries.values():
            for field, each in entries.items():
                if each is None or each[3] != row.messages:
                    return None  # some messages have no finite number
                totals[field] = Total(row.messages, each[0], each[1], each[2])
        else:
            block = recording.block(row, *span)
            step(row.messages)
            measured = measure([] if block is None else [block], schema_of)
            totals = _single(measured)
            for field in fields if is_whole and totals else ():
                if np.isfinite(totals[field].total) and totals[field].messages == row.messages:
                    _, *numbers, total = totals[field]
                    recording.index.keep_statistic(row, field, (numbers[0], numbers[1], total, row.messages))
        _add(found, totals)
    _add(found, _single(measure([unwritten], schema_of)))
    return found


def _single(measured: ByType) -> dict[str, Total]:
    return next(iter(measured.values())).totals() if measured else {}


def _add(found: dict[str, Total], totals: Mapping[str, Total]) -> None:
    for field, each in totals.items():
        found[field] = found[field].join(each) if field in found else each


class Statistics:
    """Store of statistics by recording (its `content`), topic, field and type. Any thread may use it."""

    def __init__(self, path: Path | None) -> None:
        """Open or create the table in a database; in memory if the path is None. Raises sqlite3.Error."""
        self._lock = threading.Lock()
        self._db = sqlite3.connect(path or ":memory:", check_same_thread=False, isolation_level=None, timeout=30)
        self._db.execute("PRAGMA journal_mode = WAL")
        self._db.execute("PRAGMA synchronous = OFF")
        self._db.executescript(_TABLE)

    def keep(self, key: str, topic: str, found: ByType) -> None:
        """Store the statistics of a topic of a recording, even if it has no readable messages."""
        rows: list[tuple[object, ...]] = [] if found else [(key, topic, "", "", 0, None, None, 0.0, b"")]
        for type, each in found.items():
            for field, (count, least, most, total) in each.totals().items():
                blocks = (each.fields[field] if field else each.blocks).tobytes()
                rows.append((key, topic, type, field, count, least, most, total, blocks))
        with self._lock, self._db:
            self._db.execute("BEGIN IMMEDIATE")
            self._db.executemany("INSERT OR REPLACE INTO topic_statistic VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)", rows)

    def find(self, key: str, topic: str, fields: Iterable[str] = ()) -> ByType | None:
        """Return the statistics of fields of a topic, None if they are not known."""
        wanted = ("", *fields)
        with self._lock:
            rows = self._db.execute(
                f"SELECT type, field, blocks FROM topic_statistic WHERE topic = ? AND content = ? "
                f"AND field IN ({_marks(wanted)})",
                (topic, key, *wanted),
            ).fetchall()
        if not rows:
            return None
        spans = {type: np.frombuffer(blocks, np.int64).reshape(-1, 5) for type, field, blocks in rows if not field}
        arrays = {
            (type, field): np.frombuffer(blocks, np.float64).reshape(-1, 3) for type, field, blocks in rows if field
        }
        return {
            type: TopicStatistics(each, {field: array for (of, field), array in arrays.items() if of == type})
            for type, each in spans.items()
            if type
        }

    def missing(self, key: str, topics: Iterable[str]) -> list[str]:
        """Return the topics of a recording whose statistics are not known."""
        query = "SELECT 1 FROM topic_statistic WHERE topic = ? AND field = '' AND content = ? LIMIT 1"
        with self._lock:
            return [topic for topic in topics if self._db.execute(query, (topic, key)).fetchone() is None]

    def totals(self, topic: str, fields: Iterable[str]) -> dict[str, dict[str, dict[str, Total]]]:
        """Return the totals of fields and times of a topic, by recording, type and field."""
        wanted = ("", *fields)
        with self._lock:
            rows = self._db.execute(
                "SELECT content, type, field, count, minimum, maximum, total "
                f"FROM topic_statistic WHERE topic = ? AND field IN ({_marks(wanted)})",
                (topic, *wanted),
            ).fetchall()
        found: dict[str, dict[str, dict[str, Total]]] = {}
        for key, type, field, count, least, most, total in rows:
            of_recording = found.setdefault(key, {})
            if type:
                of_field = Total(count, least, most, np.nan if total is None else total)
                of_recording.setdefault(type, {})[field] = of_field
        return found

    def close(self) -> None:
        """Close the database. Idempotent."""
        with self._lock:
            self._db.close()


def _marks(values: Sequence[object]) -> str:
    return ", ".join("?" * len(values))
