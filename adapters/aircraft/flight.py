"""Flight model: the state of the paper's aircraft at a time, and after a command.

A `Flight` is a frozen state and a time, from which everything else follows, so that tests need no clock. Times are
nanoseconds of any monotonic clock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from rosld.adapters.model import GoalStatus

MAX_SPEED = 1000.0
MAX_DIRECTION = 360.0
ACCELERATION = 100.0
"""Change of the speed per second, up or down."""


@dataclass(frozen=True, slots=True)
class Flight:
    """State of the aircraft at `since_ns`, when it had `speed` and began to change towards `commanded`."""

    on: bool = False
    speed: float = 0.0
    commanded: float = 0.0
    direction: float = 0.0
    since_ns: int = 0

    @property
    def power(self) -> str:
        """The power in the paper's terms."""
        return "on" if self.on else "off"

    def speed_at(self, now_ns: int) -> float:
        """Return the speed at a time not before `since_ns`; exactly the commanded one once it is reached."""
        difference = self.commanded - self.speed
        change = ACCELERATION * (now_ns - self.since_ns) / 1e9
        return self.commanded if abs(difference) <= change else self.speed + math.copysign(change, difference)


class Declined(Exception):
    """A command that the aircraft refuses; the message is its response."""


def start(flight: Flight, now_ns: int) -> Flight:
    """Return the flight after switching on. Raises Declined if the aircraft is on already."""
    if flight.on:
        raise Declined("the aircraft is already started")
    return replace(flight, on=True, since_ns=now_ns)


def stop(flight: Flight, now_ns: int) -> Flight:
    """Return the flight after switching off, if it was on. Raises Declined while the aircraft moves."""
    speed = flight.speed_at(now_ns)
    if flight.on and speed > 0:
        raise Declined(f"the aircraft still moves at {speed:g}: set the speed to 0 first")
    return replace(flight, on=False, speed=0.0, commanded=0.0, since_ns=now_ns)


def set_power(flight: Flight, power: str, now_ns: int) -> Flight:
    """Return the flight after switching "on" or "off". Raises Declined for other words, and like `start` and `stop`."""
    if power == "on":
        return start(flight, now_ns)
    if power == "off":
        return stop(flight, now_ns)
    raise Declined(f"the power is 'on' or 'off', not {power!r}")


def set_speed(flight: Flight, speed: float, now_ns: int) -> Flight:
    """Return the flight after commanding a speed. Raises Declined while off, and outside 0 to 1000."""
    _on_and_within(flight, "speed", speed, MAX_SPEED)
    return replace(flight, speed=flight.speed_at(now_ns), commanded=_positive(speed), since_ns=now_ns)


def set_heading(flight: Flight, direction: float, now_ns: int) -> Flight:
    """Return the flight with another direction. Raises Declined while off, and outside 0 to 360."""
    _on_and_within(flight, "direction", direction, MAX_DIRECTION)
    return replace(flight, speed=flight.speed_at(now_ns), direction=_positive(direction), since_ns=now_ns)


def _on_and_within(flight: Flight, subject: str, value: float, limit: float) -> None:
    if not flight.on:
        raise Declined(f"the aircraft is off: start it before setting its {subject}")
    if not 0 <= value <= limit:  # false for NaN
        raise Declined(f"the {subject} must be between 0 and {limit:g}, not {value:g}")


def _positive(value: float) -> float:
    return value + 0.0  # turns -0.0 into 0.0


ACTION = "/aircraft/fly"
TYPE = "rosld_aircraft/action/Fly"
MAX_DISTANCE = 100_000.0
PACE = 100.0
"""Distance that the aircraft flies per second."""


@dataclass(frozen=True, slots=True)
class FlyGoal:
    """A goal accepted at `since_ns` to fly a distance; `canceling` after a request to cancel it."""

    id: str
    distance: float
    since_ns: int
    canceling: bool = False

    def flown_at(self, now_ns: int) -> float:
        """Return the distance flown at a time."""
        return min(self.distance, PACE * (now_ns - self.since_ns) / 1e9)


@dataclass(frozen=True, slots=True)
class GoalEnd:
    """End of a goal: its status and message."""

    status: GoalStatus
    message: str


def accept(flight: Flight, underway: FlyGoal | None, id: str, distance: float, now_ns: int) -> FlyGoal:
    """Return the goal to fly a distance from now on.

    Raises Declined while the aircraft is off or has another goal, and for distances below 0 or above `MAX_DISTANCE`.
    """
    if not flight.on:
        raise Declined("the aircraft is off: start it before it is to fly")
    if underway is not None:
        raise Declined("the aircraft flies already: cancel that goal first, or wait for its end")
    if not 0 <= distance <= MAX_DISTANCE:  # false for NaN
        raise Declined(f"the distance must be between 0 and {MAX_DISTANCE:g}, not {distance:g}")
    return FlyGoal(id, distance, now_ns)


def cancel(fly: FlyGoal) -> FlyGoal:
    """Return the goal with a request to cancel it."""
    return replace(fly, canceling=True)


def end_of(fly: FlyGoal, flight: Flight, now_ns: int) -> GoalEnd | None:
    """Return the end of the goal, or None while it is pursued."""
    if fly.canceling:
        return GoalEnd(GoalStatus.CANCELED, "canceled")
    if not flight.on:
        return GoalEnd(GoalStatus.ABORTED, "the aircraft was switched off")
    if fly.flown_at(now_ns) >= fly.distance:
        return GoalEnd(GoalStatus.SUCCEEDED, "arrived")
    return None
