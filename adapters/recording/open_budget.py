"""Limits on opening a recording: memory of the index, work, and a deadline."""

from __future__ import annotations

MESSAGE_BYTES = 40
"""What one message takes in the index."""
PART_BYTES = 1024
"""About what a chunk, an index, a connection or a note takes beside its own bytes."""
_BASE_WORK = 1 << 30
"""Units of work that any file may take, of about a nanosecond: a byte that is decompressed is one."""
_WORK_PER_BYTE = 1024
"""Units that each byte of a file may take beyond: short messages without an index come to 30, compressed to 300."""
_RECORD_WORK = 1024
"""Units of looking at one record."""
_TYPE_WORK = 1_000_000
"""Units of compiling a type, which takes half a millisecond and 10 kB."""
_TEXT_WORK = 200
"""Work units per character of a definition; most characters are comments."""


class OpeningRefused(Exception):
    """A recording is not opened: its index is too large, or nobody waits any more. It may be no damage."""


class OpenBudget:
    """The memory that the index of a recording may still take, and the work: reading the index takes from both.

    A file of a few kilobytes can index any number of messages, and name what inflates to much again and again. How
    much work there may be depends on how long the file is, not on how fast the machine is. Any thread may cancel it.
    """

    def __init__(self, limit: int | None = None) -> None:
        """Without a limit any file may have as large an index as its work allows."""
        self._limit = limit
        self._spent = 0
        self._allowed = _BASE_WORK
        self.worked = 0
        """Units of work that were done so far."""
        self._is_cancelled = False

    @property
    def is_cancelled(self) -> bool:
        """Whether the reading is to end."""
        return self._is_cancelled

    def cancel(self) -> None:
        """Have the reading end, soon."""
        self._is_cancelled = True

    def check(self) -> None:
        """Raise OpeningRefused once it is cancelled."""
        if self._is_cancelled:
            raise OpeningRefused("reading it was called off")

    def allow(self, size: int) -> None:
        """Allow the work that a file of this size justifies."""
        self._allowed += size * _WORK_PER_BYTE

    def work(self, units: int = _RECORD_WORK) -> None:
        """Account for work, by default that of a record. Raises OpeningRefused where that is too much, or cancelled."""
        self.check()
        self.worked += units
        if self.worked > self._allowed:
            raise OpeningRefused("reading it takes more work than a file of its size justifies")

    def learn(self, types: int, characters: int) -> None:
        """Account for the definitions of types. Raises OpeningRefused where there are too many, or cancelled."""
        try:
            self.work(types * _TYPE_WORK + characters * _TEXT_WORK)
        except OpeningRefused as error:
            raise OpeningRefused(f"of its {types} types, {error}") from error

    def spend(self, *, messages: int = 0, parts: int = 0, octets: int = 0) -> None:
        """Account for what is kept. Raises OpeningRefused where that is too much, or it was cancelled."""
        self.check()
        self._spent += messages * MESSAGE_BYTES + parts * PART_BYTES + octets
        if self._limit is not None and self._spent > self._limit:
            raise OpeningRefused(f"its index takes more than {self._limit} bytes of memory")
