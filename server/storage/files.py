"""Files written durably, and locks on files."""

from __future__ import annotations

import fcntl
import os
import weakref
from pathlib import Path


class FileLock:
    """An open file that may be locked."""

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        _open.add(self)

    def acquire(self, *, shared: bool = False, wait: bool = False) -> bool:
        """Lock it, against all others or with others who share; whether that was possible."""
        kind = fcntl.LOCK_SH if shared else fcntl.LOCK_EX
        try:
            fcntl.flock(self._file, kind if wait else kind | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True

    def release(self) -> None:
        """Unlock it."""
        fcntl.flock(self._file, fcntl.LOCK_UN)

    def read(self) -> str:
        """Return the text that the holder wrote into the file."""
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


# A child that was forked would hold the locks for as long as it lives.
os.register_at_fork(after_in_child=_close_all)


def sync_folder(folder: Path) -> None:
    """Make the names in a folder durable."""
    handle = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


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


LOW_BYTES = 1024 * 1024
"""Bytes left on the disk at which it is taken for full."""


def free_bytes(folder: Path) -> int:
    """Return the number of bytes that can still be written to the disk of a folder. Raises OSError."""
    found = os.statvfs(folder)
    return found.f_bavail * found.f_frsize
