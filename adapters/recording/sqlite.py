"""The SQLite files of ROS 2 bags (`.db3`), of every version of their schema."""

from __future__ import annotations

import sqlite3
import sys
import threading
from pathlib import Path
from urllib.parse import quote

import numpy as np

from rosld.adapters.model import Encoding
from rosld.adapters.recording.byte_source import MAX_PIECE
from rosld.adapters.recording.mcap import latched
from rosld.adapters.recording.open_budget import OpenBudget, OpeningRefused
from rosld.adapters.recording.storage import Damaged, MessageTable, RecordedConnection, RosVersion

MAGIC = b"SQLite format 3\0"
_STEPS = 100_000
"""Instructions of the database's machine between two looks at what it may do."""
_STEP_WORK = 50
"""Units of work of an instruction."""
_SYNTAXES = {"ros2msg": "msg", "ros2idl": "idl"}


class Sqlite:
    """An open `.db3` file: a `Storage`, whose offsets are row numbers."""

    format = "ROS 2 bag (sqlite3)"
    ros_version: RosVersion = 2
    places = 1
    notes: tuple[str, ...] = ()
    silent: tuple[str, ...] = ()

    def __init__(self, path: Path, budget: OpenBudget) -> None:
        # immutable: no lock and no journal is made beside a file that may lie on a read-only disk
        address = f"file:{quote(str(path.resolve()))}?mode=ro&immutable=1"
        try:
            self._database = sqlite3.connect(address, uri=True, check_same_thread=False)
        except (sqlite3.Error, UnicodeDecodeError) as error:
            raise Damaged(f"it cannot be opened: {error}") from error
        self._lock = threading.Lock()
        try:
            _distrust(self._database, budget)
            self.connections, numbers = _topics(self._database, budget)
            self.messages = _messages(self._database, numbers, budget)
            self._database.set_progress_handler(None, 0)
        except (sqlite3.Error, UnicodeDecodeError) as error:
            self._database.close()
            budget.work(0)
            raise Damaged(f"it is no database of messages: {error}") from error
        except BaseException:
            self._database.close()
            raise

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


def _distrust(database: sqlite3.Connection, budget: OpenBudget) -> None:
    """Have a database do no more than give rows of its tables. Raises Damaged where it says that it does more.

    A view, or a column that is generated, is a program: it may give rows, or bytes of a row, without end.
    """
    if sys.version_info >= (3, 11):
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_PIECE)
    database.set_progress_handler(lambda: _is_refused(budget), _STEPS)
    database.execute("PRAGMA trusted_schema = OFF")
    names = ("topics", "messages", "message_definitions")
    for name in names:
        kinds = database.execute("SELECT type FROM sqlite_master WHERE lower(name) = ?", (name,)).fetchall()
        if any(kind != "table" for (kind,) in kinds):
            raise Damaged(f"its {name} are a {kinds[0][0]}, not a table")
        if any(row[6] > 1 for row in database.execute(f"PRAGMA table_xinfo({name})")):
            raise Damaged(f"its {name} have columns that are generated")
    for (sql,) in database.execute("SELECT sql FROM sqlite_master WHERE lower(name) IN (?, ?, ?)", names):
        if str(sql).split()[:2] != ["CREATE", "TABLE"]:
            raise Damaged("its tables are not those of a recording")


def _is_refused(budget: OpenBudget) -> bool:
    """Whether the database is to stop: some pages of a tree that refer to each other give rows without end."""
    try:
        budget.work(_STEPS * _STEP_WORK)
    except OpeningRefused:
        return True
    return False


def _topics(database: sqlite3.Connection, budget: OpenBudget) -> tuple[list[RecordedConnection], dict[int, int]]:
    columns = {row[1] for row in database.execute("PRAGMA table_info(topics)")}
    wanted = ["id", "name", "type", "serialization_format"]
    optional = [each for each in ("offered_qos_profiles", "type_description_hash") if each in columns]
    definitions = _definitions(database, budget)
    connections: list[RecordedConnection] = []
    numbers: dict[int, int] = {}
    for row in database.execute(f"SELECT {', '.join(wanted + optional)} FROM topics ORDER BY id"):
        said = dict(zip(wanted + optional, row, strict=True))
        budget.spend(parts=1, octets=sum(len(each) for each in row if isinstance(each, (str, bytes))))
        numbers[said["id"]] = len(connections)
        connections.append(_connection({key: str(value) for key, value in said.items()}, definitions))
    return connections, numbers


def _definitions(database: sqlite3.Connection, budget: OpenBudget) -> dict[str, tuple[str, str]]:
    """Type to syntax and text; empty for the older schemas, which hold none."""
    try:
        rows = database.execute("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions")
        found: dict[str, tuple[str, str]] = {}
        for name, syntax, text in rows:
            found[str(name)] = str(syntax), str(text)
            budget.spend(parts=1, octets=len(found[str(name)][1]))
        return found
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


def _messages(database: sqlite3.Connection, numbers: dict[int, int], budget: OpenBudget) -> MessageTable:
    rows = database.execute("SELECT timestamp, topic_id, rowid FROM messages")
    parts: list[np.ndarray[tuple[int, ...], np.dtype[np.int64]]] = [np.empty((0, 3), np.int64)]
    while batch := rows.fetchmany(65536):
        budget.spend(messages=len(batch))
        known = [row for row in batch if row[1] in numbers and isinstance(row[0], int)]
        parts.append(np.asarray(known, np.int64).reshape(-1, 3))
    whole = np.concatenate(parts)
    topics = np.asarray([numbers[topic] for topic in whole[:, 1].tolist()], np.int32)
    return MessageTable(whole[:, 0].copy(), topics, np.zeros(len(whole), np.int32), whole[:, 2].copy())
