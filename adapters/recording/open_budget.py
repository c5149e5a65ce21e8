"""What opening a recording may cost: the memory of its index, and until when."""

from __future__ import annotations

MESSAGE_BYTES = 40
"""What one message takes in the index."""
PART_BYTES = 1024
"""About what a chunk, an index, a connection or a note takes beside its own bytes."""


class OpeningRefused(Exception):
    """A recording is not opened: its index is too large, or nobody waits any more. It may be no damage."""


class OpenBudget:
    """The memory that the index of a recording may still take, from which reading the index takes what it keeps.

    A file of a few kilobytes can index any number of messages: its indexes may all be one, and its chunks inflate. Any
    thread may cancel it.
    """

    def __init__(self, limit: int | None = None) -> None:
        """Without a limit only `cancel` ends the reading."""
        self._limit = limit
        self._spent = 0
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

    def spend(self, *, messages: int = 0, parts: int = 0, octets: int = 0) -> None:
        """Account for what is kept. Raises OpeningRefused where that is too much, or it was cancelled."""
        self.check()
        self._spent += messages * MESSAGE_BYTES + parts * PART_BYTES + octets
        if self._limit is not None and self._spent > self._limit:
            raise OpeningRefused(f"its index takes more than {self._limit} bytes of memory")
