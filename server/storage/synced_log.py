"""The write-ahead log of a database, and how far of it is known to be on the disk."""

from __future__ import annotations

import os
from pathlib import Path

from rosld.server.storage.write_ahead_log import LogExtent, WriteAheadLog, truncate

sync_file = getattr(os, "fdatasync", os.fsync)


class SyncedLog:
    """Syncs the log of a database that is open elsewhere, and cuts off what a failed sync left uncertain."""

    def __init__(self, database: Path) -> None:
        self._database = database
        self._log = WriteAheadLog(database)
        self._synced = self._written = self._log.extent()
        self._cut: LogExtent | None = None

    @property
    def needs_truncation(self) -> bool:
        """Whether a failed sync has left something to cut off, or it was cut off."""
        return self._cut is not None

    def note_written(self) -> None:
        """Remember that the log reaches as far as it does now; for whoever has just written."""
        self._written = self._log.extent()

    def sync(self) -> None:
        """Wait until what was noted is on the disk. Raises OSError; what is to be cut off is remembered then."""
        written = self._written
        try:
            self.flush()
        except OSError:
            # Where another process has written as well nothing is cut off: that would be lost too.
            self._cut = self._synced if self._log.extent() == written else None
            raise
        self._synced = written

    def flush(self) -> None:
        """Have the disk take the file, whatever that says of earlier failures. Raises OSError."""
        sync_file(self._log.fileno())

    def size(self) -> int:
        """Bytes that the log has."""
        return self._log.size()

    def truncate(self) -> None:
        """Close the files, and cut off what is not known to be on the disk. Raises OSError."""
        self._log.close()
        if self._cut is not None:
            truncate(self._database, self._cut)

    def open(self) -> None:
        """Open the files of the log again."""
        self._log = WriteAheadLog(self._database)

    def count_lost_frames(self) -> int:
        """Count the pages that the disk had taken and has lost all the same."""
        found, kept = self._log.extent(), self._cut
        return max(0, kept.frames - found.frames) if kept is not None and found.salt == kept.salt else 0

    def mark_all_synced(self) -> None:
        """Take everything in the log for synced; for whoever has just carried it over."""
        self._synced = self._written = self._log.extent()
        self._cut = None

    def close(self) -> None:
        """Close the files. Idempotent."""
        self._log.close()
