"""The embedded rover: a mobile robot of one node that lives on the server's own loop and needs nothing else installed.

It is as a robot of ROS 2 is: messages in CDR, parameters that its node has declared. What it says on a topic is made
only while somebody looks. It answers at once, so that a deadline matters only when it has passed already, and whatever
is asked of it before `open` or after `close` is `Unreachable`.
"""

from __future__ import annotations

import asyncio
import secrets
import time
from collections.abc import Mapping, Sequence
from types import MappingProxyType

from rosld.adapters.base import AdapterOptions, Capabilities, Published, Recording, Sink, Subscription, Watch
from rosld.adapters.local_topics import LocalTopics, NoWatch, require_reachable, require_type
from rosld.adapters.model import (
    ActionSchema,
    GoalEvent,
    GoalId,
    GoalStatus,
    Graph,
    Kind,
    Message,
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
from rosld.adapters.rover.graph import (
    ACTIONS,
    CMD_VEL,
    LATCHED,
    LIGHTS,
    NAVIGATE_TO,
    PERIODIC,
    ROSLD,
    ROSOUT,
    SERVICES,
    SET_LIGHTS,
    TOPICS,
    operations_on,
    read,
    refuse_deletion,
    rover_graph,
    with_values,
)
from rosld.adapters.rover.messages import ENCODING, Fields, View, encode, log, navigation_feedback, navigation_result
from rosld.adapters.rover.navigation import Declined, JourneyEnd, Outcome, goal_of, switch_of, velocity_of
from rosld.adapters.rover.settings import DEFAULTS, NODE
from rosld.adapters.rover.simulation import Answer, Simulation, Start

PERIOD = 0.05
"""Seconds between two looks at what is due."""
_FEEDBACK_PERIOD = 0.2
_CAPABILITIES = Capabilities(system="rover", encoding=ENCODING, writes=True, creates_topics=True, parameter_trees=False)
_STATUSES: Mapping[Outcome, GoalStatus] = MappingProxyType(
    {
        Outcome.SUCCEEDED: GoalStatus.SUCCEEDED,
        Outcome.CANCELED: GoalStatus.CANCELED,
        Outcome.ABORTED: GoalStatus.ABORTED,
    }
)


class Rover:
    """The rover as an `Adapter`."""

    def __init__(self, start: Start, options: AdapterOptions) -> None:
        self._start = start
        self._library = TypeLibrary(ros_version=2, folders=options.types)
        named = {**TOPICS, **SERVICES, **ACTIONS}
        self._types = {name: self._library.find(TypeRef(type)).ref for name, type in named.items()}
        own = {name: self._types[name] for name in TOPICS}
        self._topics = LocalTopics(own, {CMD_VEL}, ENCODING, ROSLD, lambda ref: self._message(ref).ref, self._revise)
        self._simulation = Simulation(start, time.monotonic())
        self._parameters = DEFAULTS
        self._sink: Sink | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._due: dict[str, float] = {}
        self._graph = rover_graph(1, self._types, {})

    @property
    def capabilities(self) -> Capabilities:
        """ROS 2 as it is, without a middleware."""
        return _CAPABILITIES

    @property
    def graph(self) -> Graph:
        """The rover's node, and rosld while it advertises something."""
        return self._graph

    @property
    def recordings(self) -> Mapping[str, Recording]:
        """None."""
        return MappingProxyType({})

    async def open(self, sink: Sink, *, deadline: float) -> None:
        """Begin, at the start. Nothing happens when it has begun already."""
        if self._sink is not None:
            return
        self._sink = sink
        self._parameters = DEFAULTS
        self._simulation = Simulation(self._start, time.monotonic())
        for topic in LATCHED:
            self._say(topic)
        self._tick()

    async def close(self) -> None:
        """End, with nothing left advertised. Idempotent."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        journey = self._simulation.state.journey
        if journey is not None:
            event = GoalEvent(time.time_ns(), GoalStatus.LOST, "the rover is no longer there", own=True)
            self._tell(journey.id, event)
        for topic in tuple(self._topics.advertised):
            self._topics.unadvertise(topic)
        self._sink = None

    def allows(self, ref: Ref) -> frozenset[Operation]:
        """What ROS 2 can do with this thing."""
        if ref.kind is Kind.TOPIC:
            known = ref.name in self._graph.topics
            return frozenset({Operation.PUBLISH, *([Operation.SUBSCRIBE] if known else [])})
        if ref.kind is Kind.SERVICE:
            return frozenset({Operation.CALL} if ref.name in SERVICES else ())
        if ref.kind is Kind.ACTION:
            return frozenset({Operation.SEND_GOAL} if ref.name in ACTIONS else ())
        return operations_on(ref.name) if ref.kind is Kind.PARAMETER else frozenset()

    async def schema(self, ref: TypeRef, *, deadline: float) -> Schema:
        """The schema of a type that is shipped or in the folders given."""
        return self._library.find(ref)

    def known_types(self) -> Sequence[TypeRef]:
        """Return the types of the rover's topics, services and action, and of what rosld advertises."""
        own = (each.type for each in self._topics.advertised.values())
        return list(dict.fromkeys([*self._types.values(), *own]))

    async def subscribe(self, topic: str, *, depth: int = 1) -> Subscription:
        """Subscribe to a topic; the first subscription has what the rover publishes there now."""
        is_first = not self._topics.is_subscribed(topic)
        subscription = self._topics.subscribe(topic, depth)
        if is_first and topic in PERIODIC and self._sink is not None:
            self._simulation.advance(time.monotonic())
            self._say(topic)
            self._due[topic] = time.monotonic() + self._period(topic)
        return subscription

    def age_ns(self, sample: Sample) -> int:
        """How long ago a sample was received."""
        return max(0, time.time_ns() - sample.received_ns)

    async def publish(
        self, topic: str, type: TypeRef, data: bytes, *, latch: bool = False, deadline: float
    ) -> Published:
        """Publish; nobody can come to match later, so that this never waits.

        Refused where the type is another, and for a velocity that cannot be read.
        """
        self._reachable(deadline)
        schema = self._message(type)
        if topic == CMD_VEL and schema.ref == self._types[CMD_VEL]:
            velocity = velocity_of(_decode(schema, data, topic))
            published = self._topics.publish(topic, type, data, latch)
            self._simulation.command(velocity, time.monotonic())
            return published
        return self._topics.publish(topic, type, data, latch)

    async def advertise(self, topic: str, type: TypeRef, *, deadline: float) -> None:
        """Nothing needs to be made beforehand: the rover hears what is published at once."""
        self._reachable(deadline)

    async def unadvertise(self, topic: str) -> None:
        """Stop advertising; the rover drives on as it was told last."""
        self._topics.unadvertise(topic)

    async def call(self, service: str, type: TypeRef, request: bytes, *, deadline: float) -> bytes:
        """Call a service of the rover. Refused for another type, and for bytes that are no request."""
        self._reachable(deadline)
        if service not in SERVICES:
            raise NotFound(f"there is no service {service}")
        schema = self._library.find(self._types[service])
        assert isinstance(schema, ServiceSchema)
        require_type(service, "service", schema.ref, type)
        answer = self._serve(service, _decode(schema.request, request, service))
        return encode(schema.response, answer._asdict())

    async def send_goal(self, action: str, type: TypeRef, goal: bytes, *, deadline: float) -> GoalId:
        """Have the rover drive somewhere. Refused for a pose that is none, and for another type."""
        self._reachable(deadline)
        schema = self._action(action)
        require_type(action, "action", schema.ref, type)
        try:
            pose = goal_of(_decode(schema.goal, goal, action))
        except Declined as declined:
            raise Refused(f"{action} rejected the goal", words=str(declined)) from declined
        id = secrets.token_hex(16)
        self._simulation.navigate(id, pose, time.monotonic())
        self._tell(id, GoalEvent(time.time_ns(), GoalStatus.ACCEPTED, goal=goal, own=True))
        self._tell_feedback(time.monotonic())
        return GoalId(action, id)

    async def cancel_goal(self, goal: GoalId, *, deadline: float) -> None:
        """Have the rover drive no further. NotFound where it does not pursue this goal."""
        self._reachable(deadline)
        self._action(goal.action)
        if not self._simulation.cancel(goal.id, time.monotonic()):
            raise NotFound(f"the rover does not pursue the goal {goal.id}")
        self._tell(goal.id, GoalEvent(time.time_ns(), GoalStatus.CANCELING, own=True))

    async def cancel_goals(self, action: str, *, deadline: float) -> None:
        """Have the rover drive no further, if it pursues a goal."""
        self._reachable(deadline)
        self._action(action)
        journey = self._simulation.state.journey
        if journey is not None:
            await self.cancel_goal(GoalId(action, journey.id), deadline=deadline)

    async def follow_goals(self, action: str, *, deadline: float) -> Watch:
        """Return a watch without effect: all its goals are announced in any case."""
        self._action(action)
        return NoWatch()

    async def change_state(self, node: str, transition: str, *, deadline: float) -> None:
        """Raise Refused: its node has no lifecycle; NotFound for a node that is not there."""
        raise without_lifecycle(self._graph.nodes, node)

    async def get_parameters(self, names: Sequence[str], *, deadline: float) -> Mapping[str, ParameterValue]:
        """Return the values of those names that exist."""
        self._reachable(deadline)
        found = {name: read(self._parameters, name) for name in names}
        return {name: value for name, value in found.items() if value is not None}

    async def set_parameters(self, values: Mapping[str, ParameterValue], *, deadline: float) -> None:
        """Set all of them or, when one is refused, none."""
        self._reachable(deadline)
        self._parameters = with_values(self._parameters, values)
        self._simulation.configure(self._parameters, time.monotonic())
        if self._sink is not None:
            for name in values:
                self._sink.parameter_changed(name)

    async def delete_parameters(self, names: Sequence[str], *, deadline: float) -> None:
        """Refused: the node keeps what it declared."""
        self._reachable(deadline)
        refuse_deletion(names)

    def _serve(self, service: str, request: Message) -> Answer:
        now = time.monotonic()
        if service != SET_LIGHTS:
            return self._simulation.dock(now)
        answer = self._simulation.switch_lights(switch_of(request), now)
        self._say(LIGHTS)
        return answer

    def _reachable(self, deadline: float) -> None:
        require_reachable(self._sink is not None, deadline, "rover")

    def _message(self, ref: TypeRef) -> MessageSchema:
        schema = self._library.find(ref)
        if not isinstance(schema, MessageSchema):
            raise Refused(f"{ref.name} is no message type: only messages can be published")
        return schema

    def _action(self, name: str) -> ActionSchema:
        if name not in ACTIONS:
            raise NotFound(f"there is no action {name}")
        schema = self._library.find(self._types[name])
        assert isinstance(schema, ActionSchema)
        return schema

    def _revise(self) -> None:
        self._graph = rover_graph(self._graph.revision + 1, self._types, self._topics.advertised)
        if self._sink is not None:
            self._sink.graph_changed(self._graph)

    def _tick(self) -> None:
        """Say what is due, and look again after a while."""
        now = time.monotonic()
        self._simulation.advance(now)
        for topic in PERIODIC:
            if now >= self._due.get(topic, now) and self._topics.is_subscribed(topic):
                self._say(topic)
                self._due[topic] = _next(self._due.get(topic, now), self._period(topic), now)
        self._tell_of_goals(now)
        for line in self._simulation.take_log():
            self._put(ROSOUT, log(line, time.time_ns()))
        self._timer = asyncio.get_running_loop().call_later(PERIOD, self._tick)

    def _period(self, topic: str) -> float:
        return 1 / PERIODIC[topic].rate(self._simulation.settings)

    def _say(self, topic: str) -> None:
        view = View(self._simulation.state, self._simulation.settings, self._simulation.world, time.time_ns())
        said = PERIODIC.get(topic) or LATCHED[topic]
        self._put(topic, said.say(view))

    def _put(self, topic: str, fields: Fields) -> None:
        data = encode(self._message(self._types[topic]), fields)
        self._topics.say(topic, NODE, data, latched=topic in LATCHED)

    def _tell_of_goals(self, now: float) -> None:
        """Tell which goals have ended, and from time to time how far the rover has come."""
        for ended in self._simulation.take_ended():
            self._tell_end(ended)
        if now >= self._due.get(NAVIGATE_TO, now):
            self._tell_feedback(now)

    def _tell_feedback(self, now: float) -> None:
        journey = self._simulation.state.journey
        if journey is None:
            return
        self._due[NAVIGATE_TO] = now + _FEEDBACK_PERIOD
        time_ns = time.time_ns()
        feedback = navigation_feedback(journey, self._simulation.state.motion, time_ns)
        data = encode(self._action(NAVIGATE_TO).feedback, feedback)
        self._tell(journey.id, GoalEvent(time_ns, GoalStatus.EXECUTING, feedback=data, own=True))

    def _tell_end(self, ended: JourneyEnd) -> None:
        time_ns = time.time_ns()
        result = navigation_result(ended, self._simulation.state.motion, time_ns)
        data = encode(self._action(NAVIGATE_TO).result, result)
        self._tell(ended.id, GoalEvent(time_ns, _STATUSES[ended.outcome], result=data, own=True))

    def _tell(self, id: str, event: GoalEvent) -> None:
        if self._sink is not None:
            self._sink.goal_changed(GoalId(NAVIGATE_TO, id), event)


def _decode(schema: MessageSchema, data: bytes, name: str) -> Message:
    try:
        return schema.codec.decode(data, ENCODING)
    except ValueError as error:
        raise Refused(f"{name} cannot read what it is given", words=str(error)) from error


def _next(due: float, period: float, now: float) -> float:
    """When a topic is due again: a period later, or from now on where a busy loop missed it."""
    return due + period if due + period > now else now + period
