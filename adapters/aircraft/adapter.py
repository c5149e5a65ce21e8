"""Embedded aircraft: a small ROS system on the server's event loop."""

from __future__ import annotations

import asyncio
import copy
import math
import secrets
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, TypeAlias

from rosld.adapters import parameters
from rosld.adapters.base import AdapterOptions, Capabilities
from rosld.adapters.embedded import EmbeddedRobot, Interface
from rosld.adapters.model import Encoding, GoalEvent, GoalStatus, Message, Operation, Parameter, Refused
from rosld.adapters.model.parameter import ParameterValue

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
        raise Declined(f"the aircraft is still moving at {speed:g}: set the speed to 0 first")
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
        raise Declined("the aircraft is off: start it first")
    if underway is not None:
        raise Declined("the aircraft is already flying: cancel that goal first, or wait for its end")
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


Values: TypeAlias = Mapping[str, object]
Answer: TypeAlias = "tuple[Flight, Values]"


class AircraftService(NamedTuple):
    """A service: its type, and its function of a flight, a request and a time."""

    type: str
    answer: Callable[[Flight, Any, int], Answer]


def _command(act: Callable[[Flight, Any, int], Flight], done: str) -> Callable[[Flight, Any, int], Answer]:
    def answer(flight: Flight, request: Any, now_ns: int) -> Answer:
        try:
            return act(flight, request, now_ns), {"success": True, "message": done}
        except Declined as words:
            return flight, {"success": False, "message": str(words)}

    return answer


def _question(query: Callable[[Flight], object]) -> Callable[[Flight, Any, int], Answer]:
    def answer(flight: Flight, _request: Any, _now_ns: int) -> Answer:
        return flight, {"data": query(flight)}

    return answer


SERVICES: Mapping[str, AircraftService] = MappingProxyType(
    {
        "/aircraft/start": AircraftService(
            "std_srvs/srv/Trigger", _command(lambda flight, _, now: start(flight, now), "started")
        ),
        "/aircraft/stop": AircraftService(
            "std_srvs/srv/Trigger", _command(lambda flight, _, now: stop(flight, now), "stopped")
        ),
        "/aircraft/set_power": AircraftService(
            "rosld_aircraft/srv/SetText",
            _command(lambda flight, request, now: set_power(flight, request.data, now), "power set"),
        ),
        "/aircraft/get_power": AircraftService("rosld_aircraft/srv/GetText", _question(lambda flight: flight.power)),
        "/aircraft/engine/set_speed": AircraftService(
            "rosld_aircraft/srv/SetNumber",
            _command(lambda flight, request, now: set_speed(flight, request.data, now), "speed set"),
        ),
        "/aircraft/engine/set_direction": AircraftService(
            "rosld_aircraft/srv/SetNumber",
            _command(lambda flight, request, now: set_heading(flight, request.data, now), "direction set"),
        ),
        "/aircraft/engine/get_direction": AircraftService(
            "rosld_aircraft/srv/GetNumber", _question(lambda flight: flight.direction)
        ),
    }
)


AIRCRAFT = "/aircraft"
COCKPIT = "/cockpit"
SPEED = "/aircraft/engine/speed"
DISPLAY = "/cockpit/display"


PERIOD = 0.1
"""Seconds between two messages of the speed."""

_CAPABILITIES = Capabilities(
    system="aircraft",
    encoding=Encoding.ROS1,
    writes=True,
    creates_topics=True,
    parameter_trees=True,
    mapping=Path(__file__).with_name("mapping.ttl"),
    limits=Path(__file__).with_name("limits.ttl"),
)
_KNOWN_PARAMETER = frozenset({Operation.GET_PARAMETER, Operation.SET_PARAMETER, Operation.DELETE_PARAMETER})


def initial_parameters() -> parameters.Tree:
    """Return the initial parameters of the aircraft."""
    return {
        "aircraft": {
            "registration": "RO-SLD",
            "seats": 2,
            "engine": {"cylinders": 6, "limits": {"oil_pressure": 4.5, "temperature": 230.0}},
        },
        "cockpit": {"brightness": 0.8, "night": False, "checklist": ["fuel", "flaps", "radio"]},
    }


class Aircraft(EmbeddedRobot):
    """The aircraft of the paper's Listing 1 as an `Adapter`."""

    def __init__(self, options: AdapterOptions) -> None:
        self._parameters = initial_parameters()
        self._flight = Flight()
        self._fly: FlyGoal | None = None
        super().__init__(
            _CAPABILITIES,
            options,
            published={SPEED: Interface("std_msgs/msg/Float64", AIRCRAFT)},
            subscribed={DISPLAY: Interface("std_msgs/msg/String", COCKPIT)},
            services={name: Interface(service.type, AIRCRAFT) for name, service in SERVICES.items()},
            actions={ACTION: Interface(TYPE, AIRCRAFT)},
        )

    def _start(self) -> None:
        """Start the aircraft, switched off and at rest."""
        self._flight, self._fly = Flight(since_ns=time.monotonic_ns()), None
        self._tick(asyncio.get_running_loop().time(), 0)

    def _answer(self, service: str, request: Message) -> Mapping[str, object]:
        self._flight, values = SERVICES[service].answer(self._flight, request, time.monotonic_ns())
        return values

    def _accept(self, action: str, goal: Message) -> str:
        """Accept a flight. Raises Refused while the aircraft is off or already flying."""
        distance = float(getattr(goal, "distance", math.nan))
        try:
            self._fly = accept(self._flight, self._fly, secrets.token_hex(16), distance, time.monotonic_ns())
        except Declined as declined:
            raise Refused(f"{action} rejected the goal", words=str(declined)) from declined
        return self._fly.id

    def _cancel(self, id: str) -> bool:
        if self._fly is None or self._fly.id != id:
            return False
        self._fly = cancel(self._fly)
        return True

    async def get_parameters(self, names: Sequence[str], *, deadline: float) -> Mapping[str, ParameterValue]:
        self._require_reachable(deadline)
        values = {name: parameters.read_name(self._parameters, name) for name in names}
        return {name: copy.deepcopy(value) for name, value in values.items() if value is not None}

    async def set_parameters(self, values: Mapping[str, ParameterValue], *, deadline: float) -> None:
        """Set all parameters, or none if one is refused."""
        self._require_reachable(deadline)
        tree = self._parameters
        for name, value in values.items():
            parameters.check(name, value)
            tree = parameters.with_value(tree, name, copy.deepcopy(value))
        self._replace_parameters(tree, values)

    async def delete_parameters(self, names: Sequence[str], *, deadline: float) -> None:
        """Delete all parameters, or none if one does not exist."""
        self._require_reachable(deadline)
        tree = self._parameters
        for name in names:
            tree = parameters.without_name(tree, name)
        self._replace_parameters(tree, names)

    def _replace_parameters(self, tree: parameters.Tree, names: Sequence[str] | Mapping[str, ParameterValue]) -> None:
        self._parameters = tree
        if self._graph.parameters.keys() != set(parameters.leaves(tree)):
            self._revise()
        if self._sink is not None:
            for name in names:
                self._sink.parameter_changed(name)

    def _current_goal(self) -> str | None:
        return self._fly.id if self._fly is not None else None

    def _report_progress(self, now_ns: int) -> None:
        """Report the progress of the flight, or the end of its goal."""
        fly = self._fly
        if fly is None:
            return
        schema = self._action(ACTION)
        flown, end = fly.flown_at(now_ns), end_of(fly, self._flight, now_ns)
        feedback = self._encode(schema.feedback, {"flown": flown})
        event = GoalEvent(time.time_ns(), GoalStatus.EXECUTING, feedback=feedback, own=True)
        if end is not None:
            self._fly = None
            result = self._encode(schema.result, {"message": end.message, "flown": flown})
            event = replace(event, status=end.status, result=result)
        self._announce(ACTION, fly.id, event)

    def _parameters_of_graph(self) -> Mapping[str, Parameter]:
        return {name: Parameter(name) for name in sorted(parameters.leaves(self._parameters))}

    def _parameter_operations(self, name: str) -> frozenset[Operation]:
        if parameters.read_name(self._parameters, name) is None:
            return frozenset({Operation.SET_PARAMETER})
        return _KNOWN_PARAMETER if name != "/" else _KNOWN_PARAMETER - {Operation.DELETE_PARAMETER}

    def _tick(self, began: float, turn: int) -> None:
        """Publish the speed, and again at the next whole period; periods that a busy loop missed are skipped."""
        loop = asyncio.get_running_loop()
        speed = self._flight.speed_at(time.monotonic_ns())
        self._publish(SPEED, {"data": speed})
        self._report_progress(time.monotonic_ns())
        following = max(turn, int((loop.time() - began) / PERIOD)) + 1
        self._timer = loop.call_at(began + following * PERIOD, self._tick, began, following)
