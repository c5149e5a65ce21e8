"""Receipts on the disk: a database of their own beside the records, written by one thread, some at a time."""

from __future__ import annotations

import asyncio
import os
import sqlite3
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import orjson

from rosld.ontology.describe_activities import Receipt

DATABASE = "receipts.sqlite"
_FORMAT = 1
_APPLICATION = 0x726F7372
"""What marks a SQLite file as receipts of ours ("rosr")."""
_OPEN_SECONDS = 5.0


class Disk:
    """The database in a folder, made where it is missing. Raises ValueError for one that cannot be used."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / DATABASE
        folder.mkdir(parents=True, exist_ok=True)
        os.close(os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600))  # what people did is no one else's
        try:
            self._connection = self._opened()
        except sqlite3.Error as error:
            words = f"{self._path} cannot be used as the database of receipts: {error}"
            raise ValueError(f"{words}. Move it away to begin a new one") from error
        self._thread = ThreadPoolExecutor(1, "receipts")

    def _opened(self) -> sqlite3.Connection:
        connection = sqlite3.connect(self._path, timeout=_OPEN_SECONDS, isolation_level=None, check_same_thread=False)
        try:
            for pragma in ("journal_mode = WAL", "synchronous = NORMAL", "secure_delete = ON"):
                connection.execute(f"PRAGMA {pragma}").fetchall()
            found, marked = (_number(connection, name) for name in ("user_version", "application_id"))
            if found > _FORMAT or (found and marked != _APPLICATION):
                raise ValueError(f"{self._path} is of a newer rosld, or of something else: take another folder")
            connection.execute("CREATE TABLE IF NOT EXISTS receipt (number INTEGER PRIMARY KEY, told BLOB NOT NULL)")
            connection.execute(f"PRAGMA application_id = {_APPLICATION}")
            connection.execute(f"PRAGMA user_version = {_FORMAT}")
        except BaseException:
            connection.close()
            raise
        return connection

    def load(self) -> list[Receipt]:
        """All receipts, the oldest first. What cannot be read any more is left out."""
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
        connection = self._connection
        connection.execute("BEGIN IMMEDIATE")
        try:
            connection.executemany("INSERT OR REPLACE INTO receipt VALUES (?, ?)", rows)
            connection.executemany("DELETE FROM receipt WHERE number = ?", [(number,) for number in dropped])
            connection.execute("COMMIT")
        except BaseException:
            connection.execute("ROLLBACK")
            raise

    async def close(self) -> None:
        """Finish. Idempotent."""
        await asyncio.get_running_loop().run_in_executor(None, self._close)

    def _close(self) -> None:
        self._thread.shutdown()
        self._connection.close()


def _read(told: bytes) -> Receipt | None:
    try:
        members = orjson.loads(told)
        return Receipt(**{**members, "plan": tuple(members["plan"]), "touched": tuple(members["touched"])})
    except (ValueError, TypeError, KeyError):
        return None


def _number(connection: sqlite3.Connection, pragma: str) -> int:
    return int(connection.execute(f"PRAGMA {pragma}").fetchone()[0])
