"""Records in SQLite: in memory, or durably in a folder.

Reads run on the event loop and take tens of microseconds. In a folder, a thread writes on a connection of its own, with
one transaction for all waiting writes (`transactions.py`); SQLite syncs each before it is acknowledged.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import sqlite3
import time
from collections.abc import AsyncIterator, Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

from rosld.server.runtime.dry_run import end_dry_run, is_dry_run
from rosld.server.runtime.tasks import end_tasks
from rosld.server.storage.blobs import Blobs, ReceivedBlobs
from rosld.server.storage.files import LOW_BYTES, free_bytes, sync_folder
from rosld.server.storage.record import (
    Blob,
    Conflict,
    Member,
    Put,
    RecentWrites,
    Record,
    RecordCache,
    RecordChange,
    RecordWrite,
    StorageError,
    Write,
    check_write,
)
from rosld.server.storage.record_table import RecordTable
from rosld.server.storage.tables import FormerVersion, keep_versions, prepare_tables
from rosld.server.storage.transactions import Effects, GroupCommit, WriteBatch, with_list

_T = TypeVar("_T")
_log = logging.getLogger("rosld")

DATABASE = "records.sqlite"
BLOBS = "blobs"
ROOT = "data/"
KEEP_SECONDS = 600.0
"""Seconds until received bytes that no write refers to are discarded."""
CHECK_SECONDS = 0.5
"""Seconds between checks for changes by other processes."""
_OPEN_SECONDS = 10.0
"""Seconds to wait while another process writes."""
_CHANGES = 10_000


def open_records(
    folder: Path | None, *, roots: Sequence[str] = (), keep_seconds: float = KEEP_SECONDS, versions: int = 0
) -> Records:
    """Open or create the records in a folder, or in memory without one.

    `data/` and the `roots` are containers that always exist. `versions` is the number of former versions stored per
    document. Raises ValueError for an unusable database, OSError for an unusable folder.
    """
    return Records(folder, (ROOT, *roots), keep_seconds, versions)


def connect(folder: Path | None) -> sqlite3.Connection:
    """Return a connection to the database of a folder, created if missing. Raises ValueError if it is unusable."""
    path = ":memory:" if folder is None else str(folder / DATABASE)
    connection = sqlite3.connect(path, timeout=_OPEN_SECONDS, isolation_level=None, check_same_thread=False)
    try:
        for pragma in ("journal_mode = WAL", "synchronous = FULL", "temp_store = MEMORY"):
            connection.execute(f"PRAGMA {pragma}").fetchall()
        prepare_tables(connection, path)
    except sqlite3.DatabaseError as error:
        connection.close()
        raise ValueError(unusable_reason(path, error)) from error
    except BaseException:
        connection.close()
        raise
    return connection


def unusable_reason(path: str, error: Exception) -> str:
    """Return the message about a database that cannot be opened."""
    words = f"{path} cannot be used as the database of records: {error}"
    broken = any(word in str(error) for word in ("malformed", "not a database", "corrupt"))
    return f"{words}. Restore a dump into a new folder with `rosld load`" if broken else words


class Records:
    """All records of one server. Belongs to one event loop; reads take tens of microseconds and never wait.

    Reads and writes raise StorageError if the disk or the database fails, and can be repeated.
    """

    def __init__(self, folder: Path | None, roots: Sequence[str], keep_seconds: float, versions: int = 0) -> None:
        self._received = ReceivedBlobs(keep_seconds)
        self._cache = RecordCache()
        self._differences = RecentWrites()
        self._watchers: dict[object, Callable[[Sequence[RecordChange]], None]] = {}
        self._checking: asyncio.Task[None] | None = None
        self._group: GroupCommit | None = None
        self._freed: list[str] = []
        self._closed = False
        self._place = folder
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
        connection = connect(folder)
        try:
            keep_versions(connection, versions)
            self._writer = _Writer(connection, self._cache.peek, roots)
            self._reader = self._writer.table
            if folder is not None:
                self._keep_in(folder)
        except (sqlite3.DatabaseError, StorageError) as error:
            connection.close()
            raise ValueError(unusable_reason(str(folder), error)) from error
        except BaseException:
            connection.close()
            raise
        self.version = self._writer.table.version
        """Version of the last change; a change that also changes a container's list increases it twice."""

    def _keep_in(self, folder: Path) -> None:
        blobs = Blobs(folder / BLOBS, durable=True)
        blobs.sweep(self._reader.blob_ids)
        self._received.use(blobs)
        sync_folder(folder)
        self._reader = RecordTable(connect(folder))
        self._thread = ThreadPoolExecutor(1, "records")
        self._group = GroupCommit(self._transact)
        if self.failure is not None:
            _log.warning("%s", self.failure)

    @property
    def identity(self) -> str:
        """Random identifier of these records, created with them: versions are comparable only within one identity."""
        return self._reader.identity

    @property
    def failure(self) -> str | None:
        """Reason why writes cannot be stored at the moment, as a sentence for people, or None."""
        if self._place is None:
            return None
        if self._writer.failure is not None:
            return str(self._writer.failure)
        left = free_bytes(self._place)
        words = f"The data disk is full ({left} bytes left): delete what is not needed."
        return words if left < LOW_BYTES else None

    def get(self, path: str) -> Record | None:
        """Return a record: the same object until it changes or is evicted."""
        found = self._cache.get(path)
        if found is None:
            self._attach()
            found = self._reader.find(path)
            if found is not None:
                self._cache.put(found)
        return found

    def clear_cache(self) -> None:
        """Clear the cache, so that all records are read again."""
        self._cache.clear()
        self._differences.clear()

    def versions(self, path: str) -> Sequence[FormerVersion]:
        """Return the stored former versions of a document, oldest first."""
        return self._reader.versions(path)

    def version_at(self, path: str, time_ns: int) -> Record | None:
        """Return the version of a document at a time, or None if it did not exist or is not stored."""
        return self._reader.version_at(path, time_ns)

    def is_tombstone(self, path: str) -> bool:
        """Whether a record of this path was ever removed; the path may exist again."""
        return self._reader.is_tombstone(path)

    def members(self, path: str, *, after: int = 0, limit: int = 1000) -> Sequence[Member]:
        """Return the members of a container with numbers above `after`, in the order of numbers."""
        return self._reader.members(path, after, limit)

    def last_member_numbers(self, path: str, *, up_to: int | None = None, limit: int = 1000) -> Sequence[int]:
        """Return the numbers of the last members of a container (up to a number), newest first."""
        return self._reader.last_member_numbers(path, up_to, limit)

    def changes_since(self, after: int, *, limit: int = _CHANGES) -> Sequence[RecordChange]:
        """Return the changes after a version, each path with its latest version, in the order of versions.

        A path occurs once, or twice if it was removed and created again. Versions are unique: if there are `limit`
        changes, continue after the last.
        """
        return self._reader.changes_since(after, limit)

    def writes_since(self, record: Record, after: int) -> Sequence[RecordWrite] | None:
        """Return the writes that led from a version to this record, or None if they are unknown."""
        return self._differences.since(record, after)

    async def write(self, *writes: Write) -> Sequence[Record | None]:
        """Apply all of these writes or none; in a folder they are durable on return.

        Return the resulting records, None for removed ones. Raises Conflict, and ValueError for a write that is invalid
        in any state. Cancelling the wait does not cancel the writes.
        """
        if self._closed:
            raise StorageError("The records are closed.")
        for write in writes:
            check_write(write)
        if is_dry_run():
            await self._try(writes)
        end_dry_run()
        if self._group is None and len(writes) == 1:
            record = self._rewritten(writes[0])
            if record is not None:
                return [record]
        self._attach()
        batch = WriteBatch(writes, self._received.claim(_blob_ids(writes)))
        if self._group is not None:
            applied = await self._group.commit(batch)
        else:
            outcome = (await self._transact((batch,)))[0]
            if isinstance(outcome, Conflict):
                raise outcome
            applied = outcome
        return [applied.records.get(write.path) for write in writes]

    async def _try(self, writes: Sequence[Write]) -> None:
        """Apply writes, undo them, and discard the received blobs that they refer to. Raises Conflict, StorageError."""
        received = self._received.claim(_blob_ids(writes))

        try:
            outcome = await self._run(lambda: self._writer.attempt(writes, received))
            if isinstance(outcome, Conflict):
                raise outcome
        finally:
            self._received.keep(received)
        for id in received:
            self._received.discard(id)

    def _rewritten(self, write: Write) -> Record | None:
        """Apply a single write in memory that needs no transaction; return None if it needs one."""
        record = self._writer.table.apply_single(write, time.time_ns()) if isinstance(write, Put) else None
        if isinstance(write, Put) and record is not None:
            self._cache.put(record)
            self._differences.add(write, record)
            self.version = record.version
            self._wake([RecordChange(record.path, record.version, False)])
        return record

    async def _run(self, work: Callable[[], _T]) -> _T:
        """Run on the writer thread, or inline in memory."""
        if self._group is None:
            return work()
        return await asyncio.get_running_loop().run_in_executor(self._thread, work)

    async def _transact(self, batches: Sequence[WriteBatch]) -> Sequence[Effects | Conflict]:
        """Apply batches in one durable transaction; return the outcomes. Raises StorageError if none is applied."""
        try:
            foreign, outcomes = await self._run(lambda: self._writer.commit(batches))
        except BaseException:
            for batch in batches:
                self._received.keep(batch.received)
            raise
        if foreign:
            self._notice()
        self.version = max(self.version, self._writer.table.version)
        for batch, outcome in zip(batches, outcomes, strict=True):
            if isinstance(outcome, Effects):
                self._received.keep(outcome.unused)
                self._renew(outcome)
                self._note(batch.writes, outcome)
                self._notify(outcome)
                self._freed.extend(outcome.freed)
            else:
                self._received.keep(batch.received)
        if self._freed:  # after the cache update, so that no cached record refers to them
            await self._run(self._remove_freed)
        return outcomes

    def _remove_freed(self) -> None:
        """Remove the blobs that are no longer referenced, unless another process holds the files."""
        freed = self._freed[:]
        if freed and self._received.folder().remove(freed):
            del self._freed[: len(freed)]  # the event loop may have added more

    def _renew(self, applied: Effects) -> None:
        cache = self._cache
        for record in applied.records.values():
            cache.put(record)
        for path in applied.removed:
            cache.drop(path)
        for path, listed in applied.lists.items():
            if path not in applied.records:
                container = cache.get(path)
                if container is not None:
                    cache.put(with_list(container, listed))

    def _note(self, writes: Sequence[Write], applied: Effects) -> None:
        for write in writes:
            record = applied.records.get(write.path)
            if isinstance(write, Put) and record is not None:
                self._differences.add(write, record)

    async def receive(self, chunks: AsyncIterator[bytes], media_type: str, *, limit: int) -> Blob:
        """Store bytes as they are received, until a write refers to them. Raises ValueError beyond `limit` bytes.

        Blobs without a write are discarded after ten minutes; the blob of a refused write can be used in another one.
        """
        if self._closed:
            raise StorageError("The records are closed.")
        self._attach()
        return await self._received.receive(chunks, media_type, limit)

    def discard(self, blob: Blob) -> None:
        """Discard a blob unless a write refers to it."""
        self._received.discard(blob.id)

    def file(self, blob: Blob) -> Path:
        """Return the file of a blob. Raises FileNotFoundError if it was removed."""
        path = self._received.folder().path(blob.id)
        path.stat()
        return path

    def watch(self, wake: Callable[[Sequence[RecordChange]], None]) -> Callable[[], None]:
        """Call `wake` on the loop with the changes of each write; return the function that ends this.

        Changes by `rosld load` are reported within a second.
        """
        self._attach()
        watcher = object()
        self._watchers[watcher] = wake

        def end() -> None:
            self._watchers.pop(watcher, None)

        return end

    def _notify(self, applied: Effects) -> None:
        if self._watchers:
            self._wake(applied.changes())

    def _wake(self, changed: Sequence[RecordChange]) -> None:
        for wake in tuple(self._watchers.values()):
            try:
                wake(changed)
            except Exception:
                _log.exception("a watcher of records failed")

    def _attach(self) -> None:
        """Start to check for changes by other processes, on the running event loop."""
        if self._checking is None and self._group is not None and not self._closed:
            with contextlib.suppress(RuntimeError):  # no event loop runs yet
                self._checking = asyncio.get_running_loop().create_task(self._check_for_changes())

    async def _check_for_changes(self) -> None:
        while True:
            await asyncio.sleep(CHECK_SECONDS)
            try:
                if await self._run(self._check_once):
                    self._notice()
            except (sqlite3.Error, StorageError) as error:
                _log.error("the records cannot be read: %s", error)

    def _check_once(self) -> bool:
        """Retry the removal of blobs, and return whether another process has changed the records."""
        self._remove_freed()
        return self._writer.table.changed_elsewhere()

    def _notice(self) -> None:
        """Clear the cache and report the changes that another process made."""
        self.clear_cache()
        while changed := self._reader.changes_since(self.version, _CHANGES):
            self.version = changed[-1].version
            self._wake(changed)

    async def close(self) -> None:
        """Finish pending writes and close the database. Idempotent."""
        if self._closed:
            return
        self._received.discard_all()
        self._closed = True
        if self._checking is not None:
            await end_tasks([self._checking])
        if self._group is not None:
            await self._group.wait_idle()
            await asyncio.to_thread(self._thread.shutdown)
        for table in (self._reader, self._writer.table):
            await asyncio.to_thread(table.close)
        self._cache.clear()
        self._received.close()


class _Writer:
    """Writes in transactions, on a connection of its own. Used by one thread at a time.

    `table` reads the committed state. `failure` is the reason why all later writes fail.
    """

    def __init__(
        self, connection: sqlite3.Connection, cached: Callable[[str], Record | None], roots: Sequence[str]
    ) -> None:
        self._connection = connection
        self.table = RecordTable(connection, cached)
        self.failure: StorageError | None = None
        self.table.begin()
        for root in roots:
            self.table.create_root(root, time.time_ns())
        self.table.commit()

    def attempt(self, writes: Sequence[Write], received: Sequence[str]) -> Effects | Conflict:
        """Apply writes and undo them; return what their effects would be."""
        self.table.begin()
        try:
            return self.table.apply(writes, received, time.time_ns())
        finally:
            self.table.rollback()

    def commit(self, batches: Sequence[WriteBatch]) -> tuple[bool, Sequence[Effects | Conflict]]:
        """Apply batches durably; return whether another process has changed the database, and the outcomes.

        Raises StorageError; then no batch is applied.
        """
        if self.failure is not None:
            raise self.failure
        try:
            return self._commit(batches)
        except StorageError as error:
            if not error.full:
                raise
        # Restart the log in the space that it already has, which may be enough.
        with contextlib.suppress(sqlite3.Error):
            self._connection.execute("PRAGMA wal_checkpoint(RESTART)").fetchall()
        return self._commit(batches)

    def _commit(self, batches: Sequence[WriteBatch]) -> tuple[bool, Sequence[Effects | Conflict]]:
        table = self.table
        foreign = table.begin()
        try:
            now = time.time_ns()
            outcomes = [table.apply(batch.writes, batch.received, now) for batch in batches]
            table.commit()
        except StorageError as error:
            if not _is_failed_sync(error.__cause__):
                raise
            # After a failed sync the kernel marks the pages as clean, so that the next sync would succeed.
            _log.critical("the records cannot be stored: %s", error)
            words = f"{error} Nothing more is stored: check the disk, then restart rosld."
            self.failure = StorageError(f"{words} The writes just refused may then be present.", final=True)
            raise self.failure from error
        finally:
            table.rollback()
        return foreign, outcomes


def _is_failed_sync(error: BaseException | None) -> bool:
    """Whether SQLite failed to sync. Before Python 3.11, which exposes extended codes: whether the disk failed."""
    name = getattr(error, "sqlite_errorname", None)
    return "disk I/O error" in str(error) if name is None else name == "SQLITE_IOERR_FSYNC"


def _blob_ids(writes: Sequence[Write]) -> list[str]:
    return [write.blob.id for write in writes if isinstance(write, Put) and write.blob is not None]
