"""Times in recordings as users write them: dates, or seconds from the start or before the end."""

from __future__ import annotations

import math
import re
from datetime import datetime, timezone
from typing import NamedTuple

_SECOND = 1_000_000_000
_FRACTION = re.compile(r"\.(\d{1,9})\d*")


class Moment(NamedTuple):
    """A time in a recording, in ns: since the epoch, since its start, or before its end if negative."""

    ns: int
    is_absolute: bool

    def at(self, start_ns: int, end_ns: int) -> int:
        """Return the time in ns since the epoch, in a recording with these first and last times."""
        if self.is_absolute:
            return self.ns
        return end_ns + self.ns if self.ns < 0 else start_ns + self.ns


def parse_moment(name: str, text: str) -> Moment:
    """Return the moment that is the value of the parameter `name`. Raises ValueError."""
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if math.isfinite(seconds) and abs(seconds) < 1e9:
        return Moment(round(seconds * _SECOND), is_absolute=False)
    plain = text.replace(" ", "+")  # a plus sign is decoded as a space
    fraction = _FRACTION.search(plain)
    plain = _FRACTION.sub("", plain, count=1)
    try:
        time = datetime.fromisoformat(f"{plain[:-1]}+00:00" if plain.endswith(("Z", "z")) else plain)
    except ValueError as error:
        words = f"{name}={text[:60]} is neither a time such as 2030-01-31T12:00:00Z nor seconds such as 10 or -60"
        raise ValueError(words) from error
    aware = time if time.tzinfo is not None else time.replace(tzinfo=timezone.utc)
    nanoseconds = 0 if fraction is None else int(fraction[1].ljust(9, "0"))
    return Moment(int(aware.timestamp()) * _SECOND + nanoseconds, is_absolute=True)
