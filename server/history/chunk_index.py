"""Index of a history: the messages of each chunk of each segment (SQLite).

The index can be rebuilt from the segments, so it is never synced, and deleted if it is damaged.
"""

from __future__ import annotations

import secrets
import sqlite3
import threading
import zlib
from array import array
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from rosld.adapters.model import Encoding, TypeRef
from rosld.server.history.channel import Channel

_VERSION = 1
_TABLES = """
CREATE TABLE IF NOT EXISTS segment (
    id INTEGER PRIMARY KEY, name TEXT UNIQUE, first INTEGER, next INTEGER, start_ns INTEGER, end_ns INTEGER,
    size INTEGER, finished INTEGER);
CREATE TABLE IF NOT EXISTS channel (
    segment INTEGER, number INTEGER, topic TEXT, type TEXT, hash TEXT, encoding TEXT, publisher TEXT, latched INTEGER,
    PRIMARY KEY (segment, number)) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS chunk (
    segment INTEGER, at INTEGER, length INTEGER, topic TEXT, count INTEGER, first INTEGER, last INTEGER,
    start_ns INTEGER, end_ns INTEGER, numbers BLOB, PRIMARY KEY (segment, at)) WITHOUT ROWID;
CREATE INDEX IF NOT EXISTS chunk_topic ON chunk (topic, end_ns);
CREATE INDEX IF NOT EXISTS chunk_last ON chunk (last);
CREATE TABLE IF NOT EXISTS statistic (
    segment INTEGER, at INTEGER, field TEXT, minimum REAL, maximum REAL, total REAL, count INTEGER,
    PRIMARY KEY (segment, at, field)) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS definition (type TEXT, hash TEXT, text TEXT, PRIMARY KEY (type, hash)) WITHOUT ROWID;
"""


class SegmentRow(NamedTuple):
    """A segment: messages `first` to `next` - 1, in a file of `size` bytes."""

    id: int
    name: str
    first: int
    next: int
    start_ns: int
    end_ns: int
    size: int
    finished: bool


class ChunkRow(NamedTuple):
    """A chunk: its place, its channel's messages, their times (ns) and numbers, ascending."""

    segment: int
    at: int
    length: int
    topic: str
    messages: int
    first: int
    last: int
    start_ns: int
    end_ns: int
    numbers: bytes


class ChunkIndex:
    """The index of chunks. Any thread may read; one thread writes. `identity` identifies its numbering."""

    def __init__(self, path: Path | None) -> None:
        """Open or create the database; in memory if the path is None. Raises sqlite3.Error."""
        self._lock = threading.Lock()
        self._db = sqlite3.connect(path or ":memory:", check_same_thread=False, isolation_level=None)
        self._db.execute("PRAGMA journal_mode = WAL")
        self._db.execute("PRAGMA synchronous = OFF")
        (found,) = self._db.execute("PRAGMA user_version").fetchone()
        if found not in (0, _VERSION):
            self._db.close()
            raise sqlite3.DatabaseError(f"the index has version {found}, expected {_VERSION}")
        (self.identity,) = self._db.execute("PRAGMA application_id").fetchone()
        if not self.identity:
            self.identity = secrets.randbits(31) or 1
            self._db.execute(f"PRAGMA application_id = {self.identity}")
        self._db.executescript(_TABLES)
        self._db.execute(f"PRAGMA user_version = {_VERSION}")

    def add_segment(self, name: str, first: int) -> int:
        """Add a new segment; return its id."""
        with self._lock:
            row = self._db.execute(
                "INSERT INTO segment (name, first, next, size, finished) VALUES (?, ?, ?, 0, 0)", (name, first, first)
            )
            assert row.lastrowid is not None
            return row.lastrowid

    def add_chunks(self, segment: int, chunks: Sequence[ChunkRow], channels: Mapping[Channel, int], size: int) -> None:
        """Add chunks written to a segment, which is now `size` bytes long, and its new channels."""
        if not chunks:
            return
        with self._lock, self._db:
            self._db.execute("BEGIN")
            self._db.executemany(
                "INSERT OR IGNORE INTO channel VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
                [(segment, number, *_columns(one)) for one, number in channels.items()],
            )
            self._db.executemany("INSERT OR REPLACE INTO chunk VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)", chunks)
            self._db.execute(
                "UPDATE segment SET next = max(next, ?), size = ?, start_ns = min(coalesce(start_ns, ?), ?), "
                "end_ns = max(coalesce(end_ns, 0), ?) WHERE id = ?",
                (
                    max(one.last for one in chunks) + 1,
                    size,
                    *(2 * (min(one.start_ns for one in chunks),)),
                    max(one.end_ns for one in chunks),
                    segment,
                ),
            )

    def finish_segment(self, segment: int, size: int) -> None:
        """Mark a segment as complete."""
        with self._lock:
            self._db.execute("UPDATE segment SET size = ?, finished = 1 WHERE id = ?", (size, segment))

    def remove_segment(self, segment: int) -> None:
        """Remove a segment and its chunks."""
        with self._lock, self._db:
            self._db.execute("BEGIN")
            self._db.execute("DELETE FROM chunk WHERE segment = ?", (segment,))
            self._db.execute("DELETE FROM channel WHERE segment = ?", (segment,))
            self._db.execute("DELETE FROM statistic WHERE segment = ?", (segment,))
            self._db.execute("DELETE FROM segment WHERE id = ?", (segment,))

    def segments(self) -> list[SegmentRow]:
        """Return all segments, oldest first."""
        with self._lock:
            rows = self._db.execute(
                "SELECT id, name, first, next, coalesce(start_ns, 0), coalesce(end_ns, 0), size, finished "
                "FROM segment ORDER BY first, id"
            ).fetchall()
        return [SegmentRow._make((*row[:7], bool(row[7]))) for row in rows]

    def channels(self, segment: int) -> dict[int, Channel]:
        """Return the channels of a segment by number."""
        with self._lock:
            rows = self._db.execute(
                "SELECT number, topic, type, hash, encoding, publisher, latched FROM channel WHERE segment = ?",
                (segment,),
            ).fetchall()
        return {
            number: Channel(topic, TypeRef(type, hash), Encoding(encoding), publisher, bool(latched))
            for number, topic, type, hash, encoding, publisher, latched in rows
        }

    def find(self, number: int) -> ChunkRow | None:
        """Return the chunk that holds message `number`."""
        with self._lock:
            rows = self._db.execute(
                "SELECT * FROM chunk WHERE last >= ? AND first <= ? AND segment = "
                "(SELECT id FROM segment WHERE first <= ? ORDER BY first DESC LIMIT 1)",
                (number, number, number),
            ).fetchall()
        for row in map(ChunkRow._make, rows):
            numbers = unpack_numbers(row)
            at = int(np.searchsorted(numbers, number))
            if at < len(numbers) and int(numbers[at]) == number:
                return row
        return None

    def of_topic(self, topic: str, from_ns: int, until_ns: int) -> list[ChunkRow]:
        """Return the chunks of a topic with messages between two times (inclusive), in order."""
        with self._lock:
            rows = self._db.execute(
                "SELECT * FROM chunk WHERE topic = ? AND end_ns >= ? AND start_ns <= ? ORDER BY first",
                (topic, from_ns, until_ns),
            ).fetchall()
        return list(map(ChunkRow._make, rows))

    def of_numbers(
        self, segment: int, topic: str | None, start: int, from_ns: int, to_ns: int, after: int, limit: int
    ) -> list[ChunkRow]:
        """Return chunks of a segment by topic (None: all) and time, with messages numbered `start` or above.

        At most `limit` chunks, in the order of their first messages, whose numbers are above `after`.
        """
        topical = "" if topic is None else "AND topic = ?"
        bound = (segment, start, from_ns, to_ns, after, *(() if topic is None else (topic,)), limit)
        with self._lock:
            rows = self._db.execute(
                "SELECT * FROM chunk WHERE segment = ? AND last >= ? AND end_ns >= ? AND start_ns <= ? AND first > ? "
                f"{topical} ORDER BY first LIMIT ?",
                bound,
            ).fetchall()
        return list(map(ChunkRow._make, rows))

    def times_between(self, first: int, beyond: int) -> tuple[int, int] | None:
        """Return the range of times (ns) of messages `first` to `beyond` - 1, or None if there are none.

        The range may be wider than necessary: it is that of whole chunks.
        """
        with self._lock:
            row = self._db.execute(
                "SELECT min(start_ns), max(end_ns) FROM chunk WHERE last >= ? AND first < ?", (first, beyond)
            ).fetchone()
        return None if row[0] is None else (int(row[0]), int(row[1]))

    def newest(self, topic: str, until_ns: int, limit: int) -> list[ChunkRow]:
        """Return the chunks of a topic that begin at or before a time, newest first."""
        with self._lock:
            query = "SELECT * FROM chunk WHERE topic = ? AND start_ns <= ? ORDER BY end_ns DESC LIMIT ?"
            return list(map(ChunkRow._make, self._db.execute(query, (topic, until_ns, limit)).fetchall()))

    def spans_at_end(
        self, topic: str, from_ns: int, until_ns: int, limit: int, *, is_newest: bool
    ) -> list[tuple[int, int, int]]:
        """Return start, end and count of the newest or oldest `limit` chunks of a topic between two times."""
        order = "DESC" if is_newest else "ASC"
        with self._lock:
            return self._db.execute(
                "SELECT start_ns, end_ns, count FROM chunk WHERE topic = ? AND end_ns >= ? AND start_ns <= ? "
                f"ORDER BY end_ns {order} LIMIT ?",
                (topic, from_ns, until_ns, limit),
            ).fetchall()

    def statistics(
        self, topic: str, field: str, from_ns: int, until_ns: int
    ) -> dict[tuple[int, int], tuple[float, float, float, int]]:
        """Return minimum, maximum, sum and count of a field in a topic's chunks, by segment and offset."""
        with self._lock:
            rows = self._db.execute(
                "SELECT s.segment, s.at, s.minimum, s.maximum, s.total, s.count FROM chunk c JOIN statistic s "
                "ON s.segment = c.segment AND s.at = c.at AND s.field = ? "
                "WHERE c.topic = ? AND c.end_ns >= ? AND c.start_ns <= ?",
                (field, topic, from_ns, until_ns),
            ).fetchall()
        return {(row[0], row[1]): row[2:] for row in rows}

    def keep_statistic(self, chunk: ChunkRow, field: str, statistic: tuple[float, float, float, int]) -> None:
        """Store the statistic of a field in a chunk."""
        with self._lock:
            self._db.execute(
                "INSERT OR IGNORE INTO statistic VALUES (?, ?, ?, ?, ?, ?, ?)",
                (chunk.segment, chunk.at, field, *statistic),
            )

    def counts(self) -> dict[str, tuple[int, TypeRef]]:
        """Return the number of messages and a type of each topic."""
        with self._lock:
            counts = self._db.execute("SELECT topic, sum(count) FROM chunk GROUP BY topic").fetchall()
            types = self._db.execute("SELECT DISTINCT topic, type, hash FROM channel").fetchall()
        typed = {topic: TypeRef(type, hash) for topic, type, hash in types}
        return {topic: (count, typed[topic]) for topic, count in counts}

    def types_of(self, topic: str) -> frozenset[TypeRef]:
        """Return the types of the messages of a topic."""
        with self._lock:
            rows = self._db.execute("SELECT DISTINCT type, hash FROM channel WHERE topic = ?", (topic,)).fetchall()
        return frozenset(TypeRef(type, hash) for type, hash in rows)

    def counts_of_segment(self, segment: int) -> dict[str, int]:
        """Return the number of messages of each topic in one segment."""
        with self._lock:
            query = "SELECT topic, sum(count) FROM chunk WHERE segment = ? GROUP BY topic"
            return dict(self._db.execute(query, (segment,)).fetchall())

    def define(self, definitions: Iterable[tuple[TypeRef, str]]) -> None:
        """Store the definitions of types."""
        with self._lock:
            self._db.executemany(
                "INSERT OR IGNORE INTO definition VALUES (?, ?, ?)",
                [(ref.name, ref.hash or "", text) for ref, text in definitions],
            )

    def definition(self, ref: TypeRef) -> str | None:
        """Return the definition of a type, or None."""
        with self._lock:
            row = self._db.execute(
                "SELECT text FROM definition WHERE type = ? AND (hash = ? OR ? IS NULL)",
                (ref.name, ref.hash or "", ref.hash),
            ).fetchone()
        return None if row is None else str(row[0])

    def close(self) -> None:
        """Close the database. Idempotent."""
        with self._lock:
            self._db.close()


def pack_numbers(numbers: array[int]) -> bytes:
    """Encode ascending numbers compactly, as differences."""
    steps = np.diff(np.frombuffer(numbers, np.uint64)).astype(np.uint32)
    return zlib.compress(steps.tobytes(), 1)


def unpack_numbers(row: ChunkRow) -> np.ndarray[tuple[int], np.dtype[np.uint64]]:
    """Return the numbers of a chunk's messages, ascending."""
    steps = np.frombuffer(zlib.decompress(row.numbers), np.uint32)
    numbers = np.empty(len(steps) + 1, np.uint64)
    numbers[0] = row.first
    numbers[1:] = steps
    return np.cumsum(numbers, dtype=np.uint64)


def _columns(channel: Channel) -> tuple[str, str, str | None, str, str, int]:
    return (
        channel.topic,
        channel.type.name,
        channel.type.hash,
        channel.encoding.value,
        channel.publisher,
        int(channel.latched),
    )
