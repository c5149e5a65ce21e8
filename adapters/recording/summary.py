"""Entries of the catalogue, from the summaries of recordings; without a summary the index is read."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from rosld.adapters.catalogue import Entry
from rosld.adapters.model import RosError, TypeRef
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.model.recorded import RecordedTopic
from rosld.adapters.recording.adapter import UNFORESEEN, open_storage
from rosld.adapters.recording.bag import learn, with_global_names, without_repeats
from rosld.adapters.recording.storage import OpenBudget, OpeningRefused, RecordedConnection, RosVersion, Storage, Totals

_EDGE = 32 << 10
"""Bytes at both ends of a file that identify its content: its size, and the times and offsets in its index, differ."""
_MOST_PARTS = 32
_MOST_TYPES = 2000
_TURN = 0.01
"""Seconds of reading after which other threads get as long: the server answers meanwhile."""


class PatientBudget(OpenBudget):
    """A budget of work in the background: whoever waits for the interpreter gets half of the time."""

    def __init__(self, limit: int | None = None) -> None:
        super().__init__(limit)
        self._turn = time.monotonic() + 5 * _TURN

    def check(self) -> None:
        super().check()
        if time.monotonic() > self._turn:
            time.sleep(_TURN)
            self._turn = time.monotonic() + _TURN


class SummaryReader:
    """Reads entries. Types are learnt once for all recordings."""

    def __init__(self, folders: Sequence[Path]) -> None:
        self._folders = folders
        self._learnt: dict[tuple[RecordedConnection, RosVersion], tuple[TypeRef, str | None]] = {}
        self._libraries: dict[RosVersion, TypeLibrary] = {}

    def read(self, path: Path, size: int, mtime_ns: int, budget: OpenBudget) -> Entry:
        """Return the entry of the recording at a path, with its problem if it cannot be read. Raises OSError."""
        entry = Entry(content_identity(path), path, size, mtime_ns)
        try:
            storage = open_storage(path, budget, only_totals=True)
            try:
                return self._entry(entry, storage, budget)
            finally:
                storage.close()
        except (RosError, OpeningRefused, *UNFORESEEN) as error:
            budget.check()
            words = error.sentence if isinstance(error, RosError) else f"it cannot be read as a recording: {error}"
            problem = " ".join(words.replace(repr(str(path)), "it").split()) or type(error).__name__
            return Entry(entry.identity, path, size, mtime_ns, problem=problem)

    def _entry(self, entry: Entry, storage: Storage, budget: OpenBudget) -> Entry:
        connections = [with_global_names(each) for each in storage.connections]
        totals = storage.totals or _totals(storage, connections)
        by_topic: dict[str, list[int]] = {}
        for number, connection in enumerate(connections):
            by_topic.setdefault(connection.topic, []).append(number)
        topics: list[RecordedTopic] = []
        for name, numbers in by_topic.items():
            found = [self._learn(connections[number], storage.ros_version, budget) for number in numbers]
            ref, unreadable = next((each for each in found if each[1] is None), found[0])
            topics.append(RecordedTopic(name, ref, sum(totals.counts[number] for number in numbers), unreadable))
        return Entry(
            *(entry.identity, entry.path, entry.size, entry.mtime_ns, storage.format, storage.ros_version),
            *(totals.start_ns, totals.end_ns, sum(totals.counts)),
            tuple(each for each in storage.silent if each not in by_topic),
            tuple(topics),
        )

    def _learn(
        self, connection: RecordedConnection, ros_version: RosVersion, budget: OpenBudget
    ) -> tuple[TypeRef, str | None]:
        """Return the type of a connection, and why its messages cannot be decoded, as an open recording has them."""
        key = connection._replace(topic="", publisher="", latched=False, is_opening=False), ros_version
        if key not in self._learnt:
            budget.learn(1, len(connection.definition))
            if len(self._learnt) >= _MOST_TYPES:
                self._learnt.clear()
                self._libraries.clear()
            if ros_version not in self._libraries:
                self._libraries[ros_version] = TypeLibrary(ros_version=ros_version, folders=self._folders)
            self._learnt[key] = learn(self._libraries[ros_version], key[0], ros_version)
        return self._learnt[key]


def _totals(storage: Storage, connections: Sequence[RecordedConnection]) -> Totals:
    table = without_repeats(storage.messages, connections)
    counts = np.bincount(table.connections, minlength=len(connections)).tolist()
    return Totals(counts, *((int(table.times.min()), int(table.times.max())) if len(table.times) else (0, 0)))


def content_identity(path: Path) -> str:
    """Return an identifier of the content of a file, or of the files of a folder, from their sizes and both ends."""
    digest = hashlib.sha256()
    parts = sorted(each for each in path.iterdir() if each.is_file())[:_MOST_PARTS] if path.is_dir() else [path]
    for part in parts:
        with part.open("rb") as file:
            size = part.stat().st_size
            digest.update(size.to_bytes(8, "little") + file.read(_EDGE))
            file.seek(max(size - _EDGE, 0))
            digest.update(file.read(_EDGE))
    return digest.hexdigest()[:32]
