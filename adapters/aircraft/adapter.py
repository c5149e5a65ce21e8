"""The embedded aircraft: a small ROS system on the server's own loop."""

from __future__ import annotations

import asyncio
import math
import secrets
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from rosld.adapters import parameters
from rosld.adapters.aircraft.flight import ACTION, Declined, Flight, FlyGoal, accept, cancel, end_of
from rosld.adapters.aircraft.flight import TYPE as FLY
from rosld.adapters.aircraft.graph import AIRCRAFT, DISPLAY, ROSLD, SERVICES, SPEED, aircraft_graph
from rosld.adapters.base import AdapterOptions, Capabilities, Sink
from rosld.adapters.embedded import EmbeddedRobot
from rosld.adapters.model import (
    Encoding,
    GoalEvent,
    GoalId,
    GoalStatus,
    Graph,
    Kind,
    MessageSchema,
    NotFound,
    Operation,
    Ref,
    Refused,
    TypeRef,
)
from rosld.adapters.model.parameter import ParameterValue

PERIOD = 0.1
"""Seconds between two messages of the speed."""

_TOPIC_TYPES = {SPEED: "std_msgs/msg/Float64", DISPLAY: "std_msgs/msg/String"}
_CAPABILITIES = Capabilities(
    system="aircraft",
    encoding=Encoding.ROS1,
    writes=True,
    creates_topics=True,
    parameter_trees=True,
    mapping=Path(__file__).with_name("mapping.ttl"),
    limits=Path(__file__).with_name("limits.ttl"),
)
_KNOWN_TOPIC = frozenset({Operation.SUBSCRIBE, Operation.PUBLISH})
_KNOWN_PARAMETER = frozenset({Operation.GET_PARAMETER, Operation.SET_PARAMETER, Operation.DELETE_PARAMETER})


def initial_parameters() -> parameters.Tree:
    """Return the parameters that the aircraft starts with."""
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
        types = {**_TOPIC_TYPES, **{name: service.type for name, service in SERVICES.items()}, ACTION: FLY}
        super().__init__(_CAPABILITIES, options, types, _TOPIC_TYPES, {DISPLAY}, ROSLD)
        self._speed = self._message(self._types[SPEED])
        self._parameters = initial_parameters()
        self._flight = Flight()
        self._fly: FlyGoal | None = None
        self._graph = self._describe(1)

    async def open(self, sink: Sink, *, deadline: float) -> None:
        """Bring the aircraft to life: off, at rest. Nothing happens when it lives already."""
        if self._sink is not None:
            return
        self._sink = sink
        self._flight = Flight(since_ns=time.monotonic_ns())
        self._tick(asyncio.get_running_loop().time(), 0)

    async def close(self) -> None:
        """Let the aircraft rest, with nothing left advertised. Idempotent."""
        if self._fly is not None:
            words = "the aircraft is no longer there"
            self._announce(ACTION, self._fly.id, GoalEvent(time.time_ns(), GoalStatus.LOST, words, own=True))
            self._fly = None
        await super().close()

    def allows(self, ref: Ref) -> frozenset[Operation]:
        """Return the operations of ROS 1 on a thing."""
        if ref.kind is Kind.TOPIC:
            return _KNOWN_TOPIC if ref.name in self._graph.topics else frozenset({Operation.PUBLISH})
        if ref.kind is Kind.SERVICE:
            return frozenset({Operation.CALL}) if ref.name in self._graph.services else frozenset()
        if ref.kind is Kind.ACTION:
            return frozenset({Operation.SEND_GOAL}) if ref.name in self._graph.actions else frozenset()
        if ref.kind is Kind.PARAMETER:
            known = parameters.read_name(self._parameters, ref.name) is not None
            deletable = _KNOWN_PARAMETER if ref.name != "/" else _KNOWN_PARAMETER - {Operation.DELETE_PARAMETER}
            return deletable if known else frozenset({Operation.SET_PARAMETER})
        return frozenset()

    async def call(self, service: str, type: TypeRef, request: bytes, *, deadline: float) -> bytes:
        """Call a service of the aircraft. Raises Refused for another type, and for bytes that are no request."""
        self._require_reachable(deadline)
        schema = self._service(service, type)
        asked = self._decode(schema.request, request, service)
        self._flight, values = SERVICES[service].answer(self._flight, asked, time.monotonic_ns())
        return _encode(schema.response, values)

    async def send_goal(self, action: str, type: TypeRef, goal: bytes, *, deadline: float) -> GoalId:
        """Let the aircraft fly. Raises Refused while it is off or flies already, and for another type."""
        self._require_reachable(deadline)
        asked = self._decode(self._action(action, type).goal, goal, action)
        distance = float(getattr(asked, "distance", math.nan))
        try:
            self._fly = accept(self._flight, self._fly, secrets.token_hex(16), distance, time.monotonic_ns())
        except Declined as declined:
            raise Refused(f"{action} rejected the goal", words=str(declined)) from declined
        self._announce(action, self._fly.id, GoalEvent(time.time_ns(), GoalStatus.ACCEPTED, goal=goal, own=True))
        return GoalId(action, self._fly.id)

    async def cancel_goal(self, goal: GoalId, *, deadline: float) -> None:
        """Cancel the flight. Raises NotFound for a goal that the aircraft does not pursue."""
        self._require_reachable(deadline)
        self._action(goal.action)
        if self._fly is None or self._fly.id != goal.id:
            raise NotFound(f"the aircraft does not pursue the goal {goal.id}")
        self._fly = cancel(self._fly)
        self._announce(goal.action, goal.id, GoalEvent(time.time_ns(), GoalStatus.CANCELING, own=True))

    async def get_parameters(self, names: Sequence[str], *, deadline: float) -> Mapping[str, ParameterValue]:
        """Return the values of those names that exist."""
        self._require_reachable(deadline)
        found = {name: parameters.read_name(self._parameters, name) for name in names}
        return {name: parameters.deep_copy(value) for name, value in found.items() if value is not None}

    async def set_parameters(self, values: Mapping[str, ParameterValue], *, deadline: float) -> None:
        """Set all of them or, when one is refused, none."""
        self._require_reachable(deadline)
        tree = self._parameters
        for name, value in values.items():
            parameters.check(name, value)
            tree = parameters.with_value(tree, name, parameters.deep_copy(value))
        self._replace_parameters(tree, values)

    async def delete_parameters(self, names: Sequence[str], *, deadline: float) -> None:
        """Delete all of them or, when one is not there, none."""
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

    def _fly_on(self, now_ns: int) -> None:
        """Announce the progress of the flight, or the end of its goal."""
        fly = self._fly
        if fly is None:
            return
        schema = self._action(ACTION)
        flown, end = fly.flown_at(now_ns), end_of(fly, self._flight, now_ns)
        feedback = _encode(schema.feedback, {"flown": flown})
        event = GoalEvent(time.time_ns(), GoalStatus.EXECUTING, feedback=feedback, own=True)
        if end is not None:
            self._fly = None
            result = _encode(schema.result, {"message": end.message, "flown": flown})
            event = replace(event, status=end.status, result=result)
        self._announce(ACTION, fly.id, event)

    def _describe(self, revision: int) -> Graph:
        return aircraft_graph(revision, self._types, self._topics.advertised, parameters.leaves(self._parameters))

    def _tick(self, began: float, turn: int) -> None:
        """Publish the speed, and again at the next whole period; periods that a busy loop missed are left out."""
        loop = asyncio.get_running_loop()
        speed = self._flight.speed_at(time.monotonic_ns())
        self._topics.say(SPEED, AIRCRAFT, _encode(self._speed, {"data": speed}))
        self._fly_on(time.monotonic_ns())
        following = max(turn, int((loop.time() - began) / PERIOD)) + 1
        self._timer = loop.call_at(began + following * PERIOD, self._tick, began, following)


def _encode(schema: MessageSchema, values: Mapping[str, object]) -> bytes:
    return schema.codec.encode(schema.codec.build(schema.ref.name, values), Encoding.ROS1)
