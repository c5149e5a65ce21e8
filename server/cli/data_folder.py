"""The folder of `--data`: bound to one base URL, the prefix of the IRIs in its data, and locked by one server."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from rosld.server.storage.files import FileLock, write_note

NAME = "base-url"
LOCK = "lock"
_MOMENT = 1.0
"""Seconds to wait for a killed process to release its lock."""


@contextmanager
def lock(folder: Path) -> Iterator[None]:
    """Hold the lock of the folder, which is created if missing, against other processes.

    Raises ValueError if another process still has the lock after a moment, and OSError if the folder is not writable. A
    lock file left by a dead process is no obstacle: its children release the lock when they run.
    """
    folder.mkdir(parents=True, exist_ok=True)
    lock = FileLock(folder / LOCK)
    try:
        if not _acquire(lock):
            raise ValueError(
                f"{folder} is served by another rosld (process {lock.read() or 'unknown'}): stop that one first, or "
                "choose another folder with --data"
            )
        with suppress(OSError):  # a full disk: the lock works without it
            lock.write(f"{os.getpid()}\n")
        yield
    finally:
        lock.close()


def _acquire(lock: FileLock) -> bool:
    end = time.monotonic() + _MOMENT
    while not lock.acquire():
        if time.monotonic() > end:
            return False
        time.sleep(0.02)
    return True


def read_base(folder: Path) -> str | None:
    """Return the base URL of a folder, None for a new one."""
    note = folder / NAME
    return note.read_text("utf-8").strip() if note.exists() else None


def bind_base(folder: Path, base: str) -> None:
    """Create the folder if missing, and bind it to this base URL.

    Raises ValueError if it belongs to another base URL, and OSError if it is not writable.
    """
    folder.mkdir(parents=True, exist_ok=True)
    found = read_base(folder)
    if found is None:
        write_note(folder / NAME, f"{base}\n".encode())
    elif found != base:
        raise ValueError(f"the data in {folder} belongs to {found}, not {base}: start with --base-url {found}")


def unbind(folder: Path) -> None:
    """Unbind an empty folder from its base URL."""
    (folder / NAME).unlink(missing_ok=True)
