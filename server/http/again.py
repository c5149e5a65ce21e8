"""The same request again: answered with the same bytes, for as long as its answer would come out the same.

Who polls sends the same bytes each time, and most of the time nothing has changed. Such a request need not be read,
routed and rendered anew: whoever answered it says how to tell that the answer still stands. Only what is answered alike
to everybody who sends these bytes may be kept here. What is asked for once costs next to nothing: of its request a hash
is remembered, and its answer is kept when the same bytes come for the second time.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import TypeAlias

Still: TypeAlias = Callable[[], bool]
"""Whether an answer would be given again now: told at once, on the loop. Asking is looking at what was answered."""

SCOPE = "rosld.still"
"""Where in the scope of a request that may come again the application finds None, and puts its answer's `Still`."""
LONGEST_REQUEST = 4096
"""Bytes of a request that may be one that was answered before."""
LONGEST_ANSWER = 64 * 1024
MOST = 8 * 1024 * 1024
"""Bytes of requests and answers that are kept."""
_REMEMBERED = 4096
"""Requests that came once, of which the hashes are remembered: these, and as many before them."""
_DATE = b"\r\ndate: "


class _Answer:
    """An answer as it was sent, but for its date."""

    __slots__ = ("after", "before", "date", "still", "whole")

    def __init__(self, whole: bytes, still: Still) -> None:
        """Raises ValueError for an answer that does not say when it was sent."""
        start = whole.index(_DATE) + len(_DATE)
        end = whole.index(b"\r\n", start)
        self.before, self.date, self.after = whole[:start], whole[start:end], whole[end:]
        self.whole = whole
        self.still = still

    def at(self, date: bytes) -> bytes:
        """The same, sent at this date."""
        if date != self.date:
            self.date, self.whole = date, b"".join((self.before, date, self.after))
        return self.whole


class Again:
    """The answers that may be given again, the least recently used going first. Belongs to one loop.

    `passes` says whether the client at an address may ask just now; it counts as asking.
    """

    def __init__(self, passes: Callable[[str | None], bool], most: int = MOST) -> None:
        self._passes = passes
        self._most = most
        self._size = 0
        self._answers: OrderedDict[bytes, _Answer] = OrderedDict()
        self._once: set[int] = set()
        self._before: set[int] = set()

    def has_come(self, request: bytes) -> bool:
        """Whether these bytes, which come now, came before, as far as is remembered."""
        if request in self._answers:
            return True
        mark = hash(request)
        if mark in self._once or mark in self._before:
            return True
        if len(self._once) >= _REMEMBERED:
            self._once, self._before = set(), self._once
        self._once.add(mark)
        return False

    def answer(self, request: bytes, address: str | None, date: bytes) -> bytes | None:
        """The answer to these very bytes if it still stands, with this date (RFC 9110 6.6.1)."""
        found = self._answers.get(request)
        if found is None:
            return None
        if not found.still():
            self._forget(request)
            return None
        if not self._passes(address):
            return None
        self._answers.move_to_end(request)
        return found.at(date)

    def keep(self, request: bytes, answer: bytes, still: Still) -> None:
        """This is how these bytes were answered."""
        if len(answer) > LONGEST_ANSWER:
            return
        try:
            kept = _Answer(answer, still)
        except ValueError:
            return
        if request in self._answers:
            self._forget(request)
        self._answers[request] = kept
        self._size += len(request) + len(answer)
        while self._size > self._most:
            self._forget(next(iter(self._answers)))

    def _forget(self, request: bytes) -> None:
        gone = self._answers.pop(request)
        self._size -= len(request) + len(gone.before) + len(gone.date) + len(gone.after)
