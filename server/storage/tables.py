"""The tables that records are kept in, and which of their formats a database has."""

from __future__ import annotations

import secrets
import sqlite3

FORMAT = 1
"""The number of this format; it rises whenever an earlier rosld could not read it any more."""
APPLICATION = 0x726F7364
"""What marks a SQLite file as ours ("rosd")."""

# A record's id is the version it was made with: it orders the members of a container, and is never used again.
# Lists are kept apart from their containers: a member more writes a short row, whatever a container says of itself.
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
    """Make the tables where there are none, in one transaction. Raises ValueError for a database that is not ours.

    `name` is what an error calls it.
    """
    connection.execute("BEGIN IMMEDIATE")
    try:
        found = read_pragma(connection, "user_version")
        if found == 0:
            if connection.execute("SELECT 1 FROM sqlite_master").fetchone() is not None:
                raise ValueError(f"{name} is a database of something else: take another folder")
            _make(connection)
        elif read_pragma(connection, "application_id") != APPLICATION:
            raise ValueError(f"{name} is a database of something else: take another folder")
        elif found > FORMAT:
            raise ValueError(
                f"{name} was written by a newer rosld (its format is {found}, this one knows {FORMAT}): use that one"
            )
        connection.execute("COMMIT")
    finally:
        if connection.in_transaction:
            connection.execute("ROLLBACK")


def read_pragma(connection: sqlite3.Connection, pragma: str) -> int:
    """The number that a pragma answers."""
    return int(connection.execute(f"PRAGMA {pragma}").fetchone()[0])


def _make(connection: sqlite3.Connection) -> None:
    for statement in _TABLES.split(";"):
        connection.execute(statement)
    connection.execute("INSERT INTO property VALUES ('identity', ?)", (secrets.token_hex(8),))
    connection.execute(f"PRAGMA application_id = {APPLICATION}")
    connection.execute(f"PRAGMA user_version = {FORMAT}")
