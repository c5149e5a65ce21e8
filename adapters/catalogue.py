"""Catalogue of recordings: their summaries, tags, events and statistics in SQLite.

A recording is identified by its content, so it keeps its name, its tags and its events when its file is moved. Rows are
read when they are needed: the catalogue of any number of recordings takes no memory.
"""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import chain, count
from pathlib import Path
from typing import Any, Literal

from msgspec import Struct

from rosld.adapters.model import TypeRef
from rosld.adapters.model.recorded import Event as Event
from rosld.adapters.model.recorded import RecordedTopic

NAME = "catalogue.sqlite"
_VERSION = 1
_TABLES = """
CREATE TABLE IF NOT EXISTS recording (
    id INTEGER PRIMARY KEY, identity TEXT, name TEXT UNIQUE, path TEXT UNIQUE, format TEXT, ros INTEGER, size INTEGER,
    mtime_ns INTEGER, start_ns INTEGER, end_ns INTEGER, count INTEGER, silent TEXT, problem TEXT, missing INTEGER,
    own INTEGER, version INTEGER DEFAULT 0);
CREATE INDEX IF NOT EXISTS recording_identity ON recording (identity);
CREATE TABLE IF NOT EXISTS topic (
    recording INTEGER, name TEXT, type TEXT, hash TEXT, count INTEGER, unreadable TEXT,
    PRIMARY KEY (recording, name)) WITHOUT ROWID;
CREATE INDEX IF NOT EXISTS topic_name ON topic (name, type);
CREATE TABLE IF NOT EXISTS tag (recording INTEGER, name TEXT, PRIMARY KEY (recording, name)) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS event (recording INTEGER, name TEXT, start_ns INTEGER, end_ns INTEGER);
CREATE INDEX IF NOT EXISTS event_recording ON event (recording);
"""
_COLUMNS = (
    "id, identity, name, path, format, ros, size, mtime_ns, start_ns, end_ns, count, silent, problem, missing, own, "
    "version"
)
_SEPARATOR = "\n"
_PRESENT, _VANISHED, _ELSEWHERE = 0, 1, 2
"""Values of `missing`: recordings elsewhere exist, but not in what is served now."""
_ANNOTATIONS = frozenset({"tag", "event"})


class CannotCatalogue(ValueError):
    """A catalogue that cannot be used; the message says what to do."""


class Entry(Struct, frozen=True):
    """A recording to catalogue. `problem`: why it cannot be read; `own`: it is the server's, not its source's."""

    identity: str
    path: Path
    size: int
    mtime_ns: int
    format: str = ""
    ros_version: Literal[1, 2] = 2
    start_ns: int = 0
    end_ns: int = 0
    count: int = 0
    silent: tuple[str, ...] = ()
    topics: tuple[RecordedTopic, ...] = ()
    problem: str | None = None
    own: bool = False


class Row(Struct, frozen=True):
    """A catalogued recording, without its topics, tags and events. `is_missing`: its file has vanished.

    `version` changes with each of these.
    """

    id: int
    identity: str
    name: str
    path: Path
    format: str
    ros_version: Literal[1, 2]
    size: int
    mtime_ns: int
    start_ns: int
    end_ns: int
    count: int
    silent: tuple[str, ...]
    problem: str | None
    is_missing: bool
    is_own: bool
    version: int = 0

    @property
    def is_readable(self) -> bool:
        return self.problem is None and not self.is_missing


class Selection(Struct, frozen=True):
    """Selection of recordings, all of whose conditions hold; None and () are no conditions.

    `topics` and `types` are names: one of them was recorded, a type on one of the topics. A recording lasts into
    `from_ns` to `to_ns`, and at least `min_ns`; each of `words` is in its name, a tag, an event, or a name of
    `searched` topics (None: of any).
    """

    topics: frozenset[str] | None = None
    types: frozenset[str] | None = None
    from_ns: int | None = None
    to_ns: int | None = None
    min_ns: int | None = None
    tags: tuple[str, ...] = ()
    words: tuple[str, ...] = ()
    searched: frozenset[str] | None = None

    @property
    def is_everything(self) -> bool:
        return self == Selection(searched=self.searched)

    def condition(self) -> tuple[str, list[object]]:
        """Return a condition on `recording`, and its parameters."""
        terms: list[str] = [f"missing <> {_ELSEWHERE}"]
        values: list[object] = []

        def add(term: str, *parameters: object) -> None:
            terms.append(term)
            values.extend(parameters)

        if self.topics is not None or self.types is not None:
            inner, given = _among("name", self.topics), [*(self.topics or ()), *(self.types or ())]
            inner += _among("type", self.types)
            add(f"EXISTS (SELECT 1 FROM topic WHERE recording = recording.id{inner})", *given)
        if self.from_ns is not None:
            add("count AND end_ns >= ?", self.from_ns)
        if self.to_ns is not None:
            add("count AND start_ns <= ?", self.to_ns)
        if self.min_ns is not None:
            add("end_ns - start_ns >= ?", self.min_ns)
        for tag in self.tags:
            add("EXISTS (SELECT 1 FROM tag WHERE recording = recording.id AND tag.name = ?)", tag)
        for word in self.words:
            like, among = f"%{_escaped(word)}%", _among("name", self.searched)
            add(
                "(recording.name LIKE ? ESCAPE '!'"
                " OR EXISTS (SELECT 1 FROM tag WHERE recording = recording.id AND tag.name LIKE ? ESCAPE '!')"
                " OR EXISTS (SELECT 1 FROM event WHERE recording = recording.id AND event.name LIKE ? ESCAPE '!')"
                f" OR EXISTS (SELECT 1 FROM topic WHERE recording = recording.id AND name LIKE ? ESCAPE '!'{among}))",
                *(like, like, like, like),
                *(self.searched or ()),
            )
        return " AND ".join(f"({term})" for term in terms), values


EVERYTHING = Selection()
SORTS: Mapping[str, str] = {
    "name": "recording.name",
    "start": "start_ns",
    "end": "end_ns",
    "duration": "end_ns - start_ns",
    "count": "count",
    "size": "size",
}
"""Expressions to sort recordings by; `-` before the key reverses the order."""


class Catalogue:
    """The recordings, in a database. Any thread may read and write."""

    def __init__(self, path: Path | None) -> None:
        """Open or create the database; a temporary one if the path is None, or not writable.

        Raises CannotCatalogue for a file that is no catalogue.
        """
        self.is_lasting = path is not None
        self.revision = 0
        """Number that changes with every write of this process."""
        self._lock = threading.RLock()
        try:
            self._db = _connect("" if path is None else str(path))
        except sqlite3.OperationalError:
            self.is_lasting = False
            self._db = _connect("")
        except sqlite3.DatabaseError as error:
            raise CannotCatalogue(f"{path} is no catalogue of recordings ({error}): delete it, or move it") from error

    @property
    def path(self) -> Path | None:
        """The path of the database, None for a temporary one."""
        [(_, _, path)] = self.read("PRAGMA database_list")
        return Path(path) if path else None

    @contextmanager
    def transaction(self) -> Iterator[sqlite3.Connection]:
        """Yield the database for changes, which are kept if the block succeeds."""
        with self._lock:
            self._db.execute("BEGIN IMMEDIATE")
            try:
                yield self._db
            except BaseException:
                self._db.execute("ROLLBACK")
                raise
            self._db.execute("COMMIT")
            self.revision += 1

    def read(self, sql: str, values: Iterable[object] = ()) -> list[tuple[Any, ...]]:
        """Return the rows of a query."""
        with self._lock:
            return self._db.execute(sql, tuple(values)).fetchall()

    def put(self, entries: Sequence[Entry], names: Mapping[Path, Sequence[str]]) -> None:
        """Add or update recordings in one transaction.

        A recording at a new path whose content has vanished elsewhere stays itself. A new one gets the first of the
        `names` of its path that is free, or the last with a number.
        """
        batch = {str(entry.path): entry.identity for entry in entries}
        with self.transaction() as db:
            for entry in entries:
                _put(db, entry, names.get(entry.path, (entry.path.stem,)), batch)

    def keep_only(self, paths: Collection[Path], *, own: bool = False) -> None:
        """Mark the recordings of the source, or the server's own, at other paths as missing.

        Those whose files exist elsewhere are not listed as long as these are not served.
        """
        known = {str(path) for path in paths}
        found = self.read("SELECT id, path, missing FROM recording WHERE own = ?", (int(own),))
        states = [(_state(path, known), each, missing) for each, path, missing in found]
        changed = [(state, each) for state, each, missing in states if state != missing]
        if changed:
            with self.transaction() as db:
                db.executemany("UPDATE recording SET missing = ?, version = version + 1 WHERE id = ?", changed)

    def leave_out_source(self) -> None:
        """List none of the recordings of the source, which are not served now."""
        with self.transaction() as db:
            db.execute(f"UPDATE recording SET missing = {_ELSEWHERE} WHERE NOT own")

    def forget(self, path: Path) -> None:
        """Remove the recording at a path with all that is known of it."""
        with self.transaction() as db:
            for (id,) in db.execute("SELECT id FROM recording WHERE path = ?", (str(path.absolute()),)).fetchall():
                for table in _tables_about_recordings(db):
                    db.execute(f"DELETE FROM {table} WHERE recording = ?", (id,))
                db.execute("DELETE FROM recording WHERE id = ?", (id,))

    def find(self, name: str) -> Row | None:
        """Return the recording of a name, or None."""
        return next(self._rows(f"SELECT {_COLUMNS} FROM recording WHERE name = ? AND missing <> 2", (name,)), None)

    def at(self, path: Path) -> Row | None:
        """Return the recording at a path, or None."""
        return next(self._rows(f"SELECT {_COLUMNS} FROM recording WHERE path = ?", (str(path.absolute()),)), None)

    def number_of(self, selection: Selection = EVERYTHING) -> int:
        """Return the number of selected recordings."""
        where, values = selection.condition()
        return int(self.read(f"SELECT count(*) FROM recording WHERE {where}", values)[0][0])

    def rows(
        self, selection: Selection = EVERYTHING, sort: str = "name", start: int = 0, limit: int = -1
    ) -> Iterator[Row]:
        """Return `limit` selected recordings from number `start` on, sorted by a key of SORTS."""
        where, values = selection.condition()
        order = SORTS[sort.removeprefix("-")] + (" DESC" if sort.startswith("-") else "")
        query = f"SELECT {_COLUMNS} FROM recording WHERE {where} ORDER BY {order}, name LIMIT ? OFFSET ?"
        return self._rows(query, (*values, limit, start))

    def names(self) -> list[str]:
        """Return the names of all recordings, those of damaged and missing ones included."""
        query = f"SELECT name FROM recording WHERE missing <> {_ELSEWHERE} ORDER BY name"
        return [name for (name,) in self.read(query)]

    def topic_names(self) -> list[str]:
        """Return the names of the topics of all recordings."""
        return [name for (name,) in self.read("SELECT DISTINCT name FROM topic ORDER BY name")]

    def readable_names(self) -> list[str]:
        """Return the names of the readable recordings of the source."""
        where = "problem IS NULL AND NOT missing AND NOT own"
        return [name for (name,) in self.read(f"SELECT name FROM recording WHERE {where} ORDER BY name")]

    def seen(self) -> dict[Path, tuple[int, int]]:
        """Return size and modification time of each present recording of the source."""
        found = self.read("SELECT path, size, mtime_ns FROM recording WHERE NOT own AND NOT missing")
        return {Path(path): (size, mtime) for path, size, mtime in found}

    def topics(self, id: int) -> tuple[RecordedTopic, ...]:
        """Return the topics of a recording, by name."""
        found = self.read(
            "SELECT name, type, hash, count, unreadable FROM topic WHERE recording = ? ORDER BY name", (id,)
        )
        return tuple(_topic(row) for row in found)

    def all_topics(self) -> list[tuple[RecordedTopic, int]]:
        """Return each topic and type in readable recordings of the source, and in how many of them it is."""
        found = self.read(
            "SELECT topic.name, type, hash, sum(topic.count), min(unreadable), count(*) FROM topic, recording "
            "WHERE recording = id AND problem IS NULL AND NOT missing AND NOT own "
            "GROUP BY topic.name, type, hash ORDER BY topic.name, count(*) DESC"
        )
        return [(_topic(row), row[5]) for row in found]

    def with_type(self, type: TypeRef) -> list[str]:
        """Return the names of at most three readable recordings of the source with messages of a type."""
        hashed = () if type.hash is None else (type.hash,)
        found = self.read(
            f"SELECT DISTINCT recording.name FROM topic, recording WHERE recording = id AND type = ?"
            f"{' AND hash = ?' if hashed else ''} AND unreadable IS NULL AND problem IS NULL AND NOT missing "
            "AND NOT own LIMIT 3",
            (type.name, *hashed),
        )
        return [name for (name,) in found]

    def tags(self, id: int) -> tuple[str, ...]:
        """Return the tags of a recording, sorted."""
        found = self.read("SELECT name FROM tag WHERE recording = ? ORDER BY name", (id,))
        return tuple(name for (name,) in found)

    def events(self, id: int) -> tuple[Event, ...]:
        """Return the events of a recording, by time."""
        found = self.read("SELECT name, start_ns, end_ns FROM event WHERE recording = ? ORDER BY start_ns, name", (id,))
        return tuple(Event(*row) for row in found)

    def annotate(self, id: int, tags: Iterable[str], events: Iterable[Event]) -> None:
        """Replace the tags and the events of a recording."""
        with self.transaction() as db:
            db.execute("DELETE FROM tag WHERE recording = ?", (id,))
            db.execute("DELETE FROM event WHERE recording = ?", (id,))
            db.executemany("INSERT INTO tag VALUES (?, ?)", [(id, tag) for tag in dict.fromkeys(tags)])
            db.executemany("INSERT INTO event VALUES (?, ?, ?, ?)", [(id, *event) for event in dict.fromkeys(events)])
            db.execute("UPDATE recording SET version = version + 1 WHERE id = ?", (id,))

    def close(self) -> None:
        """Close the database. Idempotent."""
        with self._lock:
            self._db.close()

    def _rows(self, sql: str, values: Iterable[object]) -> Iterator[Row]:
        for row in self.read(sql, values):
            yield _row(row)


def _connect(path: str) -> sqlite3.Connection:
    """Open the database at a path, or a temporary one for "". Raises sqlite3.Error."""
    db = sqlite3.connect(path, check_same_thread=False, isolation_level=None, timeout=10)
    try:
        db.execute("PRAGMA journal_mode = WAL")
        db.execute("PRAGMA synchronous = NORMAL")
        (found,) = db.execute("PRAGMA user_version").fetchone()
        if found not in (0, _VERSION):
            raise sqlite3.DatabaseError(f"its version is {found}, not {_VERSION}")
        db.executescript(_TABLES)
        db.execute(f"PRAGMA user_version = {_VERSION}")
    except BaseException:
        db.close()
        raise
    return db


def _put(db: sqlite3.Connection, entry: Entry, names: Sequence[str], batch: Mapping[str, str]) -> None:
    path = str(entry.path)
    id = _known(db, entry.identity, path, batch)
    if id is None:
        id = db.execute("INSERT INTO recording (name) VALUES (?)", (_free_name(db, names),)).lastrowid
    if entry.own:  # the server has named it
        db.execute("UPDATE recording SET name = name || '-' || id WHERE name = ? AND id <> ?", (names[0], id))
        db.execute("UPDATE recording SET name = ? WHERE id = ?", (names[0], id))
    if db.execute("SELECT 1 FROM recording WHERE id = ? AND identity <> ?", (id, entry.identity)).fetchone():
        for table in _tables_about_recordings(db) - _ANNOTATIONS:  # what was computed from the former content
            db.execute(f"DELETE FROM {table} WHERE recording = ?", (id,))
    db.execute("UPDATE recording SET path = NULL, missing = 1 WHERE path = ? AND id <> ?", (path, id))
    db.execute(
        "UPDATE recording SET (identity, path, format, ros, size, mtime_ns, start_ns, end_ns, count, silent, problem, "
        "missing, own, version) = (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, 0, ?, version + 1) WHERE id = ?",
        (
            *(entry.identity, path, entry.format, entry.ros_version, entry.size, entry.mtime_ns),
            *(entry.start_ns, entry.end_ns, entry.count, _SEPARATOR.join(entry.silent), entry.problem),
            *(int(entry.own), id),
        ),
    )
    db.execute("DELETE FROM topic WHERE recording = ?", (id,))
    db.executemany(
        "INSERT OR REPLACE INTO topic VALUES (?, ?, ?, ?, ?, ?)",
        [(id, each.name, each.type.name, each.type.hash, each.count, each.unreadable) for each in entry.topics],
    )


def _state(path: str | None, known: Collection[str]) -> int:
    if path is None or path in known:
        return _VANISHED if path is None else _PRESENT
    return _ELSEWHERE if Path(path).exists() else _VANISHED


def _tables_about_recordings(db: sqlite3.Connection) -> frozenset[str]:
    query = "SELECT m.name FROM sqlite_master m, pragma_table_info(m.name) c WHERE m.type = 'table' AND c.name = ?"
    return frozenset(name for (name,) in db.execute(query, ("recording",)))


def _known(db: sqlite3.Connection, identity: str, path: str, batch: Mapping[str, str]) -> int | None:
    """Return the number of the recording with this content at a path, else of one moved there, else of the path."""
    same = db.execute("SELECT id, path FROM recording WHERE identity = ?", (identity,)).fetchall()
    for id, old in same:
        if old == path:
            return int(id)
    for id, old in same:
        if old is None or batch.get(old, identity) != identity or not Path(old).exists():
            return int(id)
    row = db.execute("SELECT id FROM recording WHERE path = ?", (path,)).fetchone()
    return None if row is None else int(row[0])


def _free_name(db: sqlite3.Connection, names: Sequence[str]) -> str:
    for name in chain(names, (f"{names[-1]}-{number}" for number in count(2))):
        if db.execute("SELECT 1 FROM recording WHERE name = ?", (name,)).fetchone() is None:
            return name
    raise AssertionError("one of the numbers is free")


def _row(row: tuple[Any, ...]) -> Row:
    id, identity, name, path, format, ros, size, mtime, start, end, number, silent, problem, *rest = row
    times = (mtime, start, end)
    names = tuple(silent.split(_SEPARATOR)) if silent else ()
    return Row(
        *(id, identity, name, Path(path or ""), format, ros, size, *times, number, names, problem),
        *(bool(rest[0]), bool(rest[1]), rest[2]),
    )


def _topic(row: tuple[Any, ...]) -> RecordedTopic:
    name, type, hash, number, unreadable = row[:5]
    return RecordedTopic(name, TypeRef(type, hash), number, unreadable)


def _among(column: str, names: Collection[str] | None) -> str:
    return "" if names is None else f" AND {column} IN ({', '.join('?' * len(names))})"


def _escaped(word: str) -> str:
    return "".join(f"!{letter}" if letter in "!%_" else letter for letter in word)
