"""What errors of SQLite mean to the records."""

from __future__ import annotations

import sqlite3

from rosld.server.storage.record import StorageError


class DatabaseBusy(Exception):
    """Another process is writing just now."""


def storage_error(error: sqlite3.Error) -> Exception:
    """The exception that an error of SQLite is raised as: DatabaseBusy, or a StorageError with its words."""
    words = str(error)
    if "locked" in words or "busy" in words:
        return DatabaseBusy(words)
    if is_full(error):
        return StorageError(f"There is no space left to keep this: {words}.", full=True)
    return StorageError(f"The database of records failed: {words}.")


def is_full(error: Exception) -> bool:
    """Whether SQLite says that there is no space left."""
    return "full" in str(error)
