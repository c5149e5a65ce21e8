"""The token bucket of all rate limits: of clients, of publishes to a topic, of the events of a stream."""

from __future__ import annotations

import math

_ROUNDING = 1e-9


class TokenBucket:
    """A token bucket: `rate` tokens a second flow in, at most `burst` (from 1.0) are in it, and it begins full.

    It is kept as one number, the time at which it will be full again: the theoretical arrival time of the generic cell
    rate algorithm (ITU-T I.371), which is the same thing. Times are seconds of a monotonic clock.
    """

    __slots__ = ("_burst", "_full_at", "_interval")

    def __init__(self, rate: float, burst: float) -> None:
        self._interval = 1.0 / rate
        self._burst = max(burst, 1.0)
        self._full_at = -math.inf

    def wait(self, now: float) -> float:
        """Return the seconds until there is a token, 0.0 where there is one."""
        seconds = self._full_at - now - (self._burst - 1.0) * self._interval
        return seconds if seconds > _ROUNDING else 0.0

    def take(self, now: float, *, debt: float = math.inf) -> None:
        """Take a token, also where there is none: then the next ones wait for it, for `debt` tokens at the most."""
        self._full_at = min(max(self._full_at, now), now + (self._burst + debt - 1.0) * self._interval) + self._interval

    def is_full(self, now: float) -> bool:
        """Whether it is as a new one."""
        return self._full_at <= now
