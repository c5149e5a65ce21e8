"""Locks on files, which end with their process however it ends: what a dead process leaves behind holds nobody up."""

from __future__ import annotations

import os
import sys
import weakref
from pathlib import Path

if sys.platform != "win32":
    import fcntl


class FileLock:
    """An open file that may be locked. Where the system has no flock (Windows), it always is."""

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        _open.add(self)

    def acquire(self, *, shared: bool = False, wait: bool = False) -> bool:
        """Lock it, against all others or with others who share; whether that was possible."""
        if sys.platform == "win32":
            return True
        kind = fcntl.LOCK_SH if shared else fcntl.LOCK_EX
        try:
            fcntl.flock(self._file, kind if wait else kind | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True

    def release(self) -> None:
        """Unlock it."""
        if sys.platform != "win32":
            fcntl.flock(self._file, fcntl.LOCK_UN)

    def read(self) -> str:
        """What the holder wrote into the file."""
        return os.pread(self._file, 100, 0).decode("utf-8", "replace").strip()

    def write(self, text: str) -> None:
        """Write into the file, in place of what it held."""
        os.ftruncate(self._file, 0)
        os.pwrite(self._file, text.encode(), 0)

    def close(self) -> None:
        """Unlock it for good. Idempotent."""
        file, self._file = self._file, -1
        if file >= 0:
            os.close(file)


_open: weakref.WeakSet[FileLock] = weakref.WeakSet()


def _close_all() -> None:
    for lock in tuple(_open):
        lock.close()


if sys.platform != "win32":
    # A child that was forked would hold the locks for as long as it lives.
    os.register_at_fork(after_in_child=_close_all)
