"""Part of a recording to serve: `run.bag?from=-60&rate=2`, parsed from the source."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from datetime import datetime, timezone
from typing import NamedTuple
from urllib.parse import parse_qsl

import numpy as np
from numpy.typing import NDArray

from rosld.adapters.recording.storage import Damaged, MessageTable

_NAMES = frozenset({"from", "to", "rate"})
_SECOND = 1_000_000_000


class Moment(NamedTuple):
    """A time in a recording, in ns: since the epoch, since its start, or before its end if negative."""

    ns: int
    is_absolute: bool

    def at(self, start_ns: int, end_ns: int) -> int:
        """Return the time in ns since the epoch, in a recording with these first and last times."""
        if self.is_absolute:
            return self.ns
        return end_ns + self.ns if self.ns < 0 else start_ns + self.ns


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
    begin, end = _moment(parameters, "from"), _moment(parameters, "to")
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


def _moment(parameters: Mapping[str, str], name: str) -> Moment | None:
    text = parameters.get(name)
    if text is None:
        return None
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if math.isfinite(seconds) and abs(seconds) < 1e9:
        return Moment(round(seconds * _SECOND), is_absolute=False)
    try:
        plain = text.replace(" ", "+")  # a plus sign is decoded as a space
        time = datetime.fromisoformat(f"{plain[:-1]}+00:00" if plain.endswith(("Z", "z")) else plain)
    except ValueError as error:
        words = f"{name}={text[:60]} is neither a time such as 2030-01-31T12:00:00Z nor seconds such as 10 or -60"
        raise ValueError(words) from error
    aware = time if time.tzinfo is not None else time.replace(tzinfo=timezone.utc)
    whole = aware.replace(microsecond=0)
    return Moment(int(whole.timestamp()) * _SECOND + aware.microsecond * 1000, is_absolute=True)


def _utc_text(time_ns: int) -> str:
    return datetime.fromtimestamp(time_ns // _SECOND, timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ")
