"""Tables of the database: schema, rows of records, and former versions."""

from __future__ import annotations

import json
import secrets
import sqlite3
from typing import Any, NamedTuple

from rosld.server.storage.record import Blob, Membership, Model, Record

FORMAT = 1
"""Version of the schema; increases when earlier releases can no longer read the database."""
APPLICATION = 0x726F7364
"""SQLite application id of a rosld database ("rosd")."""

# A record's id is the version in which it was created: it orders the members of a container, and is never reused. Lists
# are rows of their own: adding a member then writes a short row, however large the container's own triples.
_TABLES = """
CREATE TABLE property (name TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE record (
    id INTEGER PRIMARY KEY,
    path TEXT NOT NULL UNIQUE,
    container INTEGER NOT NULL,
    model TEXT NOT NULL,
    version INTEGER NOT NULL,
    created INTEGER NOT NULL,
    modified INTEGER NOT NULL,
    member TEXT,
    blob TEXT,
    size INTEGER,
    media_type TEXT,
    membership TEXT,
    triples BLOB NOT NULL
);
CREATE INDEX record_container ON record (container);
CREATE INDEX record_version ON record (version);
CREATE UNIQUE INDEX record_blob ON record (blob) WHERE blob IS NOT NULL;
CREATE TABLE list (
    container INTEGER PRIMARY KEY,
    version INTEGER NOT NULL,
    modified INTEGER NOT NULL,
    count INTEGER NOT NULL
);
CREATE INDEX list_version ON list (version);
CREATE TABLE gone (path TEXT PRIMARY KEY, version INTEGER NOT NULL) WITHOUT ROWID;
CREATE INDEX gone_version ON gone (version);
"""


def prepare_tables(connection: sqlite3.Connection, name: str) -> None:
    """Create the tables if there are none, in one transaction. Raises ValueError for another program's database.

    `name` is the name of the database in errors.
    """
    connection.execute("BEGIN IMMEDIATE")
    try:
        current = read_pragma(connection, "user_version")
        if current == 0:
            if connection.execute("SELECT 1 FROM sqlite_master").fetchone() is not None:
                raise ValueError(f"{name} is a database of another program: choose another folder")
            _make(connection)
        elif read_pragma(connection, "application_id") != APPLICATION:
            raise ValueError(f"{name} is a database of another program: choose another folder")
        elif current > FORMAT:
            raise ValueError(
                f"{name} was written by a newer rosld (format {current}; this one supports {FORMAT}): use that version"
            )
        connection.execute("COMMIT")
    finally:
        if connection.in_transaction:
            connection.execute("ROLLBACK")


def read_pragma(connection: sqlite3.Connection, pragma: str) -> int:
    """Return the number that a pragma returns."""
    return int(connection.execute(f"PRAGMA {pragma}").fetchone()[0])


def _make(connection: sqlite3.Connection) -> None:
    for statement in _TABLES.split(";"):
        connection.execute(statement)
    connection.execute("INSERT INTO property VALUES ('identity', ?)", (secrets.token_hex(8),))
    connection.execute(f"PRAGMA application_id = {APPLICATION}")
    connection.execute(f"PRAGMA user_version = {FORMAT}")


MODELS = {model.value: model for model in Model}
SELECT_RECORD = """SELECT r.model, r.version, r.created, r.modified, r.triples, r.blob, r.size, r.media_type,
    r.membership, r.member, l.version, l.modified, l.count FROM record r LEFT JOIN list l ON l.container = r.id
    WHERE r.path = ?"""
SELECT_CURRENT = """SELECT r.id, r.container, r.model, r.version, r.created, r.modified, r.member, r.blob, l.version,
    l.modified, l.count FROM record r LEFT JOIN list l ON l.container = r.id WHERE r.path = ?"""
SELECT_MEMBERS = """SELECT id, path, model, member FROM record
    WHERE container = (SELECT id FROM record WHERE path = ?) AND id > ? ORDER BY id LIMIT ?"""
SELECT_LAST_NUMBERS = """SELECT id FROM record
    WHERE container = (SELECT id FROM record WHERE path = ?) AND id <= ? ORDER BY id DESC LIMIT ?"""
SELECT_CHANGES = """
    SELECT r.path, r.version AS at, 0 FROM record r LEFT JOIN list l ON l.container = r.id
        WHERE r.version > ?1 AND (l.version IS NULL OR l.version < r.version)
    UNION ALL SELECT r.path, l.version, 0 FROM list l JOIN record r ON r.id = l.container
        WHERE l.version > ?1 AND l.version > r.version
    UNION ALL SELECT path, version, 1 FROM gone WHERE version > ?1
    ORDER BY at LIMIT ?2"""
SELECT_ALL = """SELECT r.id, r.path, r.model, r.version, r.created, r.modified, r.triples, r.blob, r.size, r.media_type,
    r.membership, r.member, l.version, l.modified, l.count FROM record r LEFT JOIN list l ON l.container = r.id
    ORDER BY r.id"""
SELECT_LATEST_VERSION = """SELECT max(coalesce((SELECT max(version) FROM record), 0),
    coalesce((SELECT max(version) FROM list), 0), coalesce((SELECT max(version) FROM gone), 0),
    coalesce((SELECT max(id) FROM record), 0))"""
INSERT_RECORD = """INSERT INTO record (id, path, container, model, version, created, modified, member, blob, size,
    media_type, membership, triples) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)"""
UPDATE_RECORD = """UPDATE record SET version = ?, modified = ?, member = ?, blob = ?, size = ?, media_type = ?,
    membership = ?, triples = ? WHERE id = ?"""
UPDATE_TRIPLES = "UPDATE record SET version = ?, modified = ?, triples = ? WHERE path = ? AND version = ?"


class CurrentRow(NamedTuple):
    """Columns of an existing record that a write needs; the last three are None except for containers."""

    id: int
    container: int
    model: str
    version: int
    created: int
    modified: int
    member: str | None
    blob: str | None
    listed: int | None
    list_modified: int | None
    members: int | None


def row_texts(
    blob: Blob | None, membership: Membership | None
) -> tuple[str | None, int | None, str | None, str | None]:
    """Return the columns `blob`, `size`, `media_type` and `membership` of a record's row."""
    text = None
    if membership is not None:
        text = json.dumps([membership.resource, membership.relation, membership.inverse, membership.content])
    return (None, None, None, text) if blob is None else (blob.id, blob.size, blob.media_type, text)


def record_of_row(path: str, row: tuple[Any, ...]) -> Record:
    """Return the record in a row of `SELECT_RECORD`. A change of a container's list also modifies the container."""
    model, version, created, modified, triples, blob, size, media_type, membership, member, listed, lately, count = row
    return Record(
        path,
        MODELS[model],
        version,
        created,
        modified if lately is None or lately < modified else lately,
        triples,
        None if blob is None else Blob(blob, size, media_type),
        None if membership is None else Membership(*json.loads(membership)),
        member,
        listed or 0,
        count or 0,
    )


_TABLE = """CREATE TABLE IF NOT EXISTS version (path TEXT NOT NULL, version INTEGER NOT NULL, created INTEGER NOT NULL,
    modified INTEGER NOT NULL, removed INTEGER, triples BLOB NOT NULL, PRIMARY KEY (path, version)) WITHOUT ROWID"""
_NAMES = ("version_replaced", "version_removed")
_IS_DOCUMENT = f"old.model = '{Model.RDF_SOURCE.value}' AND (old.path LIKE 'data/%' OR old.path LIKE 'cockpit/%')"
_NOW = "max(old.modified + 1, CAST((julianday('now') - 2440587.5) * 86400000000 AS INTEGER) * 1000)"
_KEEP = """
    INSERT OR REPLACE INTO version VALUES (old.path, old.version, old.created, old.modified, {removed}, old.triples);
    DELETE FROM version WHERE path = old.path AND version <=
        (SELECT version FROM version WHERE path = old.path ORDER BY version DESC LIMIT 1 OFFSET {limit});"""


class FormerVersion(NamedTuple):
    """A former version of a document: the times of its writing and of its deletion, if any."""

    modified_ns: int
    removed_ns: int | None


def keep_versions(connection: sqlite3.Connection, limit: int) -> None:
    """Store the last `limit` former versions of each document from now on; 0 adds no more. Raises sqlite3.Error."""
    for name in _NAMES:
        connection.execute(f"DROP TRIGGER IF EXISTS {name}")
    if not limit:
        return
    connection.execute(_TABLE)
    replaced = _KEEP.format(removed="NULL", limit=limit)
    removed = _KEEP.format(removed=_NOW, limit=limit)
    connection.execute(
        f"CREATE TRIGGER {_NAMES[0]} AFTER UPDATE OF triples ON record "
        f"WHEN {_IS_DOCUMENT} AND old.triples <> new.triples BEGIN {replaced} END"
    )
    connection.execute(f"CREATE TRIGGER {_NAMES[1]} AFTER DELETE ON record WHEN {_IS_DOCUMENT} BEGIN {removed} END")


def former_versions(connection: sqlite3.Connection, path: str) -> list[FormerVersion]:
    """Return the former versions of a document, oldest first. Raises sqlite3.Error."""
    query = "SELECT modified, removed FROM version WHERE path = ? ORDER BY version"
    return [FormerVersion(*row) for row in connection.execute(query, (path,))]


def former_version_at(connection: sqlite3.Connection, path: str, time_ns: int) -> Record | None:
    """Return the former version of a document at a time, or None. Raises sqlite3.Error."""
    row = connection.execute(
        "SELECT version, created, modified, removed, triples FROM version WHERE path = ? AND modified <= ? "
        "ORDER BY version DESC LIMIT 1",
        (path, time_ns),
    ).fetchone()
    if row is None or (row[3] is not None and row[3] <= time_ns):
        return None
    version, created, modified, _, triples = row
    return Record(path, Model.RDF_SOURCE, version, created, modified, triples)


def forget_versions(connection: sqlite3.Connection, path: str) -> None:
    """Delete the former versions of a document. Raises sqlite3.Error."""
    connection.execute("DELETE FROM version WHERE path = ?", (path,))
