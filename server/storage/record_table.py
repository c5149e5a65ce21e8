"""Queries and writes of records on one SQLite connection.

Independent of files and of the event loop. `begin`, `commit` and `rollback` delimit transactions; the versions of a
transaction become used when it is committed.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple

from rosld.server.storage.record import (
    Conflict,
    ConflictCause,
    Member,
    Model,
    Put,
    Record,
    RecordChange,
    Remove,
    Write,
    container_of,
    database_error,
)
from rosld.server.storage.tables import (
    INSERT_RECORD,
    MODELS,
    SELECT_ALL,
    SELECT_CHANGES,
    SELECT_CURRENT,
    SELECT_LAST_NUMBERS,
    SELECT_LATEST_VERSION,
    SELECT_MEMBERS,
    SELECT_RECORD,
    UPDATE_RECORD,
    UPDATE_TRIPLES,
    CurrentRow,
    FormerVersion,
    forget_versions,
    former_version_at,
    former_versions,
    record_of_row,
    row_texts,
)
from rosld.server.storage.transactions import Effects, MemberList, with_list

OPENING = 1 << 20
"""Interval of versions: opening the records continues at the next multiple."""

_GREATEST = (1 << 63) - 1


class NumberedRecord(NamedTuple):
    """A record with its number among the members of its container. Entries are ordered by number."""

    number: int
    record: Record


class RecordTable:
    """The records of a database that has its tables. Used by one thread at a time.

    `known` returns a cached record, which may be outdated. Methods raise StorageError; `blob_ids`, `all_records`,
    `tombstones` and `restore` raise sqlite3.Error.
    """

    def __init__(
        self, connection: sqlite3.Connection, cached: Callable[[str], Record | None] = lambda path: None
    ) -> None:
        self._execute: Callable[..., sqlite3.Cursor] = connection.execute
        self._connection = connection
        self._cached = cached
        self._next = 0
        self._data_version_read = self._data_version()
        self.identity = str(self._execute("SELECT value FROM property WHERE name = 'identity'").fetchone()[0])
        latest = self._latest()
        self.version = (latest // OPENING + 1) * OPENING if latest else 0
        """The last version used."""

    def close(self) -> None:
        """Close the connection. Idempotent."""
        self._connection.close()

    def find(self, path: str) -> Record | None:
        """Return the record at a path, or None."""
        try:
            row = self._execute(SELECT_RECORD, (path,)).fetchone()
        except sqlite3.Error as error:
            raise database_error(error) from error
        return None if row is None else record_of_row(path, row)

    def versions(self, path: str) -> list[FormerVersion]:
        """Return the former versions of a document, without their triples."""
        try:
            return former_versions(self._connection, path)
        except sqlite3.Error as error:
            raise database_error(error) from error

    def version_at(self, path: str, time_ns: int) -> Record | None:
        """Return the former version of a document at a time (ns since the epoch), or None."""
        try:
            return former_version_at(self._connection, path, time_ns)
        except sqlite3.Error as error:
            raise database_error(error) from error

    def is_tombstone(self, path: str) -> bool:
        """Whether the record at a path was removed."""
        try:
            return self._execute("SELECT 1 FROM gone WHERE path = ?", (path,)).fetchone() is not None
        except sqlite3.Error as error:
            raise database_error(error) from error

    def members(self, path: str, after: int, limit: int) -> list[Member]:
        """Return at most `limit` members of a container with numbers above `after`, in the order of numbers."""
        try:
            rows = self._execute(SELECT_MEMBERS, (path, after, limit)).fetchall()
        except sqlite3.Error as error:
            raise database_error(error) from error
        return [Member(number, name, MODELS[model], member) for number, name, model, member in rows]

    def last_member_numbers(self, path: str, up_to: int | None, limit: int) -> list[int]:
        """Return the last `limit` numbers of members of a container, newest first, up to a number (None: all)."""
        try:
            rows = self._execute(SELECT_LAST_NUMBERS, (path, _GREATEST if up_to is None else up_to, limit)).fetchall()
        except sqlite3.Error as error:
            raise database_error(error) from error
        return [row[0] for row in rows]

    def changes_since(self, after: int, limit: int) -> list[RecordChange]:
        """Return the first `limit` changes after a version, in the order of versions."""
        try:
            rows = self._execute(SELECT_CHANGES, (after, limit)).fetchall()
        except sqlite3.Error as error:
            raise database_error(error) from error
        return [RecordChange(path, version, bool(is_removed)) for path, version, is_removed in rows]

    def blob_ids(self) -> set[str]:
        """Return the ids of all blobs that records refer to."""
        return {row[0] for row in self._execute("SELECT blob FROM record WHERE blob IS NOT NULL")}

    def all_records(self) -> Iterator[NumberedRecord]:
        """Return all records, containers before their members."""
        return (NumberedRecord(row[0], record_of_row(row[1], row[2:])) for row in self._execute(SELECT_ALL))

    def tombstones(self) -> Iterator[str]:
        """Return the paths of all removed records."""
        return (row[0] for row in self._execute("SELECT path FROM gone ORDER BY path"))

    def changed_elsewhere(self) -> bool:
        """Whether another process has changed the database since the last call."""
        previous, self._data_version_read = self._data_version_read, self._data_version()
        if previous == self._data_version_read:
            return False
        self.version = max(self.version, self._latest())
        return True

    def begin(self) -> bool:
        """Begin a write transaction; return whether another process has changed the database."""
        try:
            self._execute("BEGIN IMMEDIATE")
            foreign = self.changed_elsewhere()
        except sqlite3.Error as error:
            self.rollback()
            raise database_error(error) from error
        self._next = self.version
        return foreign

    def commit(self) -> None:
        """Commit the writes since `begin`."""
        try:
            self._execute("COMMIT")
        except sqlite3.Error as error:
            raise database_error(error) from error
        self.version = self._next

    def rollback(self) -> None:
        """Undo the writes since `begin`. Does nothing if a failure has rolled them back already."""
        if self._connection.in_transaction:
            self._execute("ROLLBACK")

    def create_root(self, path: str, now: int) -> None:
        """Create a container without a parent, unless it exists; between `begin` and `commit`."""
        if self._present(path) is None:
            self._insert(Put(path, Model.BASIC_CONTAINER), 0, now)

    def apply(self, writes: Sequence[Write], received: Sequence[str], now: int) -> Effects | Conflict:
        """Apply all of these writes or none, between `begin` and `commit`; return their effects, or the conflict.

        `received` are the ids of blobs that no record refers to yet. After a StorageError only `rollback` is possible.
        """
        applied, several, version = Effects(received), len(writes) > 1, self._next
        try:
            if several:
                self._execute("SAVEPOINT attempt")
            try:
                for write in writes:
                    self._apply(write, applied, now)
            except Conflict as conflict:
                if several:  # a single write has no effect before it raises
                    self._execute("ROLLBACK TO attempt")
                    self._next = version
                return conflict
            finally:
                if several and self._connection.in_transaction:
                    self._execute("RELEASE attempt")
        except sqlite3.Error as error:
            raise database_error(error) from error
        return applied

    def apply_single(self, put: Put, now: int) -> Record | None:
        """Apply a write that is a single statement and a transaction by itself; return None if it needs more.

        Must not be called between `begin` and `commit`, or if another process may write.
        """
        self._next = self.version
        try:
            record = self._rewritten(put, now)
        except sqlite3.Error as error:
            raise database_error(error) from error
        self.version = self._next
        return record

    def restore(self, entries: Iterable[NumberedRecord], tombstones: Iterable[str], now: int) -> list[str]:
        """Replace all records with these, with new versions; return the ids of the blobs that are no longer referenced.

        Call between `begin` and `commit`. Existing records that are not in `entries` are removed; tombstones of records
        in `entries` are deleted. The order of `entries` is that of `all_records`. Raises ValueError if a container is
        missing.
        """
        freed = list(self.blob_ids())
        before = [row[0] for row in self._execute("SELECT path FROM record ORDER BY id")]
        self._execute("DELETE FROM record")
        self._execute("DELETE FROM list")
        counts, numbers, restored = dict[int, int](), {"": 0}, set[str]()
        last = 0
        for number, record in entries:
            container = numbers.get(container_of(record.path))
            if container is None or number <= last or record.path in restored:
                raise ValueError(f"{record.path} comes without its container, or twice")
            last = number
            # A number is the version in which its record was created (`_insert`): continue above all restored numbers.
            self._next = max(self._next, number) + 1
            self._row(number, self._next, container, record)
            self._execute("DELETE FROM gone WHERE path = ?", (record.path,))
            restored.add(record.path)
            counts[container] = counts.get(container, 0) + 1
            if record.model.is_container:
                numbers[record.path] = number
                self._execute("INSERT INTO list VALUES (?, 0, ?, 0)", (number, record.modified_ns))
        for container, count in counts.items():
            self._next += 1
            self._execute("UPDATE list SET version = ?, count = ? WHERE container = ?", (self._next, count, container))
        for path in before:
            if path not in restored and not container_of(path):
                self._insert(Put(path, Model.BASIC_CONTAINER), 0, now)
            elif path not in restored:
                self._next += 1
                self._execute("INSERT OR REPLACE INTO gone VALUES (?, ?)", (path, self._next))
        for path in tombstones:
            if path not in restored:
                self._next += 1
                self._execute("INSERT OR IGNORE INTO gone VALUES (?, ?)", (path, self._next))
        return freed

    def _apply(self, write: Write, applied: Effects, now: int) -> None:
        """Apply a write, completely or (if it raises Conflict) not at all."""
        if isinstance(write, Put):
            self._put(write, applied, now)
        else:
            self._remove(write, applied, now)

    def _data_version(self) -> int:
        return int(self._execute("PRAGMA data_version").fetchone()[0])

    def _latest(self) -> int:
        return int(self._execute(SELECT_LATEST_VERSION).fetchone()[0])

    def _present(self, path: str) -> CurrentRow | None:
        row = self._execute(SELECT_CURRENT, (path,)).fetchone()
        return None if row is None else CurrentRow(*row)

    def _put(self, put: Put, applied: Effects, now: int) -> None:
        rewritten = self._rewritten(put, now)
        if rewritten is not None:
            applied.records[put.path] = rewritten
            return
        present = self._present(put.path)
        if present is None:
            self._make(put, applied, now)
        elif not put.only_if_absent:
            self._replace(put, present, applied, now)

    def _rewritten(self, put: Put, now: int) -> Record | None:
        """Replace only the triples of a cached RDF source; return None if the write needs more than that."""
        path, triples = put.path, put.triples
        cached = self._cached(path) if put.model is Model.RDF_SOURCE else None
        if cached is None or cached.model is not Model.RDF_SOURCE:
            return None
        if put.expected not in (None, cached.version) or put.member not in (None, cached.member):
            return None
        version, modified = self._next + 1, max(now, cached.modified_ns)
        if self._execute(UPDATE_TRIPLES, (version, modified, triples, path, cached.version)).rowcount != 1:
            return None
        self._next = version
        return Record(path, cached.model, version, cached.created_ns, modified, triples, member=cached.member)

    def _make(self, put: Put, applied: Effects, now: int) -> None:
        path = put.path
        if (put.unused or put.expected) and self.is_tombstone(path):
            raise Conflict(path, "it was deleted", ConflictCause.GONE)
        if put.expected:
            raise Conflict(path, f"it does not exist, so it cannot be in version {put.expected}", ConflictCause.MISSING)
        above = container_of(path)
        container = self._present(above)
        if container is None:
            words = f"its container {above} does not exist" if above else "no resource can be created next to the roots"
            raise Conflict(path, words, ConflictCause.CONTAINER)
        other = path[:-1] if path.endswith("/") else path + "/"
        if self._execute("SELECT 1 FROM record WHERE path = ?", (other,)).fetchone() is not None:
            raise Conflict(path, f"{other} already exists with the same name", ConflictCause.NAME)
        _take(put, None, applied)
        applied.removed.pop(path, None)
        applied.records[path] = self._insert(put, container.id, now)
        self._list(above, container, applied, now, 1)

    def _insert(self, put: Put, container: int, now: int) -> Record:
        self._next = version = self._next + 1
        record = Record(put.path, put.model, version, now, now, put.triples, put.blob, put.membership, put.member)
        self._row(version, version, container, record)
        if put.model.is_container:
            self._execute("INSERT INTO list VALUES (?, 0, ?, 0)", (version, now))
        return record

    def _row(self, number: int, version: int, container: int, record: Record) -> None:
        head = (number, record.path, container, record.model.value, version, record.created_ns, record.modified_ns)
        self._execute(INSERT_RECORD, (*head, record.member, *row_texts(record.blob, record.membership), record.triples))

    def _replace(self, put: Put, present: CurrentRow, applied: Effects, now: int) -> None:
        path, blob, triples = put.path, put.blob, put.triples
        _expect(put, present)
        if put.model.value != present.model:
            words = f"it is a {present.model} and cannot become a {put.model.value}"
            raise Conflict(path, words, ConflictCause.MODEL)
        _take(put, present.blob, applied)
        member = present.member if put.member is None else put.member
        now = max(now, present.modified)
        self._next = version = self._next + 1
        self._execute(UPDATE_RECORD, (version, now, member, *row_texts(blob, put.membership), triples, present.id))
        modified = max(now, present.list_modified or 0)
        applied.records[path] = Record(
            path,
            put.model,
            version,
            present.created,
            modified,
            triples,
            blob,
            put.membership,
            member,
            present.listed or 0,
            present.members or 0,
        )
        if member != present.member:
            above = container_of(path)
            container = self._present(above)
            if container is not None:
                self._list(above, container, applied, now, 0)

    def _remove(self, remove: Remove, applied: Effects, now: int) -> None:
        path = remove.path
        present = self._present(path)
        if present is None:
            is_tombstone = self._execute("SELECT 1 FROM gone WHERE path = ?", (path,)).fetchone() is not None
            raise (
                Conflict(path, "it was deleted", ConflictCause.GONE)
                if is_tombstone
                else Conflict(path, "it does not exist", ConflictCause.MISSING)
            )
        _expect(remove, present)
        if not present.container:
            raise Conflict(path, "it is permanent and cannot be deleted", ConflictCause.ROOT)
        if present.members:
            words = f"it is not empty: delete its {present.members} members first"
            raise Conflict(path, words, ConflictCause.NOT_EMPTY)
        self._next = version = self._next + 1
        self._execute("DELETE FROM record WHERE id = ?", (present.id,))
        if present.members is not None:
            self._execute("DELETE FROM list WHERE container = ?", (present.id,))
        self._execute("INSERT OR REPLACE INTO gone VALUES (?, ?)", (path, version))
        if remove.with_versions:
            forget_versions(self._connection, path)
        applied.records.pop(path, None)
        applied.lists.pop(path, None)
        applied.removed[path] = version
        if present.blob is not None:
            applied.freed.append(present.blob)
        above = container_of(path)
        container = self._present(above)
        if container is not None:
            self._list(above, container, applied, now, -1)

    def _list(self, path: str, container: CurrentRow, applied: Effects, now: int, more: int) -> None:
        """Add `more` to the number of members of a container, and give its list a new version."""
        self._next = version = self._next + 1
        listed = MemberList(version, max(now, container.list_modified or 0), (container.members or 0) + more)
        self._execute(
            "UPDATE list SET version = ?, modified = ?, count = ? WHERE container = ?", (*listed, container.id)
        )
        applied.lists[path] = listed
        record = applied.records.get(path)
        if record is not None:
            applied.records[path] = with_list(record, listed)


def _expect(write: Write, present: CurrentRow) -> None:
    """Raise Conflict if the record has another version than the write expects."""
    if write.expected is None or write.expected == present.version:
        return
    if write.expected == 0:
        raise Conflict(write.path, "it already exists", ConflictCause.THERE)
    words = f"it has changed: it is in version {present.version}, not {write.expected}"
    raise Conflict(write.path, words, ConflictCause.CHANGED)


def _take(put: Put, present: str | None, applied: Effects) -> None:
    """Assign the blob of a write, and free the previous one. Raises Conflict for another record's blob."""
    id = None if put.blob is None else put.blob.id
    if id == present:
        return
    if id is not None:
        if id not in applied.unused:
            raise Conflict(put.path, "its uploaded content is no longer available: send it again", ConflictCause.BLOB)
        applied.unused.discard(id)
    if present is not None:
        applied.freed.append(present)
