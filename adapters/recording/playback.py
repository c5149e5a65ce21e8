"""The clock of a playback: where in a recording one is, as a pure function of how long it has been playing."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple


class Position(NamedTuple):
    """A moment of a playback: the loop it is in (from 0) and the recorded time since the first message, in ns."""

    epoch: int
    offset_ns: int


@dataclass(frozen=True, slots=True)
class Playback:
    """How a recording of `duration_ns` is played: `rate` times its speed, in a loop with a short pause, or once.

    The pause shows the last message for as long as messages of the recording last on average, at least a
    millisecond and at most a second. Raises ValueError for a rate that is not a positive number.
    """

    duration_ns: int
    count: int
    rate: float = 1.0
    once: bool = False

    def __post_init__(self) -> None:
        if not (math.isfinite(self.rate) and self.rate > 0):
            raise ValueError(f"the rate must be a number above 0, not {self.rate}")

    @property
    def period_ns(self) -> int:
        """The recorded time that one loop takes, pause included."""
        mean = self.duration_ns // (self.count - 1) if self.count > 1 else 10**9
        return self.duration_ns + min(max(mean, 10**6), 10**9)

    def position(self, elapsed_ns: int) -> Position:
        """Where the playback is `elapsed_ns` after it began; played once, it rests at the end."""
        played = int(max(elapsed_ns, 0) * self.rate)
        if self.once:
            return Position(0, min(played, self.duration_ns))
        return Position(*divmod(played, self.period_ns))

    def since(self, position: Position, elapsed_ns: int) -> int:
        """How much recorded time, in ns, lies between a position and where the playback is; 0 for one to come."""
        now = self.position(elapsed_ns)
        return max(0, (now.epoch - position.epoch) * self.period_ns + now.offset_ns - position.offset_ns)

    def elapsed_at(self, position: Position) -> int:
        """How long after its beginning a playback reaches a position: never too early, at most a few ns late."""
        return math.ceil((position.epoch * self.period_ns + position.offset_ns) / self.rate)
