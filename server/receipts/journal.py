"""The journal: all stored receipts, limited in number and age, in memory and in a database next to the records.

Recording a write delays its response by some microseconds. Entries are written to disk a moment later, in batches; an
orderly shutdown waits for that.
"""

from __future__ import annotations

import asyncio
import contextlib
import heapq
import logging
import os
import sqlite3
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import orjson

from rosld.ontology.describe_activities import Receipt
from rosld.server.receipts.audit import AuditEntry, new_identifier, receipt_of, touched_urls
from rosld.server.runtime.tasks import Signal

_log = logging.getLogger("rosld")

DATABASE = "receipts.sqlite"
_FORMAT = 1
_APPLICATION = 0x726F7372
"""Application ID of SQLite files with receipts ("rosr")."""
_OPEN_SECONDS = 5.0


class SqliteLog:
    """The database in a folder, created if missing.

    Raises ValueError for a damaged or foreign database; one that cannot be opened now is opened with the next write,
    and `problem` reports that.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / DATABASE
        self.problem: str | None = None
        """Sentence on why receipts are currently not written to disk, or None."""
        folder.mkdir(parents=True, exist_ok=True)
        self._connection: sqlite3.Connection | None = None
        try:
            self._connection = self._open()
        except sqlite3.OperationalError as error:  # usually a full disk, which is no reason not to serve
            self.report_failure(error)
        except sqlite3.Error as error:
            words = f"{self._path} cannot be used as the database of receipts: {error}"
            raise ValueError(f"{words}. Move it away to create a new one") from error
        self._thread = ThreadPoolExecutor(1, "receipts")

    @property
    def is_open(self) -> bool:
        """Whether the database can be read."""
        return self._connection is not None

    def report_failure(self, error: sqlite3.Error) -> None:
        """Log once that receipts cannot be written."""
        problem = f"Receipts cannot be written to disk ({error}) and are kept in memory for now."
        if problem != self.problem:
            _log.error("%s", problem)
        self.problem = problem

    def _open(self) -> sqlite3.Connection:
        try:  # readable by its owner only, as it shows the agents' actions
            os.close(os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600))
        except OSError as error:
            raise sqlite3.OperationalError(str(error)) from error
        try:
            return self._connect("NORMAL")
        except sqlite3.OperationalError:
            return self._connect("EXCLUSIVE")  # its index then needs no file, which a full disk has no room for

    def _connect(self, locking: str) -> sqlite3.Connection:
        connection = sqlite3.connect(self._path, timeout=_OPEN_SECONDS, isolation_level=None, check_same_thread=False)
        try:
            locked = f"locking_mode = {locking}"
            for pragma in (locked, "journal_mode = WAL", "synchronous = NORMAL", "secure_delete = ON"):
                connection.execute(f"PRAGMA {pragma}").fetchall()
            found, marked = (_number(connection, name) for name in ("user_version", "application_id"))
            if found > _FORMAT or (found and marked != _APPLICATION):
                raise ValueError(f"{self._path} is of a newer rosld or another program: choose another folder")
            if found != _FORMAT:
                connection.execute("BEGIN IMMEDIATE")
                connection.execute(
                    "CREATE TABLE IF NOT EXISTS receipt (number INTEGER PRIMARY KEY, told BLOB NOT NULL)"
                )
                connection.execute(f"PRAGMA application_id = {_APPLICATION}")
                connection.execute(f"PRAGMA user_version = {_FORMAT}")
                connection.execute("COMMIT")
        except BaseException:
            connection.close()
            raise
        return connection

    def load(self) -> list[Receipt]:
        """Return all receipts, oldest first, without unreadable ones; empty if the database is not open."""
        if self._connection is None:
            return []
        rows = self._connection.execute("SELECT told FROM receipt ORDER BY number")
        found = (_read(text) for (text,) in rows)
        return [receipt for receipt in found if receipt is not None]

    async def write(self, added: Iterable[Receipt], dropped: Sequence[int]) -> None:
        """Add and remove receipts in one transaction, in a thread that also iterates `added`.

        Afterwards they survive any end of the process. Raises sqlite3.Error.
        """
        await asyncio.get_running_loop().run_in_executor(self._thread, self._write, added, dropped)

    def _write(self, added: Iterable[Receipt], dropped: Sequence[int]) -> None:
        rows = [(receipt.number, orjson.dumps(receipt._asdict())) for receipt in added]
        if self._connection is None:
            try:
                self._connection = self._open()
            except ValueError as error:
                raise sqlite3.OperationalError(str(error)) from error
        connection = self._connection
        connection.execute("BEGIN IMMEDIATE")
        try:
            connection.executemany("INSERT OR REPLACE INTO receipt VALUES (?, ?)", rows)
            connection.executemany("DELETE FROM receipt WHERE number = ?", [(number,) for number in dropped])
            connection.execute("COMMIT")
        except BaseException:
            if connection.in_transaction:  # after a disk-full error it is rolled back already
                connection.execute("ROLLBACK")
            raise
        self.problem = None

    async def close(self) -> None:
        """Close the database. Idempotent."""
        await asyncio.get_running_loop().run_in_executor(None, self._close)

    def _close(self) -> None:
        self._thread.shutdown()
        if self._connection is not None:
            self._connection.close()


def _read(text: bytes) -> Receipt | None:
    try:
        members = orjson.loads(text)
        return Receipt(**{**members, "plan": tuple(members["plan"]), "touched": tuple(members["touched"])})
    except (ValueError, TypeError, KeyError):
        return None


def _number(connection: sqlite3.Connection, pragma: str) -> int:
    return int(connection.execute(f"PRAGMA {pragma}").fetchone()[0])


WRITE_SECONDS = 0.2
"""Seconds for which entries are gathered before they are written to disk: what a killed process may lose."""
_RETRY_SECONDS = 5.0
_EXPIRY_SECONDS = 60.0
"""Seconds between checks for expired entries."""
_REFUSED_PART = 5
"""Divisor of the limit for receipts of refused writes, so that a flood of these does not displace others."""


class JournalEntry:
    """One write in the journal; its receipt is made on first use (thread-safe)."""

    __slots__ = ("_audit_entry", "_excerpt_bytes", "_receipt", "ended_ns", "id", "is_refused", "number")

    def __init__(
        self, number: int, id: str, audit_entry: AuditEntry | None, excerpt_bytes: int, receipt: Receipt | None
    ) -> None:
        self.number = number
        self.id = id
        self._audit_entry = audit_entry
        self._excerpt_bytes = excerpt_bytes
        self._receipt = receipt
        known = receipt or audit_entry
        assert known is not None
        self.ended_ns = known.ended_ns
        self.is_refused = known.status >= 400

    @property
    def touched(self) -> Sequence[str] | None:
        """URLs that the write concerned, as far as the request and the steps name them.

        None if there may be more. Does not create the receipt. Thread-safe.
        """
        known = self._receipt
        if known is not None:
            return touched_urls(known.url, known.touched, known.made, known.status, known.length)
        audit_entry = self._audit_entry
        if audit_entry is None:  # another thread has just created the receipt
            return self.touched
        url = f"{audit_entry.url}?{audit_entry.query.decode('latin-1')}"
        return touched_urls(url, audit_entry.touched, audit_entry.created, audit_entry.status, audit_entry.length)

    @property
    def receipt(self) -> Receipt:
        """The receipt, created on first use: most are never read."""
        audit_entry, receipt = self._audit_entry, self._receipt
        if receipt is None:
            assert audit_entry is not None
            receipt = self._receipt = receipt_of(audit_entry, self.number, self.id, self._excerpt_bytes)
            self._audit_entry = None
        return receipt


class NoSuchReceipt(LookupError):
    """There is no receipt with this id, or it was removed."""


class Journal:
    """Journal of receipts, at most `limit` for `age` seconds; in memory without a folder. Belongs to one loop."""

    def __init__(self, folder: Path | None, *, limit: int, age: float, excerpt_bytes: int) -> None:
        self.changes = Signal()
        self.version = 1
        """Number that increases with each added or removed receipt; a receipt's number is the version that added it."""
        self._limit = {False: limit, True: max(1, limit // _REFUSED_PART)}
        self._age_ns = int(age * 1e9)
        self._excerpt_bytes = excerpt_bytes
        self._entries: dict[str, JournalEntry] = {}
        self._in_order: dict[bool, deque[JournalEntry]] = {False: deque(), True: deque()}
        self._dropped: Callable[[JournalEntry], None] = lambda entry: None
        self._disk = None if folder is None else SqliteLog(folder)
        self._unwritten: dict[int, JournalEntry] = {}
        self._deleted: list[int] = []
        self._write_timer: asyncio.TimerHandle | None = None
        self._writing: asyncio.Task[None] | None = None
        self._expiry_timer: asyncio.TimerHandle | None = None
        if self._disk is not None:
            for receipt in self._disk.load():
                self._keep(JournalEntry(receipt.number, receipt.id, None, 0, receipt))
                self.version = max(self.version, receipt.number)
            if not self._disk.is_open:  # higher than all numbers on disk
                self.version = time.time_ns() // 1000

    @property
    def failure(self) -> str | None:
        """Sentence on why receipts are currently not written to disk, None if they are."""
        return None if self._disk is None else self._disk.problem

    def start(self) -> None:
        """Start to remove expired entries."""
        self._expire()

    def add(self, audit_entry: AuditEntry, id: str | None = None) -> str:
        """Add a write and return the id of its receipt. It is written to disk soon, by `close` at the latest."""
        self.version += 1
        entry = JournalEntry(self.version, id or new_identifier(), audit_entry, self._excerpt_bytes, None)
        self._keep(entry)
        if self._disk is not None:
            self._unwritten[entry.number] = entry
            self._write_soon(WRITE_SECONDS)
        self.changes.emit()
        return entry.id

    def find(self, id: str) -> JournalEntry:
        """Return a write by the id of its receipt. Raises NoSuchReceipt."""
        try:
            return self._entries[id]
        except KeyError as error:
            raise NoSuchReceipt(id) from error

    def __len__(self) -> int:
        return len(self._entries)

    def newest_first(self) -> Iterator[JournalEntry]:
        """Yield all entries, newest first."""
        done, refused = (reversed(entries) for entries in self._in_order.values())
        return heapq.merge(done, refused, key=lambda entry: -entry.number)

    def after(self, number: int) -> Sequence[JournalEntry]:
        """Return the entries added after a number, oldest first."""
        found: list[JournalEntry] = []
        for entry in self.newest_first():
            if entry.number <= number:
                break
            found.append(entry)
        return found[::-1]

    def on_dropped(self, listener: Callable[[JournalEntry], None]) -> None:
        """Call the listener with each entry that is removed from now on."""
        self._dropped = listener

    async def close(self) -> None:
        """Write the remaining entries. Idempotent."""
        for timer in (self._write_timer, self._expiry_timer):
            if timer is not None:
                timer.cancel()
        if self._disk is None:
            return
        disk, self._disk = self._disk, None
        if self._writing is not None:
            await asyncio.wait({self._writing})
        with contextlib.suppress(sqlite3.Error):
            await self._write(disk)
        await disk.close()

    # --- storage

    def _keep(self, entry: JournalEntry) -> None:
        kind = entry.is_refused
        self._entries[entry.id] = entry
        self._in_order[kind].append(entry)
        if len(self._in_order[kind]) > self._limit[kind]:
            self._drop(kind)

    def _drop(self, kind: bool) -> None:
        entry = self._in_order[kind].popleft()
        del self._entries[entry.id]
        self.version += 1
        if self._disk is not None and self._unwritten.pop(entry.number, None) is None:
            self._deleted.append(entry.number)
        self._dropped(entry)

    def _expire(self) -> None:
        self._expiry_timer = asyncio.get_running_loop().call_later(_EXPIRY_SECONDS, self._expire)
        horizon, before = time.time_ns() - self._age_ns, self.version
        for kind, entries in self._in_order.items():
            while entries and entries[0].ended_ns < horizon:
                self._drop(kind)
        if self._deleted:
            self._write_soon(0.0)
        if self.version != before:
            self.changes.emit()

    # --- writing to disk

    def _write_soon(self, seconds: float) -> None:
        if self._write_timer is None and self._writing is None:
            self._write_timer = asyncio.get_running_loop().call_later(seconds, self._start_writing)

    def _start_writing(self) -> None:
        self._write_timer = None
        if self._disk is not None:
            self._writing = asyncio.get_running_loop().create_task(self._write_and_reschedule(self._disk))

    async def _write_and_reschedule(self, disk: SqliteLog) -> None:
        pause = WRITE_SECONDS
        try:
            await self._write(disk)
        except sqlite3.Error as error:
            disk.report_failure(error)
            pause = _RETRY_SECONDS
        finally:
            self._writing = None
        if self._unwritten or self._deleted:
            self._write_soon(pause)

    async def _write(self, disk: SqliteLog) -> None:
        """Write the new entries. Failures are retried with the next ones."""
        added, deleted = self._unwritten, self._deleted
        self._unwritten, self._deleted = {}, []
        try:
            await disk.write((entry.receipt for entry in added.values()), deleted)
        except sqlite3.Error:
            retried = {number: entry for number, entry in added.items() if entry.id in self._entries}
            self._unwritten = {**retried, **self._unwritten}
            self._deleted = [*deleted, *self._deleted]
            raise
