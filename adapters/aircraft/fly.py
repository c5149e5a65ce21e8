"""The action of the aircraft, `/aircraft/fly`: from a goal and a time to its status, as pure functions.

Times are nanoseconds of the same monotonic clock as the flight's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from rosld.adapters.aircraft.flight import Declined, Flight
from rosld.adapters.model import GoalStatus

ACTION = "/aircraft/fly"
TYPE = "rosld_aircraft/action/Fly"
MAX_DISTANCE = 100_000.0
PACE = 100.0
"""How far the aircraft flies in a second."""


@dataclass(frozen=True, slots=True)
class FlyGoal:
    """A goal that was taken at `since_ns`: so far to fly; `canceling` once it was asked to be canceled."""

    id: str
    distance: float
    since_ns: int
    canceling: bool = False

    def flown_at(self, now_ns: int) -> float:
        """How far it has flown."""
        return min(self.distance, PACE * (now_ns - self.since_ns) / 1e9)


@dataclass(frozen=True, slots=True)
class GoalEnd:
    """How a goal ended, and what is told of it."""

    status: GoalStatus
    message: str


def accept(flight: Flight, underway: FlyGoal | None, id: str, distance: float, now_ns: int) -> FlyGoal:
    """The goal to fly a distance from now on.

    Raises Declined while the aircraft is off, while another goal is underway, and for less than 0 or more than
    `MAX_DISTANCE`.
    """
    if not flight.on:
        raise Declined("the aircraft is off: start it before it is to fly")
    if underway is not None:
        raise Declined("the aircraft flies already: cancel that goal first, or wait for its end")
    if not 0 <= distance <= MAX_DISTANCE:  # NaN is within nothing
        raise Declined(f"the distance must be between 0 and {MAX_DISTANCE:g}, not {distance:g}")
    return FlyGoal(id, distance, now_ns)


def cancel(fly: FlyGoal) -> FlyGoal:
    """The goal, to be canceled."""
    return replace(fly, canceling=True)


def end_of(fly: FlyGoal, flight: Flight, now_ns: int) -> GoalEnd | None:
    """How the goal has ended, None while it is pursued."""
    if fly.canceling:
        return GoalEnd(GoalStatus.CANCELED, "canceled")
    if not flight.on:
        return GoalEnd(GoalStatus.ABORTED, "the aircraft was switched off")
    if fly.flown_at(now_ns) >= fly.distance:
        return GoalEnd(GoalStatus.SUCCEEDED, "arrived")
    return None
