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
    """How far a log reaches: so many frames of pages of so many bytes. The salt is another one in each new log."""

    page: int
    frames: int
    salt: bytes

    @property
    def size(self) -> int:
        """Bytes up to the end of the last frame."""
        return _HEADER + self.frames * (_FRAME_HEADER + self.page) if self.frames else 0


class WriteAheadLog:
    """The files of the log of a database that is open elsewhere in this process.

    Closed only while no connection of this process is open: with the file go the locks that SQLite has on it.
    """

    def __init__(self, database: Path) -> None:
        self._log = os.open(f"{database}-wal", os.O_RDONLY | os.O_CLOEXEC)
        self._index = os.open(f"{database}-shm", os.O_RDONLY | os.O_CLOEXEC)

    def fileno(self) -> int:
        """The log's file."""
        return self._log

    def extent(self) -> LogExtent:
        """How far it reaches now; for whoever knows that nobody is writing."""
        return LogExtent(*_INDEX.unpack(os.pread(self._index, _INDEX.size, 0)))

    def size(self) -> int:
        """Bytes that the file has."""
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
    """Cut the log of a database that nobody has open after `extent`, durably. Raises OSError.

    Where the log has begun anew since, all of the old one is in the database, and of the new one nothing is kept.
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
