"""Files written durably, and locks on files."""

from __future__ import annotations

import fcntl
import os
import weakref
from pathlib import Path


class FileLock:
    """Lock on a file, which is open as long as the lock exists."""

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        _open.add(self)

    def acquire(self, *, shared: bool = False, wait: bool = False) -> bool:
        """Lock the file, exclusively or shared; return whether it was possible."""
        kind = fcntl.LOCK_SH if shared else fcntl.LOCK_EX
        try:
            fcntl.flock(self._file, kind if wait else kind | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True

    def release(self) -> None:
        """Unlock the file."""
        fcntl.flock(self._file, fcntl.LOCK_UN)

    def read(self) -> str:
        """Return the text of the file, as written by the holder of the lock."""
        return os.pread(self._file, 100, 0).decode("utf-8", "replace").strip()

    def write(self, text: str) -> None:
        """Replace the text of the file."""
        os.ftruncate(self._file, 0)
        os.pwrite(self._file, text.encode(), 0)

    def close(self) -> None:
        """Close the file, which unlocks it. Idempotent."""
        file, self._file = self._file, -1
        if file >= 0:
            os.close(file)


_open: weakref.WeakSet[FileLock] = weakref.WeakSet()


def _close_all() -> None:
    for lock in tuple(_open):
        lock.close()


# A forked child would hold the locks for as long as it lives.
os.register_at_fork(after_in_child=_close_all)


def sync_folder(folder: Path) -> None:
    """Make the names of the files in a folder durable."""
    handle = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_note(path: Path, data: bytes, mode: int = 0o666) -> None:
    """Write or replace a file atomically. Raises OSError; then the old file is unchanged."""
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with os.fdopen(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, mode), "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        draft.replace(path)
        sync_folder(path.parent)
    except BaseException:
        draft.unlink(missing_ok=True)
        raise


def remove_note(path: Path) -> None:
    """Remove a file durably, if it exists. Raises OSError."""
    try:
        path.unlink()
    except FileNotFoundError:
        return
    sync_folder(path.parent)


LOW_BYTES = 1024 * 1024
"""Free bytes below which the disk counts as full."""


def free_bytes(folder: Path) -> int:
    """Return the number of bytes that can still be written to the disk of a folder. Raises OSError."""
    status = os.statvfs(folder)
    return status.f_bavail * status.f_frsize
