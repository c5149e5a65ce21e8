"""SQLite's write-ahead log as a file: how far it reaches, and how what may not be on the disk is cut off.

After a failed fsync the system takes the pages for written: the next fsync succeeds, and what was lost stays lost
(https://www.postgresql.org/docs/current/wal-reliability.html). So the log is cut back to what was synced before, read
anew, and carried over into the database, which is synced itself. The layout of both files is documented at
https://www.sqlite.org/walformat.html.
"""

from __future__ import annotations

import contextlib
import os
import sqlite3
import struct
from pathlib import Path
from typing import NamedTuple

_HEADER = 32
"""Bytes before the first frame of the log; the salt is in bytes 16 to 23."""
_FRAME_HEADER = 24
_INDEX = struct.Struct("=14xHI12x8s")
"""The page size, the last frame and the salt, in the header of the log's index (-shm)."""


class LogExtent(NamedTuple):
    """Extent of a log: number of frames, and bytes per page. Each new log has another salt."""

    page: int
    frames: int
    salt: bytes

    @property
    def size(self) -> int:
        """The number of bytes up to the end of the last frame."""
        return _HEADER + self.frames * (_FRAME_HEADER + self.page) if self.frames else 0


class WriteAheadLog:
    """The files of the log of a database that is open elsewhere in this process.

    Closed only while no connection of this process is open: with the file go the locks that SQLite has on it.
    """

    def __init__(self, database: Path) -> None:
        self._log = os.open(f"{database}-wal", os.O_RDONLY | os.O_CLOEXEC)
        self._index = os.open(f"{database}-shm", os.O_RDONLY | os.O_CLOEXEC)

    def fileno(self) -> int:
        """Return the log's file."""
        return self._log

    def extent(self) -> LogExtent:
        """Return the current extent; must not run during a write."""
        return LogExtent(*_INDEX.unpack(os.pread(self._index, _INDEX.size, 0)))

    def size(self) -> int:
        """Return the size of the file in bytes."""
        return os.fstat(self._log).st_size

    def close(self) -> None:
        """Close the files. Idempotent."""
        files, self._log, self._index = {self._log, self._index} - {-1}, -1, -1
        for file in files:
            os.close(file)


def close_without_checkpoint(database: Path, connection: sqlite3.Connection) -> None:
    """Close the last connection of a database without carrying its log over. Idempotent.

    SQLite carries over when the last connection is closed, unless that one may only read. Raises sqlite3.Error.
    """
    reader = sqlite3.connect(f"{database.resolve().as_uri()}?mode=ro", uri=True, isolation_level=None)
    with contextlib.closing(reader):
        reader.execute("SELECT count(*) FROM sqlite_master").fetchall()
        connection.close()


def truncate(database: Path, extent: LogExtent) -> None:
    """Truncate the log of a closed database to `extent`, durably. Raises OSError.

    If the log was restarted since, the old one is in the database completely, and the new one is removed completely.
    """
    file = os.open(f"{database}-wal", os.O_RDWR | os.O_CLOEXEC)
    try:
        same = os.pread(file, _HEADER, 0)[16:24] == extent.salt
        os.ftruncate(file, min(os.fstat(file).st_size, extent.size if same else 0))
        os.fsync(file)
        if hasattr(os, "posix_fadvise"):
            os.posix_fadvise(file, 0, 0, os.POSIX_FADV_DONTNEED)  # what is read next comes from the disk
    finally:
        os.close(file)


def checkpoint(connection: sqlite3.Connection) -> bool:
    """Carry the log over into the database, have both on the disk, and let the log begin anew; whether that was done.

    False where somebody else reads or writes. Raises sqlite3.Error.
    """
    return int(connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()[0]) == 0


sync_file = getattr(os, "fdatasync", os.fsync)


class SyncedLog:
    """Syncs the log of a database that is open elsewhere, and cuts off what a failed sync left uncertain."""

    def __init__(self, database: Path) -> None:
        self._database = database
        self._log = WriteAheadLog(database)
        self._synced = self._written = self._log.extent()
        self._cut: LogExtent | None = None

    @property
    def needs_truncation(self) -> bool:
        """Whether a failed sync has left something to cut off, or it was cut off."""
        return self._cut is not None

    def note_written(self) -> None:
        """Record the extent of the log after a write."""
        self._written = self._log.extent()

    def sync(self) -> None:
        """Wait until what was noted is on the disk. Raises OSError; what is to be cut off is remembered then."""
        written = self._written
        try:
            self.flush()
        except OSError:
            # Where another process has written as well nothing is cut off: that would be lost too.
            self._cut = self._synced if self._log.extent() == written else None
            raise
        self._synced = written

    def flush(self) -> None:
        """Sync the file, regardless of earlier failures. Raises OSError."""
        sync_file(self._log.fileno())

    def size(self) -> int:
        """Return the size of the log in bytes."""
        return self._log.size()

    def truncate(self) -> None:
        """Close the files, and cut off what is not known to be on the disk. Raises OSError."""
        self._log.close()
        if self._cut is not None:
            truncate(self._database, self._cut)

    def open(self) -> None:
        """Open the files of the log again."""
        self._log = WriteAheadLog(self._database)

    def count_lost_frames(self) -> int:
        """Count the pages that the disk had taken and has lost all the same."""
        found, kept = self._log.extent(), self._cut
        return max(0, kept.frames - found.frames) if kept is not None and found.salt == kept.salt else 0

    def mark_all_synced(self) -> None:
        """Mark everything in the log as synced, after a checkpoint."""
        self._synced = self._written = self._log.extent()
        self._cut = None

    def close(self) -> None:
        """Close the files. Idempotent."""
        self._log.close()
