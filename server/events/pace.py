"""Pace: how often a reader is told, by the generic cell rate algorithm (ITU-T I.371). Times are loop times."""

from __future__ import annotations

_SLACK = 0.25
"""The part of an interval by which one event may come early, so that the jitter of a topic as fast as the reader

wishes neither delays nor loses a value. Over any time t no more than rate * t + 1.25 events pass.
"""


class Pace:
    """At most `rate` events a second."""

    __slots__ = ("_interval", "_next")

    def __init__(self, rate: float) -> None:
        self._interval = 1.0 / rate
        self._next = float("-inf")

    def wait(self, now: float) -> float:
        """Seconds from now until the next event may pass; 0.0 where it may now."""
        return max(0.0, self._next - self._interval * _SLACK - now)

    def passed(self, now: float) -> None:
        """An event passes now."""
        self._next = max(now, self._next) + self._interval
