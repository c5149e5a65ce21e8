"""Receipts on disk: a separate database next to the records, written in batches by one thread."""

from __future__ import annotations

import asyncio
import logging
import os
import sqlite3
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import orjson

from rosld.ontology.describe_activities import Receipt

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
