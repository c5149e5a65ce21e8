"""Embedded aircraft: a small ROS system on the server's event loop."""

from __future__ import annotations

import asyncio
import math
import secrets
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, TypeAlias

from rosld.adapters import parameters
from rosld.adapters.aircraft.flight import (
    ACTION,
    Declined,
    Flight,
    FlyGoal,
    accept,
    cancel,
    end_of,
    set_heading,
    set_power,
    set_speed,
    start,
    stop,
)
from rosld.adapters.aircraft.flight import TYPE as FLY
from rosld.adapters.base import AdapterOptions, Capabilities
from rosld.adapters.embedded import EmbeddedRobot, Interface
from rosld.adapters.model import Encoding, GoalEvent, GoalStatus, Message, Operation, Parameter, Refused
from rosld.adapters.model.parameter import ParameterValue

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
            actions={ACTION: Interface(FLY, AIRCRAFT)},
        )

    def _start(self) -> None:
        """Start the aircraft, switched off and at rest."""
        self._flight = Flight(since_ns=time.monotonic_ns())
        self._tick(asyncio.get_running_loop().time(), 0)

    async def close(self) -> None:
        """End the goal and stop advertising. Idempotent."""
        if self._fly is not None:
            words = "the aircraft is no longer there"
            self._announce(ACTION, self._fly.id, GoalEvent(time.time_ns(), GoalStatus.LOST, words, own=True))
            self._fly = None
        await super().close()

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
        """Return the values of existing parameters."""
        self._require_reachable(deadline)
        values = {name: parameters.read_name(self._parameters, name) for name in names}
        return {name: parameters.deep_copy(value) for name, value in values.items() if value is not None}

    async def set_parameters(self, values: Mapping[str, ParameterValue], *, deadline: float) -> None:
        """Set all parameters, or none if one is refused."""
        self._require_reachable(deadline)
        tree = self._parameters
        for name, value in values.items():
            parameters.check(name, value)
            tree = parameters.with_value(tree, name, parameters.deep_copy(value))
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
