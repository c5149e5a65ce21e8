"""Former versions of documents in the database of records.

SQLite's triggers keep them, in the transaction of the write that makes them former: as durable as documents are.
"""

from __future__ import annotations

import sqlite3
from typing import NamedTuple

from rosld.server.storage.record import Model, Record

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
    """A former version of a document: when it was written, and when it was deleted, if it was."""

    modified_ns: int
    removed_ns: int | None


def keep_versions(connection: sqlite3.Connection, limit: int) -> None:
    """Keep the last `limit` former versions of each document from now on; 0: no more than there are.

    Raises sqlite3.Error.
    """
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
    """The former versions of a document, the oldest first. Raises sqlite3.Error."""
    query = "SELECT modified, removed FROM version WHERE path = ? ORDER BY version"
    return [FormerVersion(*row) for row in connection.execute(query, (path,))]


def former_version_at(connection: sqlite3.Connection, path: str, time_ns: int) -> Record | None:
    """The former version that was there at a time; None where there was none. Raises sqlite3.Error."""
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
