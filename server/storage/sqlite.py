"""Records in SQLite: in memory, or durably in a folder.

Everything is read and written on the loop, which takes tens of microseconds. In a folder SQLite writes to its log
without waiting for the disk; a thread does that wait (`durability.py`), for all writes that come meanwhile at once
(`transactions.py`), and they are acknowledged after it.
"""

from __future__ import annotations

import asyncio
import logging
import sqlite3
import time
from collections.abc import AsyncIterator, Callable, Sequence
from pathlib import Path

from rosld.server.runtime.dry_run import end_dry_run, is_dry_run
from rosld.server.storage.blobs import Blobs, ReceivedBlobs
from rosld.server.storage.durability import LOW_BYTES, DiskReserve, Durability, checkpoint_with_reserve, free_bytes
from rosld.server.storage.files import sync_folder
from rosld.server.storage.record import (
    Blob,
    Conflict,
    DatabaseBusy,
    Member,
    Put,
    Record,
    RecordChange,
    Remove,
    StorageError,
    Write,
    check_write,
    is_disk_full,
)
from rosld.server.storage.record_cache import RecentWrites, RecordCache, RecordWrite
from rosld.server.storage.record_table import RecordTable
from rosld.server.storage.tables import FormerVersion, keep_versions, prepare_tables, read_pragma
from rosld.server.storage.transactions import Effects, GroupCommit, WriteBatch, with_list
from rosld.server.storage.write_ahead_log import close_without_checkpoint

_log = logging.getLogger("rosld")

DATABASE = "records.sqlite"
BLOBS = "blobs"
ROOT = "data/"
KEEP_SECONDS = 600.0
"""How long received bytes are kept that no write refers to."""
CHECK_SECONDS = 0.5
"""Between two looks at whether another process has changed the records."""
_OPEN_SECONDS = 10.0
_CHANGES = 10_000
_SPARE_PAGES = 16
"""Pages that a write may need beside its triples."""


def open_records(
    folder: Path | None, *, roots: Sequence[str] = (), keep_seconds: float = KEEP_SECONDS, versions: int = 0
) -> Records:
    """Open or create the records in a folder, or in memory without one.

    `data/` and the `roots` are containers that always exist. `versions` is the number of former versions kept of each
    document. Raises ValueError for an unusable database, OSError for an unusable folder.
    """
    return Records(folder, (ROOT, *roots), keep_seconds, versions)


def connect(folder: Path | None) -> sqlite3.Connection:
    """Return a connection to the database of a folder, created if missing. Raises ValueError if it is unusable."""
    path = ":memory:" if folder is None else str(folder / DATABASE)
    connection = sqlite3.connect(path, timeout=_OPEN_SECONDS, isolation_level=None, check_same_thread=False)
    try:
        for pragma in ("journal_mode = WAL", "synchronous = NORMAL", "wal_autocheckpoint = 0", "temp_store = MEMORY"):
            connection.execute(f"PRAGMA {pragma}").fetchall()
        prepare_tables(connection, path)
    except sqlite3.DatabaseError as error:
        connection.close()
        raise ValueError(unusable_reason(path, error)) from error
    except BaseException:
        connection.close()
        raise
    return connection


def _connect_where_full(folder: Path) -> sqlite3.Connection:
    """As `connect`, where the disk is full at the expense of what is set aside."""
    try:
        return connect(folder)
    except ValueError:
        reserve = DiskReserve(folder)
        if not reserve.is_full or free_bytes(folder) >= LOW_BYTES:
            raise
        reserve.release()
        return connect(folder)


def unusable_reason(path: str, error: Exception) -> str:
    """Return the message about a database that cannot be opened."""
    words = f"{path} cannot be used as the database of records: {error}"
    broken = any(word in str(error) for word in ("malformed", "not a database", "corrupt"))
    return f"{words}. Bring a dump back into a new folder with `rosld load`" if broken else words


class Records:
    """All records of one server. Belongs to one loop; reads take tens of microseconds and never wait.

    Reads and writes raise StorageError if the disk or the database fails, and can be repeated.
    """

    def __init__(self, folder: Path | None, roots: Sequence[str], keep_seconds: float, versions: int = 0) -> None:
        self._received = ReceivedBlobs(keep_seconds)
        self._cache = RecordCache()
        self._differences = RecentWrites()
        self._watchers: dict[object, Callable[[Sequence[RecordChange]], None]] = {}
        self._look: asyncio.TimerHandle | None = None
        self._durability: Durability | None = None
        self._group: GroupCommit | None = None
        self._undone: set[str] = set()
        self._closed = False
        self._place = folder
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
        self._connection = _connect_where_full(folder) if folder is not None else connect(None)
        try:
            keep_versions(self._connection, versions)
            self._table = RecordTable(self._connection, self._cache.get)
            self._make_roots(roots)
            if folder is not None:
                self._keep_in(folder)
        except (sqlite3.DatabaseError, StorageError, DatabaseBusy) as error:
            self._connection.close()
            raise ValueError(unusable_reason(str(folder), error)) from error
        except BaseException:
            self._connection.close()
            raise
        self._told = self._table.version

    def _make_roots(self, roots: Sequence[str]) -> None:
        self._table.begin()
        for root in roots:
            self._table.create_root(root, time.time_ns())
        self._table.commit()

    def _keep_in(self, folder: Path) -> None:
        self._connection.execute("PRAGMA busy_timeout = 0")  # from now on the loop waits, not SQLite
        blobs = Blobs(folder / BLOBS, durable=True)
        blobs.sweep(self._table.blob_ids)
        self._received.use(blobs)
        sync_folder(folder)
        reserve = DiskReserve(folder)
        try:
            # What a process that was killed had written may not be on the disk, whatever a sync of the log says now.
            checkpoint_with_reserve(self._connection, reserve)
        except sqlite3.Error as error:
            if not is_disk_full(error):
                raise
            _log.warning("the log of records cannot be carried over: %s", error)
        self._durability = Durability(folder / DATABASE, blobs, reserve)
        self._group = GroupCommit(self)
        if self.failure is not None:
            _log.warning("%s", self.failure)

    @property
    def identity(self) -> str:
        """A random name of these records, made once and kept with them: versions are only of one identity."""
        return self._table.identity

    @property
    def version(self) -> int:
        """The number of the last change; it rises with each, by more than one where a container lists anew."""
        return self._table.version

    @property
    def failure(self) -> str | None:
        """Why not everything can be kept just now, in a sentence for people; None where it can."""
        if self._durability is None or self._place is None:
            return None
        if self._durability.failure is not None:
            return str(self._durability.failure)
        left = free_bytes(self._place)
        words = f"The disk that holds the data is full, {left} bytes are left: delete what is not needed."
        return words if left < LOW_BYTES else None

    def get(self, path: str) -> Record | None:
        """Return a record: the same object until it changes or is evicted."""
        found = self._cache.get(path)
        if found is None:
            self._attach()
            found = self._table.find(path)
            if found is not None:
                self._cache.put(found)
        return found

    def clear_cache(self) -> None:
        """Read everything anew from now on."""
        self._cache.clear()
        self._differences.clear()

    def versions(self, path: str) -> Sequence[FormerVersion]:
        """Return the former versions of a document that are kept, the oldest first."""
        return self._table.versions(path)

    def version_at(self, path: str, time_ns: int) -> Record | None:
        """Return the version of a document at a time, or None if it did not exist or was not kept."""
        return self._table.version_at(path, time_ns)

    def is_tombstone(self, path: str) -> bool:
        """Whether a record of this path was ever removed; one may be there again."""
        return self._table.is_tombstone(path)

    def members(self, path: str, *, after: int = 0, limit: int = 1000) -> Sequence[Member]:
        """Return the members of a container in the order of their numbers, those after one of them."""
        return self._table.members(path, after, limit)

    def last_member_numbers(self, path: str, *, up_to: int | None = None, limit: int = 1000) -> Sequence[int]:
        """Return the numbers of the last members of a container (up to a number), the newest first."""
        return self._table.last_member_numbers(path, up_to, limit)

    def changes_since(self, after: int, *, limit: int = _CHANGES) -> Sequence[RecordChange]:
        """Return the changes after a version, each path with its latest version, in the order of versions.

        A path occurs once, or twice if it was removed and created again. Versions are unique: if there are `limit`
        changes, continue after the last.
        """
        return self._table.changes_since(after, limit)

    def writes_since(self, record: Record, after: int) -> Sequence[RecordWrite] | None:
        """Return the writes that led from a version to this record, or None if they are unknown."""
        return self._differences.since(record, after)

    async def write(self, *writes: Write) -> Sequence[Record | None]:
        """Do these writes, all or none; in a folder they are durable on return.

        Return the resulting records, None for removed ones. Raises Conflict, and ValueError for a write that is invalid
        in any state. Cancelling the wait does not cancel the writes.
        """
        if self._closed:
            raise StorageError("The records are closed.")
        for write in writes:
            check_write(write)
        if is_dry_run():
            self._try(writes)
        end_dry_run()
        if self._group is None and len(writes) == 1:
            record = self._rewritten(writes[0])
            if record is not None:
                return [record]
        self._attach()
        job = WriteBatch(writes, self._received.claim(_blob_ids(writes)))
        if self._group is not None:
            applied = await self._group.commit(job)
        else:
            outcome = self.transact((job,))[0]
            if isinstance(outcome, Conflict):
                raise outcome
            applied = outcome
            if applied.freed:
                self._received.folder().remove(applied.freed)
        return [applied.records.get(write.path) for write in writes]

    def _try(self, writes: Sequence[Write]) -> None:
        """Do writes, undo them, and discard the received blobs that they refer to. Raises Conflict, StorageError."""
        received = self._received.claim(_blob_ids(writes))
        try:
            if self._table.begin():
                self._notice()
            outcome = self._table.apply(writes, received, time.time_ns())
            if isinstance(outcome, Conflict):
                raise outcome
        except DatabaseBusy:  # another process writes: what it makes of this is not known
            pass
        finally:
            self._table.rollback()
            self._received.keep(received)
        for id in received:
            self._received.discard(id)

    def _rewritten(self, write: Write) -> Record | None:
        """Do a single write in memory that needs no transaction; return None if it needs one."""
        record = self._table.apply_single(write, time.time_ns()) if isinstance(write, Put) else None
        if isinstance(write, Put) and record is not None:
            self._cache.put(record)
            self._differences.add(write, record)
            self._told = record.version
            self._wake([RecordChange(record.path, record.version, False)])
        return record

    def transact(self, jobs: Sequence[WriteBatch]) -> Sequence[Effects | Conflict]:
        """Do jobs in one transaction: what came of each. Raises DatabaseBusy, StorageError, with none of them done."""
        try:
            outcomes = self._commit(jobs)
        except BaseException as error:
            if not isinstance(error, DatabaseBusy):
                for job in jobs:
                    self._received.keep(job.received)
            raise
        for job, outcome in zip(jobs, outcomes, strict=True):
            if isinstance(outcome, Effects):
                self._received.keep(outcome.unused)
                self._renew(outcome)
                self._note(job.writes, outcome)
                self._tell(outcome)
            else:
                self._received.keep(job.received)
        return outcomes

    def _commit(self, jobs: Sequence[WriteBatch]) -> Sequence[Effects | Conflict]:
        table = self._table
        foreign = table.begin()
        try:
            if foreign:
                self._notice()
            now = time.time_ns()
            outcomes = [table.apply(job.writes, job.received, now) for job in jobs]
            table.commit()
        except BaseException:
            table.rollback()
            raise
        return outcomes

    async def wait_durable(self, applied: Sequence[Effects]) -> None:
        """Wait until what was done is durable. Raises StorageError where it is not, and was undone if possible."""
        assert self._durability is not None
        try:
            await self._durability.wait_synced([id for each in applied for id in each.freed])
        except StorageError:
            for each in applied:
                self._undone.update(each.records, each.removed, each.lists)
                self._received.keep(record.blob.id for record in each.records.values() if record.blob is not None)
            await self._reopen()
            raise

    async def recover(self) -> None:
        """See to it that writes can be made durable. Raises StorageError where they cannot."""
        assert self._durability is not None
        if self._durability.failure is not None and await asyncio.to_thread(self._durability.can_sync):
            await self._reopen()
        if self._durability.failure is not None:
            raise self._durability.failure

    async def _reopen(self) -> None:
        """Go on with a database opened anew, without what was undone. While it is opened nothing can be read."""
        assert self._durability is not None
        former = self._table
        former.suspend("its log is being opened anew, try again")
        self.clear_cache()
        try:
            self._connection = await asyncio.to_thread(
                self._durability.reopen, self._connection, lambda: connect(self._place)
            )
        except ValueError as error:
            _log.error("%s", error)
            return
        self._connection.execute("PRAGMA busy_timeout = 0")
        self._table = RecordTable(self._connection, self._cache.get)
        undone = () if self._durability.failure is not None else tuple(self._undone)
        try:
            self._table.take_over(former, undone)
        except (StorageError, DatabaseBusy) as error:
            _log.error("what was not kept may still be found by queries: %s", error)
        self._undone.difference_update(undone)
        self._notice()

    async def free_space(self, job: WriteBatch) -> None:
        """Make what room there can be for a job that found the disk full.

        What is set aside is for what deletes, and for what fits into the place of what was deleted.
        """
        assert self._durability is not None
        pages, size = (read_pragma(self._connection, name) for name in ("freelist_count", "page_size"))
        fits = job.size + job.size // 8 + _SPARE_PAGES * size <= pages * size
        last = fits or all(isinstance(write, Remove) for write in job.writes)
        await asyncio.to_thread(self._durability.free_space, last=last)

    def _renew(self, applied: Effects) -> None:
        """Bring the cache up to date."""
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
        """Note what the writes changed of records."""
        for write in writes:
            record = applied.records.get(write.path)
            if isinstance(write, Put) and record is not None:
                self._differences.add(write, record)

    async def receive(self, chunks: AsyncIterator[bytes], media_type: str, *, limit: int) -> Blob:
        """Keep bytes as they come, until a write refers to them. Raises ValueError beyond `limit` bytes.

        What no write refers to within ten minutes is thrown away; what was refused in a write may be tried in another.
        """
        if self._closed:
            raise StorageError("The records are closed.")
        self._attach()
        return await self._received.receive(chunks, media_type, limit)

    def discard(self, blob: Blob) -> None:
        """Throw away received bytes that no write refers to; of other blobs it leaves everything as it is."""
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

    def _tell(self, applied: Effects) -> None:
        self._told = max(self._told, self._table.version)
        if self._watchers:
            self._wake(applied.changes())

    def _wake(self, changed: Sequence[RecordChange]) -> None:
        for wake in tuple(self._watchers.values()):
            try:
                wake(changed)
            except Exception:
                _log.exception("a watcher of records failed")

    def _attach(self) -> None:
        """Look from now on, on this loop, at whether another process has changed something."""
        if self._look is None and self._durability is not None and not self._closed:
            try:
                loop = asyncio.get_running_loop()
            except RuntimeError:
                return  # not on a loop yet
            self._look = loop.call_later(CHECK_SECONDS, self._look_again)

    def _look_again(self) -> None:
        self._look = asyncio.get_running_loop().call_later(CHECK_SECONDS, self._look_again)
        try:
            if self._durability is not None and self._durability.failure is not None and self._group is not None:
                self._group.recover()
            elif self._table.changed_elsewhere():
                self._notice()
        except (sqlite3.Error, StorageError) as error:
            _log.error("the records cannot be read: %s", error)

    def _notice(self) -> None:
        """Clear the cache and report the changes that another process made."""
        self.clear_cache()
        while changed := self._table.changes_since(self._told, _CHANGES):
            self._told = changed[-1].version
            self._wake(changed)

    def _close_connection(self) -> None:
        """Close it, which carries the log over, but not what could not be synced."""
        if self._place is None or self._durability is None or self._durability.failure is None:
            self._connection.close()
            return
        try:
            close_without_checkpoint(self._place / DATABASE, self._connection)
        except sqlite3.Error as error:
            _log.error("the log of records may hold what was refused: %s", error)

    async def close(self) -> None:
        """Finish what is under way. Idempotent."""
        if self._closed:
            return
        self._received.discard_all()
        self._closed = True
        if self._look is not None:
            self._look.cancel()
        if self._group is not None:
            await self._group.wait_idle()
        if self._durability is not None:
            await self._durability.close()
        await asyncio.to_thread(self._close_connection)
        if self._durability is not None:
            self._durability.closed()
        self._cache.clear()
        self._received.close()


def _blob_ids(writes: Sequence[Write]) -> list[str]:
    return [write.blob.id for write in writes if isinstance(write, Put) and write.blob is not None]
