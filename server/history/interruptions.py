"""Which recordings end before they were to, and why: kept beside their files."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Container

from rosld.server.history.recording_notes import INTERRUPTED, RecordingNotes

log = logging.getLogger("rosld.history")
STOPPED = "rosld ended while it was being made: it reaches until its last message."
KILLED = "rosld was ended by force while it was being made: it reaches until the last message that was on the disk."


class Interruptions:
    """The recordings that were interrupted, by name. Belongs to one loop."""

    def __init__(self, notes: RecordingNotes) -> None:
        self._notes = notes
        self._reasons: dict[str, str] = {}

    def load(self, names: Container[str]) -> None:
        """Take what was kept of the recordings of these names; of others, whose files are gone, it goes."""
        for name, members in self._notes.read(INTERRUPTED).items():
            if name in names:
                self._reasons[name] = str(members.get("why") or KILLED)
            else:
                try:
                    self._notes.remove(INTERRUPTED, name)
                except OSError as error:
                    log.warning("that %s was interrupted cannot be forgotten: %s", name, error)

    def reason(self, name: str) -> str | None:
        """Why a recording was interrupted, in a sentence; None for one that was not."""
        return self._reasons.get(name)

    async def add(self, name: str, why: str) -> None:
        """Keep that a recording was interrupted, as long as the server runs where that cannot be stored."""
        self._reasons[name] = why
        try:
            await asyncio.to_thread(self._notes.write, INTERRUPTED, name, {"why": why})
        except OSError as error:
            log.error("that the recording %s was interrupted cannot be stored: %s", name, error)

    async def remove(self, name: str) -> None:
        """Forget the interruption of a recording that is gone. Raises OSError."""
        if self._reasons.pop(name, None) is not None:
            await asyncio.to_thread(self._notes.remove, INTERRUPTED, name)
