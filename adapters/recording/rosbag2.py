"""ROS 2 bags: folders with `metadata.yaml`, and SQLite files (`.db3`) of every version of their schema."""

from __future__ import annotations

import re
import sqlite3
import sys
import threading
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import takewhile
from pathlib import Path, PurePosixPath
from typing import NamedTuple, TypeAlias
from urllib.parse import quote

import numpy as np
from ruamel.yaml import YAML, events
from ruamel.yaml.error import YAMLError

from rosld.adapters.model import Encoding
from rosld.adapters.recording.byte_source import MAX_PIECE, decompress_zstd
from rosld.adapters.recording.mcap import latched
from rosld.adapters.recording.storage import (
    Damaged,
    MessageTable,
    OpenBudget,
    OpeningRefused,
    RecordedConnection,
    Storage,
    Totals,
    concatenate,
    message_table,
)

METADATA = "metadata.yaml"
_MAX_BYTES = 2 * 1024 * 1024
"""Maximum bytes of metadata, enough for some 4,000 topics."""
_MAX_LEVELS = 20
_LONGEST_REASON = 200
_SEGMENT = re.compile(r"\d{8}T\d{6}Z-\d{12}\.mcap")
"""Name of a file of a history: its start, and the number of its first message."""
_SUFFIXES = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")


class Metadata(NamedTuple):
    """Content of `metadata.yaml`: files, compression ("", "file", "message"), and the type hash of each topic."""

    files: tuple[str, ...] = ()
    compression: str = ""
    hashes: Mapping[str, str] = {}


class Rosbag2(Storage):
    """An open folder of ROS 2 files, with the places of all its files."""

    def __init__(
        self,
        folder: Path,
        open_file: Callable[[Path, OpenBudget], Storage],
        budget: OpenBudget,
        *,
        only_totals: bool = False,
    ) -> None:
        metadata, notes = _listed_files(folder) if only_totals else _metadata(folder, budget)
        self._per_message = metadata.compression == "message"
        self._files: list[Storage] = []
        paths = _files(folder, metadata)
        if not paths:
            raise Damaged(f"it holds neither {METADATA} nor .mcap nor .db3 files")
        for path in paths:
            try:
                budget.spend(parts=1)
                self._files.append(open_file(path, budget))
            except (Damaged, OSError) as error:
                notes.append(f"{path.name} is omitted: {error}")
            except BaseException:
                self.close()
                raise
        if not self._files:
            self.close()
            raise Damaged("; ".join(notes))
        self.ros_version = self._files[0].ros_version
        self.format = f"ROS {self.ros_version} bag ({' + '.join(sorted({each.format for each in self._files}))})"
        self.connections = [
            each if each.hash else each._replace(hash=metadata.hashes.get(each.topic) or None)
            for file in self._files
            for each in file.connections
        ]
        self.notes = (*notes, *(note for file in self._files for note in file.notes))
        self._starts = np.cumsum([0, *(file.places for file in self._files)]).tolist()
        self.places = self._starts[-1]
        self.messages = self._join()
        totals = [each for file in self._files if (each := file.totals) is not None]
        if len(totals) == len(self._files):
            spans = [each for each in totals if sum(each.counts)]
            first, last = (
                min((each.start_ns for each in spans), default=0),
                max((each.end_ns for each in spans), default=0),
            )
            self.totals = Totals([count for each in totals for count in each.counts], first, last)

    def read(self, place: int, offset: int) -> bytes:
        """Return the bytes of the message, decompressed if messages are compressed individually. Raises Damaged."""
        number = bisect_right(self._starts, place) - 1
        data = self._files[number].read(place - self._starts[number], offset)
        return decompress_zstd(data) if self._per_message else data

    def limit_cache(self, max_bytes: int) -> None:
        for file in self._files:
            file.limit_cache(max_bytes // len(self._files))

    def close(self) -> None:
        """Close all files."""
        for file in self._files:
            file.close()

    def _join(self) -> MessageTable:
        tables: list[MessageTable] = []
        first = 0
        for start, file in zip(self._starts, self._files, strict=False):
            table = file.messages
            connections = (table.connections + first).astype(np.int32)
            tables.append(table._replace(connections=connections, places=(table.places + start).astype(np.int32)))
            first += len(file.connections)
        return concatenate(tables)


def is_one_recording(folder: Path) -> bool:
    """Whether a folder is one recording: a ROS 2 bag, or the history of a server.

    The former has metadata, or only the parts `FOLDER_0.mcap`, `FOLDER_1.mcap`, ...
    """
    if (folder / METADATA).is_file():
        return True
    names = {path.name for path in folder.iterdir() if path.name.endswith((*_SUFFIXES, ".bag", ".zst"))}
    return bool(names) and any(
        all(map(_SEGMENT.fullmatch, names))
        or names == {f"{folder.name}_{number}{suffix}" for number in range(len(names))}
        for suffix in _SUFFIXES
    )


def _listed_files(folder: Path) -> tuple[Metadata, list[str]]:
    """Return the files whose names are in `metadata.yaml`: parsing it takes ten times as long as reading summaries."""
    path = folder / METADATA
    text = path.read_bytes()[:_MAX_BYTES].decode("utf-8", "replace") if path.is_file() else ""
    names = tuple(each.name for each in _files(folder, Metadata()) if each.name in text)
    return Metadata(names), []


def _metadata(folder: Path, budget: OpenBudget) -> tuple[Metadata, list[str]]:
    """Return the metadata, and a note if `metadata.yaml` is missing or invalid."""
    path = folder / METADATA
    if not path.exists():
        return Metadata(), [f"it has no {METADATA}, so all its files were read"]
    try:
        information = _member(_yaml(path, budget), "rosbag2_bagfile_information")
        topics = [_member(each, "topic_metadata") for each in _list(_member(information, "topics_with_message_count"))]
        mode = _text(_member(information, "compression_mode")).lower()
        files = [PurePosixPath(_text(each)).name for each in _list(_member(information, "relative_file_paths"))]
    except (YAMLError, ValueError) as error:
        words = " ".join(str(error).split())[:_LONGEST_REASON]
        return Metadata(), [f"its {METADATA} cannot be read ({words}), so all its files were read"]
    hashes = {_text(_member(each, "name")): _text(_member(each, "type_description_hash")) for each in topics}
    return Metadata(tuple(files), mode if mode in ("file", "message") else "", hashes), []


_Yaml: TypeAlias = "str | list[_Yaml] | dict[str, _Yaml]"


def _yaml(path: Path, budget: OpenBudget) -> _Yaml:
    """Return the value of a YAML file, all scalars as text. Raises YAMLError, and ValueError for disallowed content.

    Disallowed are more than `_MAX_BYTES`, deep nesting, and aliases, which can make a short text expand without limit.
    """
    if path.stat().st_size > _MAX_BYTES:
        raise ValueError(f"it has more than {_MAX_BYTES} bytes")

    def parsed() -> Iterator[events.Event]:
        for event in YAML(typ="safe", pure=True).parse(path.read_text("utf-8", "replace")):
            budget.work()
            if isinstance(event, events.AliasEvent):
                raise ValueError("it has aliases, which are not supported")
            yield event

    def value(event: events.Event, level: int) -> _Yaml:
        if isinstance(event, events.ScalarEvent):
            return str(event.value)
        if level == _MAX_LEVELS:
            raise ValueError(f"it nests deeper than {_MAX_LEVELS} levels")
        inner = takewhile(lambda each: not isinstance(each, events.CollectionEndEvent), found)
        if isinstance(event, events.SequenceStartEvent):
            return [value(each, level + 1) for each in inner]
        members: dict[str, _Yaml] = {}
        for key in inner:
            if not isinstance(key, events.ScalarEvent):
                raise ValueError("a key in it is not a string")
            members[str(key.value)] = value(next(found), level + 1)
        return members

    found = parsed()
    roots = [value(each, 1) for each in found if isinstance(each, events.ScalarEvent | events.CollectionStartEvent)]
    return roots[0] if roots else ""


def _member(value: _Yaml, name: str) -> _Yaml:
    """Return a member of a mapping, or an empty string. Raises ValueError if the value is not a mapping."""
    if not isinstance(value, dict):
        raise ValueError(f"the parent of {name} is not a mapping")
    return value.get(name, "")


def _list(value: _Yaml) -> list[_Yaml]:
    return value if isinstance(value, list) else []


def _text(value: _Yaml) -> str:
    return value if isinstance(value, str) and value not in ("null", "~") else ""


def _files(folder: Path, metadata: Metadata) -> Sequence[Path]:
    if metadata.files:
        return [folder / name for name in metadata.files]
    return sorted(path for path in folder.iterdir() if path.name.endswith(_SUFFIXES) and path.is_file())


SQLITE_MAGIC = b"SQLite format 3\0"
_STEPS = 100_000
"""SQLite virtual machine instructions between checks of the budget."""
_STEP_WORK = 50
"""Work units of an instruction."""
_SYNTAXES = {"ros2msg": "msg", "ros2idl": "idl"}


class Sqlite(Storage):
    """An open `.db3` file, whose offsets are row numbers."""

    format = "ROS 2 bag (sqlite3)"

    def __init__(self, path: Path, budget: OpenBudget, *, only_totals: bool = False) -> None:
        # immutable: neither lock nor journal is created, because the disk may be read-only
        address = f"file:{quote(str(path.resolve()))}?mode=ro&immutable=1"
        try:
            self._database = sqlite3.connect(address, uri=True, check_same_thread=False)
        except (sqlite3.Error, UnicodeDecodeError) as error:
            raise Damaged(f"it cannot be opened: {error}") from error
        self._lock = threading.Lock()
        try:
            _distrust(self._database, budget)
            self.connections, numbers = _topics(self._database, budget)
            if only_totals:
                self.totals = _totals(self._database, numbers)
                self.messages = message_table([], [], [], [])
            else:
                self.messages = _messages(self._database, numbers, budget)
            self._database.set_progress_handler(None, 0)
        except (sqlite3.Error, UnicodeDecodeError) as error:
            self._database.close()
            budget.work(0)
            raise Damaged(f"it is not a database of messages: {error}") from error
        except BaseException:
            self._database.close()
            raise

    def read(self, place: int, offset: int) -> bytes:
        """Return the bytes of the message in row `offset`. Raises Damaged."""
        try:
            with self._lock:
                row = self._database.execute("SELECT data FROM messages WHERE rowid = ?", (offset,)).fetchone()
        except (sqlite3.Error, UnicodeDecodeError) as error:
            raise Damaged(f"the database cannot be read: {error}") from error
        if row is None or not isinstance(row[0], bytes):
            raise Damaged(f"there is no message in row {offset}")
        return row[0]

    def close(self) -> None:
        with self._lock:
            self._database.close()


def _distrust(database: sqlite3.Connection, budget: OpenBudget) -> None:
    """Restrict a database to rows of its tables. Raises Damaged for views and generated columns.

    These are programs: they can produce rows, or bytes of a row, without limit.
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
    """Whether to interrupt the query: pages of a tree that refer to each other give rows without end."""
    try:
        budget.work(_STEPS * _STEP_WORK)
    except OpeningRefused:
        return True
    return False


def _topics(database: sqlite3.Connection, budget: OpenBudget) -> tuple[list[RecordedConnection], dict[int, int]]:
    columns = {row[1] for row in database.execute("PRAGMA table_info(topics)")}
    required = ["id", "name", "type", "serialization_format"]
    optional = [each for each in ("offered_qos_profiles", "type_description_hash") if each in columns]
    definitions = _definitions(database, budget)
    connections: list[RecordedConnection] = []
    numbers: dict[int, int] = {}
    for row in database.execute(f"SELECT {', '.join(required + optional)} FROM topics ORDER BY id"):
        fields = dict(zip(required + optional, row, strict=True))
        budget.spend(parts=1, octets=sum(len(each) for each in row if isinstance(each, (str, bytes))))
        numbers[fields["id"]] = len(connections)
        connections.append(_connection({key: str(value) for key, value in fields.items()}, definitions))
    return connections, numbers


def _definitions(database: sqlite3.Connection, budget: OpenBudget) -> dict[str, tuple[str, str]]:
    """Return syntax and text of each type; empty for older schemas, which store none."""
    try:
        rows = database.execute("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions")
        definitions: dict[str, tuple[str, str]] = {}
        for name, syntax, text in rows:
            definitions[str(name)] = str(syntax), str(text)
            budget.spend(parts=1, octets=len(definitions[str(name)][1]))
        return definitions
    except (sqlite3.Error, UnicodeDecodeError):
        return {}


def _connection(fields: dict[str, str], definitions: dict[str, tuple[str, str]]) -> RecordedConnection:
    syntax, text = definitions.get(fields["type"], ("ros2msg", ""))
    odd = None
    if fields["serialization_format"] != "cdr":
        odd = f"its messages are in {fields['serialization_format']!r}, not in 'cdr'"
    return RecordedConnection(
        topic=fields["name"],
        type=fields["type"],
        encoding=Encoding.CDR,
        definition=text,
        syntax=_SYNTAXES.get(syntax, syntax),
        hash=fields.get("type_description_hash") or None,
        latched=latched(fields.get("offered_qos_profiles", "")),
        odd=odd,
    )


def _totals(database: sqlite3.Connection, numbers: dict[int, int]) -> Totals:
    query = "SELECT topic_id, count(*), min(timestamp), max(timestamp) FROM messages GROUP BY topic_id"
    rows = [row for row in database.execute(query) if row[0] in numbers and all(isinstance(one, int) for one in row)]
    counts = {numbers[topic]: count for topic, count, _, _ in rows}
    first, last = min((row[2] for row in rows), default=0), max((row[3] for row in rows), default=0)
    return Totals([counts.get(number, 0) for number in range(len(numbers))], first, last)


def _messages(database: sqlite3.Connection, numbers: dict[int, int], budget: OpenBudget) -> MessageTable:
    rows = database.execute("SELECT timestamp, topic_id, rowid FROM messages")
    parts: list[np.ndarray[tuple[int, ...], np.dtype[np.int64]]] = [np.empty((0, 3), np.int64)]
    while batch := rows.fetchmany(65536):
        budget.spend(messages=len(batch))
        valid = [row for row in batch if row[1] in numbers and isinstance(row[0], int)]
        parts.append(np.asarray(valid, np.int64).reshape(-1, 3))
    whole = np.concatenate(parts)
    topics = np.asarray([numbers[topic] for topic in whole[:, 1].tolist()], np.int32)
    return MessageTable(whole[:, 0].copy(), topics, np.zeros(len(whole), np.int32), whole[:, 2].copy())
