"""When a held message is due: pure arithmetic on times, all of them seconds of one monotonic clock."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeAlias


@dataclass(frozen=True, slots=True)
class Wait:
    """Nothing is to be done before `until`."""

    until: float


@dataclass(frozen=True, slots=True)
class Publish:
    """The message is due now; `after` is the schedule once that is done."""

    after: Schedule


@dataclass(frozen=True, slots=True)
class LeaseExpired:
    """The lease is over."""


Step: TypeAlias = "Wait | Publish | LeaseExpired"


@dataclass(frozen=True, slots=True)
class Schedule:
    """A message is due at `origin` and every `period` after it, until `expires`; `beat` numbers the next time.

    Times are counted from the origin, so that no lateness adds up, and a time that has passed is left out, so that
    nothing is ever published twice to make up for it.
    """

    period: float
    origin: float
    expires: float
    tick: int = 0

    @property
    def due(self) -> float:
        """When the message is due next."""
        return self._at(self.tick)

    def _at(self, beat: int) -> float:
        return self.origin + beat * self.period

    def step(self, now: float) -> Step:
        """Return the next action. The end of a lease takes precedence."""
        if now >= self.expires:
            return LeaseExpired()
        if now < self.due:
            return Wait(min(self.due, self.expires))
        beat = max(self.tick, int((now - self.origin) / self.period)) + 1
        while self._at(beat) <= now:  # what was rounded away
            beat += 1
        return Publish(replace(self, tick=beat))

    def with_lease(self, expires: float) -> Schedule:
        """The same until another time: when messages are due does not change."""
        return replace(self, expires=expires)

    def with_period(self, period: float) -> Schedule:
        """The same in another period, counted from the time that came last."""
        if period == self.period:
            return self
        if self.tick == 0:
            return replace(self, period=period)
        return replace(self, period=period, origin=self._at(self.tick - 1), tick=1)
