"""Records as rows of SQLite: the statements that read and write them, and what a row stands for."""

from __future__ import annotations

import json
from typing import Any, NamedTuple

from rosld.server.storage.record import Blob, Membership, Model, Record

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
    """What a write must know of a record that is there; the last three are None of what is no container."""

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
    """The columns `blob`, `size`, `media_type` and `membership` of a record's row."""
    text = None
    if membership is not None:
        text = json.dumps([membership.resource, membership.relation, membership.inverse, membership.content])
    return (None, None, None, text) if blob is None else (blob.id, blob.size, blob.media_type, text)


def record_of_row(path: str, row: tuple[Any, ...]) -> Record:
    """The record that a row of `SELECT_RECORD` stands for. A container is modified when its list is, too."""
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
