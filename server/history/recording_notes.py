"""What is kept of recordings beside their files: orders that wait for triggers, and which were interrupted."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import cast

import orjson

from rosld.server.storage.files import remove_note, write_note

log = logging.getLogger("rosld.history")
ARMED = ".armed"
"""What the name of a note of an order that waits for its trigger ends in."""
INTERRUPTED = ".interrupted"
"""What the name of a note of a recording that was interrupted ends in."""


class RecordingNotes:
    """The notes in a folder, each of one kind about the recording of one name. Without a folder none is kept."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder

    def read(self, kind: str) -> Mapping[str, Mapping[str, object]]:
        """The notes of a kind by name. What cannot be read is left where it is, with a warning."""
        if self._folder is None or not self._folder.is_dir():
            return {}
        found: dict[str, Mapping[str, object]] = {}
        for path in sorted(self._folder.glob(f"[!.]*{kind}")):
            try:
                members: object = orjson.loads(path.read_bytes())
                if not isinstance(members, dict):
                    raise ValueError("it is no object")
            except (OSError, ValueError) as error:
                log.warning("the note %s cannot be read: %s", path, error)
                continue
            found[path.name.removesuffix(kind)] = cast("dict[str, object]", members)
        return found

    def write(self, kind: str, name: str, members: Mapping[str, object]) -> None:
        """Write a note durably. Raises OSError."""
        if self._folder is not None:
            self._folder.mkdir(parents=True, exist_ok=True)
            write_note(self._folder / f"{name}{kind}", orjson.dumps(members))

    def remove(self, kind: str, name: str) -> None:
        """Remove a note durably, if there is one. Raises OSError."""
        if self._folder is not None and self._folder.is_dir():
            remove_note(self._folder / f"{name}{kind}")
