"""Clients' orders to record topics: their JSON form, their notes on disk, and interrupted recordings."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Container, Mapping
from pathlib import Path
from typing import cast

import msgspec
import orjson

from rosld.adapters.model.recorded import RecordingOrder as RecordingOrder
from rosld.adapters.model.recorded import Trigger as Trigger
from rosld.server.storage.files import remove_note, write_note


class RecordingRefused(Exception):
    """A recording is refused: `is_conflict` with others, `is_too_large`, else its order is invalid."""

    def __init__(self, words: str, *, is_conflict: bool = False, is_too_large: bool = False) -> None:
        super().__init__(words)
        self.is_conflict = is_conflict
        self.is_too_large = is_too_large


def order_to_json(order: RecordingOrder) -> dict[str, object]:
    """Return an order as clients send it in JSON."""
    return {**msgspec.to_builtins(order), "topics": list(order.topics)}


def order_from_json(members: Mapping[str, object]) -> RecordingOrder:
    """Return the order with these members. Raises msgspec.ValidationError."""
    return msgspec.convert(members, RecordingOrder)


log = logging.getLogger("rosld.history")
ARMED = ".armed"
"""File suffix of the note of an order that waits for its trigger."""
INTERRUPTED = ".interrupted"
"""File suffix of the note of an interrupted recording."""


class RecordingNotes:
    """Notes in a folder, each of one kind and about one recording. Without a folder, notes are not stored."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder

    def read(self, kind: str) -> Mapping[str, Mapping[str, object]]:
        """Return the notes of a kind by name. Unreadable ones are logged and left in place."""
        if self._folder is None or not self._folder.is_dir():
            return {}
        notes: dict[str, Mapping[str, object]] = {}
        for path in sorted(self._folder.glob(f"[!.]*{kind}")):
            try:
                members: object = orjson.loads(path.read_bytes())
                if not isinstance(members, dict):
                    raise ValueError("it is not an object")
            except (OSError, ValueError) as error:
                log.warning("the record %s cannot be read: %s", path, error)
                continue
            notes[path.name.removesuffix(kind)] = cast("dict[str, object]", members)
        return notes

    def write(self, kind: str, name: str, members: Mapping[str, object]) -> None:
        """Write a note durably. Raises OSError."""
        if self._folder is not None:
            self._folder.mkdir(parents=True, exist_ok=True)
            write_note(self._folder / f"{name}{kind}", orjson.dumps(members))

    def remove(self, kind: str, name: str) -> None:
        """Remove a note durably, if it exists. Raises OSError."""
        if self._folder is not None and self._folder.is_dir():
            remove_note(self._folder / f"{name}{kind}")


STOPPED = "rosld exited while it was being recorded; it is complete up to its last message."
KILLED = "rosld was killed while it was being recorded; it is complete up to the last message on disk."


class Interruptions:
    """The interrupted recordings, by name. Belongs to one event loop."""

    def __init__(self, notes: RecordingNotes) -> None:
        self._notes = notes
        self._reasons: dict[str, str] = {}

    def load(self, names: Container[str]) -> None:
        """Read the notes about these recordings, and remove those about recordings whose files no longer exist."""
        for name, members in self._notes.read(INTERRUPTED).items():
            if name in names:
                self._reasons[name] = str(members.get("why") or KILLED)
            else:
                try:
                    self._notes.remove(INTERRUPTED, name)
                except OSError as error:
                    log.warning("the record that %s was interrupted cannot be deleted: %s", name, error)

    def reason(self, name: str) -> str | None:
        """Return why a recording was interrupted, as a sentence, or None if it was not."""
        return self._reasons.get(name)

    async def add(self, name: str, why: str) -> None:
        """Store that a recording was interrupted; in memory only if the disk fails."""
        self._reasons[name] = why
        try:
            await asyncio.to_thread(self._notes.write, INTERRUPTED, name, {"why": why})
        except OSError as error:
            log.error("cannot store that the recording %s was interrupted: %s", name, error)

    async def remove(self, name: str) -> None:
        """Remove the note about a deleted recording. Raises OSError."""
        if self._reasons.pop(name, None) is not None:
            await asyncio.to_thread(self._notes.remove, INTERRUPTED, name)
