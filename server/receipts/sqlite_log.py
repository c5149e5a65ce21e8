"""Receipts on disk: a database of their own beside the records, written in batches by one thread."""

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
"""What marks a SQLite file as receipts of ours ("rosr")."""
_OPEN_SECONDS = 5.0


class SqliteLog:
    """The database in a folder, made where it is missing.

    Raises ValueError for one that is not sound, or of something else; one that the disk fails to open for now is opened
    when it is next written to, and `problem` says so.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / DATABASE
        self.problem: str | None = None
        """Why receipts are not on the disk for now, in a sentence."""
        folder.mkdir(parents=True, exist_ok=True)
        self._connection: sqlite3.Connection | None = None
        try:
            self._connection = self._open()
        except sqlite3.OperationalError as error:  # a full disk, as a rule: no reason not to serve
            self.report_failure(error)
        except sqlite3.Error as error:
            words = f"{self._path} cannot be used as the database of receipts: {error}"
            raise ValueError(f"{words}. Move it away to begin a new one") from error
        self._thread = ThreadPoolExecutor(1, "receipts")

    @property
    def is_open(self) -> bool:
        """Whether what it holds can be read."""
        return self._connection is not None

    def report_failure(self, error: sqlite3.Error) -> None:
        """Log once that receipts cannot be written."""
        problem = f"Receipts cannot be written to the disk ({error}), and are kept in memory until they can."
        if problem != self.problem:
            _log.error("%s", problem)
        self.problem = problem

    def _open(self) -> sqlite3.Connection:
        try:  # what people did is no one else's
            os.close(os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600))
        except OSError as error:
            raise sqlite3.OperationalError(str(error)) from error
        try:
            return self._connect("NORMAL")
        except sqlite3.OperationalError:
            return self._connect("EXCLUSIVE")  # its index needs no file then, for which a full disk has no place

    def _connect(self, locking: str) -> sqlite3.Connection:
        connection = sqlite3.connect(self._path, timeout=_OPEN_SECONDS, isolation_level=None, check_same_thread=False)
        try:
            locked = f"locking_mode = {locking}"
            for pragma in (locked, "journal_mode = WAL", "synchronous = NORMAL", "secure_delete = ON"):
                connection.execute(f"PRAGMA {pragma}").fetchall()
            found, marked = (_number(connection, name) for name in ("user_version", "application_id"))
            if found > _FORMAT or (found and marked != _APPLICATION):
                raise ValueError(f"{self._path} is of a newer rosld, or of something else: take another folder")
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
        """All receipts, the oldest first. What cannot be read any more is left out; all of it where it is not open."""
        if self._connection is None:
            return []
        rows = self._connection.execute("SELECT told FROM receipt ORDER BY number")
        found = (_read(told) for (told,) in rows)
        return [receipt for receipt in found if receipt is not None]

    async def write(self, added: Iterable[Receipt], dropped: Sequence[int]) -> None:
        """Add some and drop others in one transaction, away from the loop. `added` is gone through there as well.

        They survive the end of the process then, however it ends. Raises sqlite3.Error.
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
            if connection.in_transaction:  # a full disk has rolled back already
                connection.execute("ROLLBACK")
            raise
        self.problem = None

    async def close(self) -> None:
        """Finish. Idempotent."""
        await asyncio.get_running_loop().run_in_executor(None, self._close)

    def _close(self) -> None:
        self._thread.shutdown()
        if self._connection is not None:
            self._connection.close()


def _read(told: bytes) -> Receipt | None:
    try:
        members = orjson.loads(told)
        return Receipt(**{**members, "plan": tuple(members["plan"]), "touched": tuple(members["touched"])})
    except (ValueError, TypeError, KeyError):
        return None


def _number(connection: sqlite3.Connection, pragma: str) -> int:
    return int(connection.execute(f"PRAGMA {pragma}").fetchone()[0])
