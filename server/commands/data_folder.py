"""The folder of `--data`: it belongs to one base URL, because its data is full of that URL."""

from __future__ import annotations

import os
from pathlib import Path

NAME = "base-url"


def claim(folder: Path, base: str) -> None:
    """Make the folder where it is missing, and this base its own.

    Raises ValueError where it belongs to another base, OSError where it cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    note = folder / NAME
    if not note.exists():
        return _write(note, base)
    owner = note.read_text("utf-8").strip()
    if owner != base:
        raise ValueError(f"the data in {folder} belongs to {owner}, not {base}: start with --base-url {owner}")
    return None


def _write(note: Path, base: str) -> None:
    """Whole or not at all: a note cut off by a crash would lock the folder for ever."""
    draft = note.with_name(f"{NAME}.{os.getpid()}")
    draft.write_text(base + "\n", "utf-8")
    draft.replace(note)
