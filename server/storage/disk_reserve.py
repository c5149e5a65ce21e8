"""A reserve of disk space, so that deletes still work on a full disk."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

NAME = "reserve"
SIZE = 4 * 1024 * 1024
"""Bytes: a deletion writes some pages to the log before it frees anything."""
LOW = 1024 * 1024
"""Bytes left on the disk at which it is taken for full."""


class DiskReserve:
    """A file in a folder that holds nothing but its place."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / NAME

    @property
    def is_full(self) -> bool:
        """Whether it holds its place."""
        try:
            found = self._path.stat()
        except OSError:
            return False
        return found.st_size == SIZE

    def fill(self) -> bool:
        """Take the place; whether it is taken, which it is not where the disk has less."""
        if self.is_full:
            return True
        try:
            file = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o600)
            try:
                _allocate(file)
            finally:
                os.close(file)
        except OSError:
            self.release()
            return False
        return True

    def release(self) -> None:
        """Give the place to whatever is written next."""
        with contextlib.suppress(OSError):
            self._path.unlink()


def free_bytes(folder: Path) -> int:
    """Bytes that may still be written to the disk of a folder. Raises OSError."""
    found = os.statvfs(folder)
    return found.f_bavail * found.f_frsize


def _allocate(file: int) -> None:
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(file, 0, SIZE)
    else:
        os.write(file, bytes(SIZE))
