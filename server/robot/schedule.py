"""Schedule of a held message: pure arithmetic on times in seconds of one monotonic clock."""

from __future__ import annotations

from typing import TypeAlias

from msgspec import Struct
from msgspec.structs import replace


class Wait(Struct, frozen=True):
    """Nothing to do before `until`."""

    until: float


class Publish(Struct, frozen=True):
    """The message is due now; `after` is the schedule once it is published."""

    after: Schedule


class LeaseExpired(Struct, frozen=True):
    """The lease has ended."""


Step: TypeAlias = "Wait | Publish | LeaseExpired"


class Schedule(Struct, frozen=True):
    """Schedule of a message that is due at `origin` and every `period` after it, until `expires`.

    `tick` is the number of the next time. Times are counted from the origin, so that delays do not accumulate, and
    missed times are skipped, so that nothing is published twice to catch up.
    """

    period: float
    origin: float
    expires: float
    tick: int = 0

    @property
    def due(self) -> float:
        """Next time at which the message is due."""
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
        while self._at(beat) <= now:  # rounding error
            beat += 1
        return Publish(replace(self, tick=beat))

    def with_lease(self, expires: float) -> Schedule:
        """Return the schedule with another end; the due times are unchanged."""
        return replace(self, expires=expires)

    def with_period(self, period: float) -> Schedule:
        """Return the schedule with another period, counted from the last due time."""
        if period == self.period:
            return self
        if self.tick == 0:
            return replace(self, period=period)
        return replace(self, period=period, origin=self._at(self.tick - 1), tick=1)
