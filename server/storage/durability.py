"""A reserve of disk space, so that deletes still work on a full disk."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import sqlite3
import threading
from collections.abc import Callable
from pathlib import Path

from rosld.server.storage.blobs import Blobs, storage_error
from rosld.server.storage.record import StorageError, is_disk_full
from rosld.server.storage.write_ahead_log import SyncedLog, checkpoint, close_without_checkpoint

_RESERVE_NAME = "reserve"
_RESERVE_BYTES = 4 * 1024 * 1024
"""Bytes: a deletion writes some pages to the log before it frees anything."""
LOW_BYTES = 1024 * 1024
"""Bytes left on the disk at which it is taken for full."""


class DiskReserve:
    """A file in a folder that only reserves space."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / _RESERVE_NAME

    @property
    def is_full(self) -> bool:
        """Whether the space is reserved."""
        try:
            found = self._path.stat()
        except OSError:
            return False
        return found.st_size == _RESERVE_BYTES

    def fill(self) -> bool:
        """Reserve the space; return False if the disk has less."""
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
        """Free the reserved space."""
        with contextlib.suppress(OSError):
            self._path.unlink()


def free_bytes(folder: Path) -> int:
    """Return the number of bytes that can still be written to the disk of a folder. Raises OSError."""
    found = os.statvfs(folder)
    return found.f_bavail * found.f_frsize


def _allocate(file: int) -> None:
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(file, 0, _RESERVE_BYTES)
    else:
        os.write(file, bytes(_RESERVE_BYTES))


_log = logging.getLogger("rosld")

LOG_BYTES = 8 * 1024 * 1024
"""How large the log grows before it is carried over into the database."""
_RETRY = 0.5
"""Seconds until files that somebody keeps still are looked at again."""
_BUSY_SECONDS = 0.05
"""Seconds to wait for readers when the log is to begin anew: no one can write meanwhile."""


class Durability:
    """Syncs writes to the disk on a thread. Belongs to one loop.

    `database` is open elsewhere, with a log that was just carried over.
    """

    def __init__(self, database: Path, blobs: Blobs, reserve: DiskReserve) -> None:
        self._log = SyncedLog(database)
        self.failure: StorageError | None = None
        """Why nothing can be acknowledged before `reopen` was successful."""
        self._database = database
        self._blobs = blobs
        self._reserve = reserve
        self._is_short = False
        self._at_work = threading.Lock()
        """Held while the thread is at the disk."""
        self._changed = threading.Condition()
        self._waiting: list[asyncio.Future[None]] = []
        self._freed: list[str] = []
        self._kept_still: list[str] = []
        self._ended = False
        self._carry_at = LOG_BYTES
        self._thread = threading.Thread(target=self._work, name="records", daemon=True)
        self._thread.start()

    def wait_synced(self, freed: list[str]) -> asyncio.Future[None]:
        """Done when everything written until now is on the disk; then these blobs are removed. Raises StorageError."""
        future = asyncio.get_running_loop().create_future()
        self._log.note_written()
        with self._changed:
            self._waiting.append(future)
            self._freed += freed
            self._changed.notify()
        return future

    async def close(self) -> None:
        """Finish what is waited for. Idempotent."""
        with self._changed:
            self._ended = True
            self._changed.notify()
        await asyncio.to_thread(self._thread.join)

    def closed(self) -> None:
        """Let go of the files: the database is not open any more. Idempotent."""
        self._log.close()

    def free_space(self, *, last: bool) -> None:
        """On a full disk: free the space of the log, and as the `last` resort the reserve."""
        with self._at_work:
            self._is_short = True
            self._carry_over()
            if last:
                self._reserve.release()

    def can_sync(self) -> bool:
        """Whether the disk syncs again; it says nothing of what it failed to sync before."""
        with self._at_work:
            try:
                self._log.flush()
            except OSError:
                return False
        return True

    def reopen(self, connection: sqlite3.Connection, connect: Callable[[], sqlite3.Connection]) -> sqlite3.Connection:
        """Open the database anew without what was not synced; `failure` is None then, and why not otherwise.

        `connection` must be the only one of this process; the one returned may be read in any case. Raises ValueError
        where there is none.
        """
        with self._at_work, self._blobs.try_removal_lock() as alone:
            if not alone:
                self.failure = StorageError(
                    f"{self.failure} The log is opened anew when `rosld dump` or load has ended."
                )
                return connection
            try:
                close_without_checkpoint(self._database, connection)
            except sqlite3.Error as error:
                return self._not_reopened(error, connection)
            wrong: Exception | None = None
            try:
                self._log.truncate()
            except OSError as error:
                wrong = error
            connection = connect()
            self._log.open()
            if wrong is not None:
                return self._not_reopened(wrong, connection)
            if lost := self._log.count_lost_frames():
                _log.critical("the disk has lost the last %d pages that it had taken: what they held is gone", lost)
            try:
                if not checkpoint_with_reserve(connection, self._reserve):
                    raise sqlite3.OperationalError("something else reads the database")
            except sqlite3.Error as error:
                if not self._log.needs_truncation or not is_disk_full(error):  # what was not cut off is on the disk
                    return self._not_reopened(error, connection)
            self._log.mark_all_synced()
            self.failure = None
            return connection

    def _not_reopened(self, error: Exception, connection: sqlite3.Connection) -> sqlite3.Connection:
        _log.error("the log of records cannot be opened anew: %s", error)
        self.failure = StorageError(f"Nothing can be kept until the disk works again: {error}.")
        return connection

    def _work(self) -> None:
        while True:
            with self._changed:
                if not (self._waiting or self._ended):
                    self._changed.wait(_RETRY if self._kept_still else None)
                waiting, self._waiting = self._waiting, []
                freed, self._freed = self._freed, []
                ended = self._ended
            with self._at_work:
                error = self._sync() if waiting else None
            _tell(waiting, error)
            # After a failed sync a record that is not durable may be undone, and then needs the blobs that it set free.
            if self.failure is None:
                with self._at_work:
                    self._remove(freed)
                    self._tidy_up()
            if ended and not waiting:
                return

    def _sync(self) -> StorageError | None:
        try:
            self._log.sync()
        except OSError as error:
            _log.error("the log of records could not be synced, and is opened anew: %s", error)
            self.failure = storage_error(error)
            return self.failure
        return None

    def _tidy_up(self) -> None:
        """Carry a long log over; where the disk was full any log, and set room aside again."""
        if self._is_short:
            self._carry_over()
            self._is_short = not self._reserve.fill()
        elif self._log.size() >= self._carry_at:
            self._carry_over()

    def _remove(self, freed: list[str]) -> None:
        self._kept_still += freed
        if self._kept_still and self._blobs.remove(self._kept_still):
            self._kept_still = []

    def _carry_over(self) -> None:
        """Carry the log over into the database, most of it while others write, and let it begin anew."""
        try:
            with contextlib.closing(sqlite3.connect(self._database, timeout=_BUSY_SECONDS)) as connection:
                connection.execute("PRAGMA synchronous = NORMAL")
                connection.execute("PRAGMA wal_checkpoint(PASSIVE)")
                connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        except sqlite3.Error as error:
            _log.warning("the log of records could not be carried over, it goes on growing: %s", error)
        # Where a reader holds on to the log it is tried again after as much again.
        self._carry_at = self._log.size() + LOG_BYTES


def checkpoint_with_reserve(connection: sqlite3.Connection, reserve: DiskReserve) -> bool:
    """Carry the log over; where the disk is full at the expense of what is set aside. Raises sqlite3.Error."""
    try:
        return checkpoint(connection)
    except sqlite3.Error:
        if not reserve.is_full:
            raise
        reserve.release()
        return checkpoint(connection)
    finally:
        reserve.fill()


def _tell(waiting: list[asyncio.Future[None]], error: StorageError | None) -> None:
    if not waiting:
        return

    def settle() -> None:
        for future in waiting:
            if future.done():
                continue
            if error is None:
                future.set_result(None)
            else:
                future.set_exception(error)

    with contextlib.suppress(RuntimeError):  # the loop has ended
        waiting[0].get_loop().call_soon_threadsafe(settle)
