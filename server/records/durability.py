"""Durability: one thread that waits for the disk, for as many writes at a time as have come meanwhile.

SQLite has written them to its log (in WAL mode, without waiting), so they survive the end of the process already. They
are acknowledged once the log has reached the disk, and what they set free is removed only then.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import sqlite3
import threading
from pathlib import Path

from rosld.server.records.blobs import Blobs, failure
from rosld.server.records.record import StorageError

_log = logging.getLogger("rosld")

LOG_BYTES = 8 * 1024 * 1024
"""How large the log grows before it is carried over into the database."""
_RETRY = 0.5
"""Seconds until files that somebody keeps still are looked at again."""
_BUSY_SECONDS = 0.05
"""Seconds to wait for readers when the log is to begin anew: no one can write meanwhile."""
_sync = getattr(os, "fdatasync", os.fsync)


class Durability:
    """Belongs to one loop. `database` is open elsewhere, so that its log is there."""

    def __init__(self, database: Path, blobs: Blobs) -> None:
        self._file = os.open(f"{database}-wal", os.O_RDONLY | os.O_CLOEXEC)
        self._database = database
        self._blobs = blobs
        self._changed = threading.Condition()
        self._waiting: list[asyncio.Future[None]] = []
        self._freed: list[str] = []
        self._kept_still: list[str] = []
        self._ended = False
        self._carry_at = LOG_BYTES
        self._thread = threading.Thread(target=self._work, name="records", daemon=True)
        self._thread.start()

    def reached(self, freed: list[str]) -> asyncio.Future[None]:
        """Done when everything written until now is on the disk; then these blobs are removed. Raises StorageError."""
        future = asyncio.get_running_loop().create_future()
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
        file, self._file = self._file, -1
        if file >= 0:
            os.close(file)

    def _work(self) -> None:
        while True:
            with self._changed:
                if not (self._waiting or self._ended):
                    self._changed.wait(_RETRY if self._kept_still else None)
                waiting, self._waiting = self._waiting, []
                freed, self._freed = self._freed, []
                ended = self._ended
            error = self._synced() if waiting else None
            _tell(waiting, error)
            if error is None:
                self._remove(freed)
                self._carry_over()
            if ended and not waiting:
                return

    def _synced(self) -> StorageError | None:
        try:
            _sync(self._file)
        except OSError as error:
            _log.error("the log of records could not be synced: %s", error)
            return failure(error)
        return None

    def _remove(self, freed: list[str]) -> None:
        self._kept_still += freed
        if self._kept_still and self._blobs.remove(self._kept_still):
            self._kept_still = []

    def _carry_over(self) -> None:
        """Carry a long log over into the database, most of it while others write, and let it begin anew."""
        if os.fstat(self._file).st_size < self._carry_at:
            return
        try:
            with contextlib.closing(sqlite3.connect(self._database, timeout=_BUSY_SECONDS)) as connection:
                connection.execute("PRAGMA synchronous = NORMAL")
                connection.execute("PRAGMA wal_checkpoint(PASSIVE)")
                connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        except sqlite3.Error as error:
            _log.warning("the log of records could not be carried over, it goes on growing: %s", error)
        # Where a reader holds on to the log it is tried again after as much again.
        self._carry_at = os.fstat(self._file).st_size + LOG_BYTES


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
