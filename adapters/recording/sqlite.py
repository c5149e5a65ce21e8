"""The SQLite files of ROS 2 bags (`.db3`), of every version of their schema."""

from __future__ import annotations

import sqlite3
import threading
from pathlib import Path
from urllib.parse import quote

import numpy as np

from rosld.adapters.model import Encoding
from rosld.adapters.recording.mcap import latched
from rosld.adapters.recording.storage import Damaged, MessageTable, RecordedConnection, RosVersion

MAGIC = b"SQLite format 3\0"
_SYNTAXES = {"ros2msg": "msg", "ros2idl": "idl"}


class Sqlite:
    """An open `.db3` file: a `Storage`, whose offsets are row numbers."""

    format = "ROS 2 bag (sqlite3)"
    ros_version: RosVersion = 2
    places = 1
    notes: tuple[str, ...] = ()

    def __init__(self, path: Path) -> None:
        # immutable: no lock and no journal is made beside a file that may lie on a read-only disk
        address = f"file:{quote(str(path.resolve()))}?mode=ro&immutable=1"
        try:
            self._database = sqlite3.connect(address, uri=True, check_same_thread=False)
        except (sqlite3.Error, UnicodeDecodeError) as error:
            raise Damaged(f"it cannot be opened: {error}") from error
        self._lock = threading.Lock()
        try:
            self.connections, numbers = _topics(self._database)
            self.messages = _messages(self._database, numbers)
        except (sqlite3.Error, UnicodeDecodeError) as error:
            self._database.close()
            raise Damaged(f"it is no database of messages: {error}") from error

    def read(self, place: int, offset: int) -> bytes:
        """The bytes of the message in row `offset`. Raises Damaged."""
        try:
            with self._lock:
                row = self._database.execute("SELECT data FROM messages WHERE rowid = ?", (offset,)).fetchone()
        except (sqlite3.Error, UnicodeDecodeError) as error:
            raise Damaged(f"the database cannot be read: {error}") from error
        if row is None or not isinstance(row[0], bytes):
            raise Damaged(f"there is no message in row {offset}")
        return row[0]

    def close(self) -> None:
        """Close the database."""
        with self._lock:
            self._database.close()


def _topics(database: sqlite3.Connection) -> tuple[list[RecordedConnection], dict[int, int]]:
    columns = {row[1] for row in database.execute("PRAGMA table_info(topics)")}
    wanted = ["id", "name", "type", "serialization_format"]
    optional = [each for each in ("offered_qos_profiles", "type_description_hash") if each in columns]
    definitions = _definitions(database)
    connections: list[RecordedConnection] = []
    numbers: dict[int, int] = {}
    for row in database.execute(f"SELECT {', '.join(wanted + optional)} FROM topics ORDER BY id"):
        said = dict(zip(wanted + optional, row, strict=True))
        numbers[said["id"]] = len(connections)
        connections.append(_connection({key: str(value) for key, value in said.items()}, definitions))
    return connections, numbers


def _definitions(database: sqlite3.Connection) -> dict[str, tuple[str, str]]:
    """Type to syntax and text; empty for the older schemas, which hold none."""
    try:
        rows = database.execute("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions")
        return {str(name): (str(syntax), str(text)) for name, syntax, text in rows}
    except (sqlite3.Error, UnicodeDecodeError):
        return {}


def _connection(said: dict[str, str], definitions: dict[str, tuple[str, str]]) -> RecordedConnection:
    syntax, text = definitions.get(said["type"], ("ros2msg", ""))
    odd = None
    if said["serialization_format"] != "cdr":
        odd = f"its messages are in {said['serialization_format']!r}, not in 'cdr'"
    return RecordedConnection(
        topic=said["name"],
        type=said["type"],
        encoding=Encoding.CDR,
        definition=text,
        syntax=_SYNTAXES.get(syntax, syntax),
        hash=said.get("type_description_hash") or None,
        latched=latched(said.get("offered_qos_profiles", "")),
        odd=odd,
    )


def _messages(database: sqlite3.Connection, numbers: dict[int, int]) -> MessageTable:
    rows = database.execute("SELECT timestamp, topic_id, rowid FROM messages")
    parts: list[np.ndarray[tuple[int, ...], np.dtype[np.int64]]] = [np.empty((0, 3), np.int64)]
    while batch := rows.fetchmany(65536):
        known = [row for row in batch if row[1] in numbers and isinstance(row[0], int)]
        parts.append(np.asarray(known, np.int64).reshape(-1, 3))
    whole = np.concatenate(parts)
    topics = np.asarray([numbers[topic] for topic in whole[:, 1].tolist()], np.int32)
    return MessageTable(whole[:, 0].copy(), topics, np.zeros(len(whole), np.int32), whole[:, 2].copy())
