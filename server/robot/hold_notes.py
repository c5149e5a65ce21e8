"""Notes of active holds on disk: how to end them if the rosld that publishes them is killed.

One file per hold, written when it begins or its final message changes, and removed when it ends; renewals write
nothing.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import msgspec
from msgspec import Struct

from rosld.server.storage.files import remove_note, write_note

FOLDER = "holds"
_SUFFIX = ".json"
_BEGIN_SECONDS = 0.05
"""Seconds that a new hold waits for its note; on a slower disk it begins without."""

_log = logging.getLogger("rosld")


class HoldNote(Struct, frozen=True, forbid_unknown_fields=True):
    """An active hold. `node` is the ROS name of the rosld that publishes it; `type` the message type.

    `data` is the final message, encoded for the robot's system, None for none; `then` is the final message as
    requested. `outcome` is the result of `rosld guard` for a hold whose rosld was killed.
    """

    id: str
    topic: str
    type: str
    node: str
    holder: str
    rate: float
    created_ns: int
    then: str
    data: bytes | None
    outcome: str | None = None


class HoldNotes:
    """The notes in a folder; without a folder, notes are not stored."""

    def __init__(self, data: Path | None) -> None:
        """Initialize; `data` is the folder of `--data`."""
        self._folder = None if data is None else data / FOLDER
        self._noted: dict[str, HoldNote] = {}
        self._disk = ThreadPoolExecutor(1, "rosld-holds")  # one thread, to preserve the order of writes

    async def begin(self, note: HoldNote) -> None:
        """Write the note of a new hold, and wait a moment until it is on disk."""
        if self._folder is not None:
            self.change(note)
            written = asyncio.get_running_loop().run_in_executor(self._disk, lambda: None)
            await asyncio.wait([written], timeout=_BEGIN_SECONDS)

    def change(self, note: HoldNote) -> None:
        """Write the note of a hold if it has changed."""
        if self._folder is not None and self._noted.get(note.id) != note:
            self._noted[note.id] = note
            self._disk.submit(self.write, note)

    def remove(self, id: str) -> None:
        """Remove the note of a hold that has ended."""
        if self._folder is not None:
            self._noted.pop(id, None)
            self._disk.submit(self._remove, id)

    async def close(self) -> None:
        """Wait until everything is on disk."""
        await asyncio.to_thread(self._disk.shutdown)

    def read(self) -> Sequence[HoldNote]:
        """Return the notes in the folder, including those of a killed rosld; unreadable files are skipped."""
        if self._folder is None or not self._folder.is_dir():
            return []
        found: list[HoldNote] = []
        for path in sorted(self._folder.glob(f"[!.]*{_SUFFIX}")):
            try:
                found.append(msgspec.json.decode(path.read_bytes(), type=HoldNote))
            except (OSError, ValueError) as error:
                _log.warning("the record of a hold %s cannot be read: %s", path, error)
        return found

    def reread(self, note: HoldNote) -> HoldNote:
        """Return the note again, which another process may have changed."""
        assert self._folder is not None
        try:
            return msgspec.json.decode((self._folder / f"{note.id}{_SUFFIX}").read_bytes(), type=HoldNote)
        except (OSError, ValueError):
            return note

    def write(self, note: HoldNote) -> None:
        """Write a note, blocking; failures are only logged, because the hold continues without a note."""
        assert self._folder is not None
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            write_note(self._folder / f"{note.id}{_SUFFIX}", msgspec.json.encode(note))
        except OSError as error:
            _log.warning(
                "the hold on %s cannot be written to disk, and will not be ended if rosld is killed: %s",
                note.topic,
                error,
            )

    def _remove(self, id: str) -> None:
        assert self._folder is not None
        try:
            remove_note(self._folder / f"{id}{_SUFFIX}")
        except OSError as error:
            _log.warning("the record of the ended hold %s cannot be deleted from disk: %s", id, error)
