"""Where the recorded messages of a query come from."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from rosld.server.auth.permissions import Permissions
from rosld.server.sparql.intervals import Interval
from rosld.server.sparql.past import PastQuery

MAX_TEXT = 256 * 1024 * 1024
"""Characters of N-Triples that one query may have of them."""


class PastText(NamedTuple):
    """What is said of recorded messages, as N-Triples; `is_whole`: of all that were asked for."""

    text: bytes
    is_whole: bool = True


class PastSource(Protocol):
    """Reads recorded messages. Called on the loop."""

    async def read(
        self,
        asked: PastQuery,
        graphs: tuple[str, ...],
        permissions: Permissions,
        now: Interval,
        until: float,
        most: int | None = None,
    ) -> PastText:
        """What is said of the messages that a query asks for, as far as they may be read.

        Of about `most` messages where that is a number: those at the query's `end`, all that were received at a time,
        or on that side of it. `graphs` are those that the default graph is made of, none for all. NOW() will be within
        `now`; `until` is when the time is over (monotonic). Raises Problems: 400 where there is no past to be read, 503
        for too much.
        """
        ...
