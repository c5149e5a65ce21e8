"""Part of a recording to serve: `run.bag?from=-60&rate=2`, parsed from the source."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from datetime import datetime, timezone
from typing import NamedTuple
from urllib.parse import parse_qsl

import numpy as np
from numpy.typing import NDArray

from rosld.adapters.model.moment import Moment, parse_moment
from rosld.adapters.recording.storage import Damaged, MessageTable

_NAMES = frozenset({"from", "to", "rate"})
_SECOND = 1_000_000_000


class Part(NamedTuple):
    """First and last time (None: those of the recording), inclusive, and playback rate (None: the configured one)."""

    begin: Moment | None = None
    end: Moment | None = None
    rate: float | None = None

    def select(
        self, table: MessageTable, latched: Callable[[MessageTable, int], NDArray[np.int64]]
    ) -> tuple[MessageTable, int]:
        """Return the selected rows in recorded order, and the number of latched messages that open them.

        `latched` returns the latched rows before a row: they are prepended, with the start of the part as their time.
        Raises Damaged if there are none.
        """
        if (self.begin is None and self.end is None) or not len(table.times):
            return table, 0
        start, last = int(table.times[0]), int(table.times[-1])
        first = 0 if self.begin is None else int(np.searchsorted(table.times, self.begin.at(start, last), "left"))
        beyond = len(table.times)
        if self.end is not None:
            beyond = int(np.searchsorted(table.times, self.end.at(start, last), "right"))
        if first >= beyond:
            raise Damaged(f"it has no messages in that period: it lasts from {_utc_text(start)} to {_utc_text(last)}")
        opening = latched(table, first)
        selected = table.rows(np.concatenate([opening, np.arange(first, beyond)]))
        if self.begin is not None:
            selected.times[: len(opening)] = self.begin.at(start, last)
        return selected, len(opening)


WHOLE = Part()


def parse_part(query: str) -> Part:
    """Return the part in a query such as `from=2026-11-24T12:00:00Z&to=-10&rate=2`. Raises ValueError."""
    pairs = parse_qsl(query, keep_blank_values=True, strict_parsing=True)
    parameters = dict(pairs)
    unknown = parameters.keys() - _NAMES
    if unknown or len(parameters) != len(pairs):
        raise ValueError(
            f"{'&'.join(sorted(unknown)) or query!r} after the recording: use from, to and rate, each once"
        )
    begin, end = (parse_moment(name, parameters[name]) if name in parameters else None for name in ("from", "to"))
    if begin is not None and end is not None and begin.is_absolute == end.is_absolute:
        both_sides = begin.ns >= 0 > end.ns
        if begin.ns > end.ns and not both_sides:
            raise ValueError(f"from={parameters['from'][:40]} is after to={parameters['to'][:40]}")
    return Part(begin, end, _rate(parameters))


def _rate(parameters: Mapping[str, str]) -> float | None:
    if "rate" not in parameters:
        return None
    try:
        return float(parameters["rate"])
    except ValueError as error:
        raise ValueError(f"rate={parameters['rate'][:40]} is not a number") from error


def _utc_text(time_ns: int) -> str:
    return datetime.fromtimestamp(time_ns // _SECOND, timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ")
