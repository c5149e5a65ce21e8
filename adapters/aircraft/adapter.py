"""The embedded aircraft: a small ROS system that lives on the server's own loop and needs nothing else installed.

It answers at once, so that a deadline matters only when it has passed already, and whatever is asked of it before
`open` or after `close` is `Unreachable`.
"""

from __future__ import annotations

import asyncio
import math
import secrets
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

from rosld.adapters import parameters
from rosld.adapters.aircraft.flight import ACTION, Declined, Flight, FlyGoal, accept, cancel, end_of
from rosld.adapters.aircraft.flight import TYPE as FLY
from rosld.adapters.aircraft.graph import AIRCRAFT, DISPLAY, ROSLD, SERVICES, SPEED, aircraft_graph
from rosld.adapters.base import AdapterOptions, Capabilities, Published, Recording, Sink, Subscription, Watch
from rosld.adapters.local_topics import LocalTopics, NoWatch, require_reachable, require_type
from rosld.adapters.model import (
    ActionSchema,
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
    Sample,
    Schema,
    ServiceSchema,
    TypeRef,
    without_lifecycle,
)
from rosld.adapters.model.library import TypeLibrary
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


class Aircraft:
    """The aircraft of the paper's Listing 1 as an `Adapter`."""

    def __init__(self, options: AdapterOptions) -> None:
        self._library = TypeLibrary(ros_version=1, folders=options.types)
        self._types = {name: self._library.find(TypeRef(kind)).ref for name, kind in _TOPIC_TYPES.items()}
        self._types |= {name: self._library.find(TypeRef(service.type)).ref for name, service in SERVICES.items()}
        self._types[ACTION] = self._library.find(TypeRef(FLY)).ref
        self._speed = self._message(self._types[SPEED])
        own = {topic: self._types[topic] for topic in _TOPIC_TYPES}
        self._topics = LocalTopics(
            own, {DISPLAY}, Encoding.ROS1, ROSLD, lambda ref: self._message(ref).ref, self._revise
        )
        self._parameters = initial_parameters()
        self._flight = Flight()
        self._fly: FlyGoal | None = None
        self._sink: Sink | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._graph = self._as_it_is(1)

    @property
    def capabilities(self) -> Capabilities:
        """ROS 1 as it is, with a parameter tree, but without a master."""
        return _CAPABILITIES

    @property
    def graph(self) -> Graph:
        """The aircraft, its cockpit, and rosld while it advertises something."""
        return self._graph

    @property
    def recordings(self) -> Mapping[str, Recording]:
        """None."""
        return MappingProxyType({})

    async def open(self, sink: Sink, *, deadline: float) -> None:
        """Bring the aircraft to life: off, at rest. Nothing happens when it lives already."""
        if self._sink is not None:
            return
        self._sink = sink
        self._flight = Flight(since_ns=time.monotonic_ns())
        self._tick(asyncio.get_running_loop().time(), 0)

    async def close(self) -> None:
        """Let the aircraft rest, with nothing left advertised. Idempotent."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._fly is not None:
            words = "the aircraft is no longer there"
            self._tell_goal(self._fly, GoalEvent(time.time_ns(), GoalStatus.LOST, words, own=True))
            self._fly = None
        for topic in tuple(self._topics.advertised):
            self._topics.unadvertise(topic)
        self._sink = None

    def allows(self, ref: Ref) -> frozenset[Operation]:
        """What ROS 1 can do with this thing."""
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

    async def schema(self, ref: TypeRef, *, deadline: float) -> Schema:
        """The schema of a type that is shipped or in the folders given."""
        return self._library.find(ref)

    def known_types(self) -> Sequence[TypeRef]:
        """Return the types of the aircraft's topics, services and action, and of what rosld advertises."""
        return list(dict.fromkeys([*self._types.values(), *(each.type for each in self._topics.advertised.values())]))

    async def subscribe(self, topic: str, *, depth: int = 1) -> Subscription:
        """Subscribe to a topic, whether or not it is there yet."""
        return self._topics.subscribe(topic, depth)

    def age_ns(self, sample: Sample) -> int:
        """How long ago a sample was received."""
        return max(0, time.time_ns() - sample.received_ns)

    async def publish(
        self, topic: str, type: TypeRef, data: bytes, *, latch: bool = False, deadline: float
    ) -> Published:
        """Publish; nobody can come to match later, so that this never waits. Refused where the type is another."""
        self._reachable(deadline)
        return self._topics.publish(topic, type, data, latch)

    async def advertise(self, topic: str, type: TypeRef, *, deadline: float) -> None:
        """Nothing needs to be made beforehand: the aircraft hears what is published at once."""
        self._reachable(deadline)

    async def unadvertise(self, topic: str) -> None:
        """Stop advertising; what rosld sent there is gone with it."""
        self._topics.unadvertise(topic)

    async def call(self, service: str, type: TypeRef, request: bytes, *, deadline: float) -> bytes:
        """Call a service of the aircraft. Refused for another type, and for bytes that are no request."""
        self._reachable(deadline)
        if service not in SERVICES:
            raise NotFound(f"there is no service {service}")
        schema = self._library.find(self._types[service])
        assert isinstance(schema, ServiceSchema)
        require_type(service, "service", schema.ref, type)
        try:
            asked = schema.request.codec.decode(request, Encoding.ROS1)
        except ValueError as error:
            raise Refused(f"{service} cannot read the request", words=str(error)) from error
        self._flight, values = SERVICES[service].answer(self._flight, asked, time.monotonic_ns())
        codec = schema.response.codec
        return codec.encode(codec.build(schema.response.ref.name, values), Encoding.ROS1)

    async def send_goal(self, action: str, type: TypeRef, goal: bytes, *, deadline: float) -> GoalId:
        """Have the aircraft fly. Refused while it is off or flies already, and for another type."""
        self._reachable(deadline)
        schema = self._action(action)
        require_type(action, "action", schema.ref, type)
        try:
            asked = schema.goal.codec.decode(goal, Encoding.ROS1)
        except ValueError as error:
            raise Refused(f"{action} cannot read the goal", words=str(error)) from error
        distance = float(getattr(asked, "distance", math.nan))
        try:
            self._fly = accept(self._flight, self._fly, secrets.token_hex(16), distance, time.monotonic_ns())
        except Declined as declined:
            raise Refused(f"{action} rejected the goal", words=str(declined)) from declined
        self._tell_goal(self._fly, GoalEvent(time.time_ns(), GoalStatus.ACCEPTED, goal=goal, own=True))
        return GoalId(action, self._fly.id)

    async def cancel_goal(self, goal: GoalId, *, deadline: float) -> None:
        """Have the aircraft fly no further. NotFound where it does not fly to this goal."""
        self._reachable(deadline)
        self._action(goal.action)
        if self._fly is None or self._fly.id != goal.id:
            raise NotFound(f"the aircraft does not pursue the goal {goal.id}")
        self._fly = cancel(self._fly)
        self._tell_goal(self._fly, GoalEvent(time.time_ns(), GoalStatus.CANCELING, own=True))

    async def cancel_goals(self, action: str, *, deadline: float) -> None:
        """Have the aircraft fly no further, if it pursues a goal."""
        self._reachable(deadline)
        self._action(action)
        if self._fly is not None:
            await self.cancel_goal(GoalId(action, self._fly.id), deadline=deadline)

    async def follow_goals(self, action: str, *, deadline: float) -> Watch:
        """Return a watch without effect: all its goals are announced in any case."""
        self._action(action)
        return NoWatch()

    async def change_state(self, node: str, transition: str, *, deadline: float) -> None:
        """Raise Refused: its nodes have no lifecycles; NotFound for a node that is not there."""
        raise without_lifecycle(self._graph.nodes, node)

    async def get_parameters(self, names: Sequence[str], *, deadline: float) -> Mapping[str, ParameterValue]:
        """Return the values of those names that exist."""
        self._reachable(deadline)
        found = {name: parameters.read_name(self._parameters, name) for name in names}
        return {name: parameters.deep_copy(value) for name, value in found.items() if value is not None}

    async def set_parameters(self, values: Mapping[str, ParameterValue], *, deadline: float) -> None:
        """Set all of them or, when one is refused, none."""
        self._reachable(deadline)
        tree = self._parameters
        for name, value in values.items():
            parameters.check(name, value)
            tree = parameters.with_value(tree, name, parameters.deep_copy(value))
        self._replace_parameters(tree, values)

    async def delete_parameters(self, names: Sequence[str], *, deadline: float) -> None:
        """Delete all of them or, when one is not there, none."""
        self._reachable(deadline)
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

    def _reachable(self, deadline: float) -> None:
        require_reachable(self._sink is not None, deadline, "aircraft")

    def _message(self, ref: TypeRef) -> MessageSchema:
        schema = self._library.find(ref)
        if not isinstance(schema, MessageSchema):
            raise Refused(f"{ref.name} is a service type: only messages can be published")
        return schema

    def _action(self, name: str) -> ActionSchema:
        if name not in self._graph.actions:
            raise NotFound(f"there is no action {name}")
        schema = self._library.find(self._types[name])
        assert isinstance(schema, ActionSchema)
        return schema

    def _tell_goal(self, fly: FlyGoal, event: GoalEvent) -> None:
        if self._sink is not None:
            self._sink.goal_changed(GoalId(ACTION, fly.id), event)

    def _fly_on(self, now_ns: int) -> None:
        """Tell how far the aircraft has flown, or how its goal has ended."""
        fly = self._fly
        if fly is None:
            return
        schema = self._action(ACTION)
        flown, end = fly.flown_at(now_ns), end_of(fly, self._flight, now_ns)
        codec = schema.feedback.codec
        feedback = codec.encode(codec.build(schema.feedback.ref.name, {"flown": flown}), Encoding.ROS1)
        event = GoalEvent(time.time_ns(), GoalStatus.EXECUTING, feedback=feedback, own=True)
        if end is not None:
            self._fly = None
            codec, values = schema.result.codec, {"message": end.message, "flown": flown}
            result = codec.encode(codec.build(schema.result.ref.name, values), Encoding.ROS1)
            event = replace(event, status=end.status, result=result)
        self._tell_goal(fly, event)

    def _as_it_is(self, revision: int) -> Graph:
        return aircraft_graph(revision, self._types, self._topics.advertised, parameters.leaves(self._parameters))

    def _revise(self) -> None:
        self._graph = self._as_it_is(self._graph.revision + 1)
        if self._sink is not None:
            self._sink.graph_changed(self._graph)

    def _tick(self, began: float, turn: int) -> None:
        """Publish the speed, and again at the next whole period; periods that a busy loop missed are left out."""
        loop = asyncio.get_running_loop()
        speed = self._flight.speed_at(time.monotonic_ns())
        codec = self._speed.codec
        data = codec.encode(codec.build(self._speed.ref.name, {"data": speed}), Encoding.ROS1)
        self._topics.say(SPEED, AIRCRAFT, data)
        self._fly_on(time.monotonic_ns())
        following = max(turn, int((loop.time() - began) / PERIOD)) + 1
        self._timer = loop.call_at(began + following * PERIOD, self._tick, began, following)
