"""The folder of `--data`: bound to one base URL, which is in the IRIs of its data, and locked by one server."""

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
"""Seconds that a process which was killed may take to be gone for good."""


@contextmanager
def lock(folder: Path) -> Iterator[None]:
    """Within it no other process serves the folder, which is made where it is missing.

    Raises ValueError where another process still does after a moment, OSError where the folder cannot be written. What
    a process that died left behind is no obstacle: a child of it lets go as soon as it comes to run.
    """
    folder.mkdir(parents=True, exist_ok=True)
    lock = FileLock(folder / LOCK)
    try:
        if not _acquire(lock):
            raise ValueError(
                f"{folder} is served by another rosld (process {lock.read() or 'unknown'}): "
                "end that one first, or give this one another folder with --data"
            )
        with suppress(OSError):  # a full disk: the lock holds without it
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
    """Return the base that a folder belongs to, None for one that belongs to none yet."""
    note = folder / NAME
    return note.read_text("utf-8").strip() if note.exists() else None


def bind_base(folder: Path, base: str) -> None:
    """Make the folder where it is missing, and this base its own.

    Raises ValueError where it belongs to another base, OSError where it cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    found = read_base(folder)
    if found is None:
        write_note(folder / NAME, f"{base}\n".encode())
    elif found != base:
        raise ValueError(f"the data in {folder} belongs to {found}, not {base}: start with --base-url {found}")


def unbind(folder: Path) -> None:
    """The folder, which holds nothing, belongs to no base any more."""
    (folder / NAME).unlink(missing_ok=True)
