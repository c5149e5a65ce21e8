"""Notes: small files that are written whole or not at all, and durably."""

from __future__ import annotations

import os
from pathlib import Path

from rosld.server.storage.blobs import sync_folder


def write_note(path: Path, data: bytes) -> None:
    """Write a file, in the place of the one that is there. Raises OSError, and leaves that one as it was."""
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with draft.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        draft.replace(path)
        sync_folder(path.parent)
    except BaseException:
        draft.unlink(missing_ok=True)
        raise


def remove_note(path: Path) -> None:
    """Remove a file durably, if it is there. Raises OSError."""
    try:
        path.unlink()
    except FileNotFoundError:
        return
    sync_folder(path.parent)
