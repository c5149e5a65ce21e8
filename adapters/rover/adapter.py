"""Embedded rover: a mobile robot of one node on the server's event loop.

It resembles a ROS 2 robot: messages in CDR, parameters declared by its node. Messages of a topic are created only while
the topic has a subscription.
"""

from __future__ import annotations

import asyncio
import secrets
import time
from collections.abc import Mapping, Sequence
from typing import Any

from rosld.adapters.base import AdapterOptions, Capabilities, Published, Subscription
from rosld.adapters.embedded import EmbeddedRobot, Interface
from rosld.adapters.model import (
    Encoding,
    GoalEvent,
    GoalId,
    GoalStatus,
    Message,
    Operation,
    Parameter,
    Refused,
    TypeRef,
)
from rosld.adapters.model.parameter import ParameterValue
from rosld.adapters.rover.graph import (
    ACTIONS,
    CMD_VEL,
    GRAPH_PARAMETERS,
    LATCHED,
    LIGHTS,
    NAVIGATE_TO,
    PERIODIC,
    ROSOUT,
    SERVICES,
    SET_LIGHTS,
    TOPICS,
    operations_on,
    read,
    refuse_deletion,
    with_values,
)
from rosld.adapters.rover.messages import View, log, navigation_feedback, navigation_result
from rosld.adapters.rover.navigation import Declined, JourneyEnd, goal_of, velocity_of
from rosld.adapters.rover.settings import DEFAULTS, NODE
from rosld.adapters.rover.simulation import Simulation, Start

PERIOD = 0.05
"""Seconds between checks of what is due."""
_FEEDBACK_PERIOD = 0.2
_CAPABILITIES = Capabilities(
    system="rover", encoding=Encoding.CDR, writes=True, creates_topics=True, parameter_trees=False
)


class Rover(EmbeddedRobot):
    """The rover as an `Adapter`."""

    def __init__(self, start: Start, options: AdapterOptions) -> None:
        super().__init__(
            _CAPABILITIES,
            options,
            published={
                name: Interface(type, NODE, latched=name in LATCHED) for name, type in TOPICS.items() if name != CMD_VEL
            },
            subscribed={CMD_VEL: Interface(TOPICS[CMD_VEL], NODE)},
            services={name: Interface(type, NODE) for name, type in SERVICES.items()},
            actions={name: Interface(type, NODE) for name, type in ACTIONS.items()},
        )
        self._start_state = start
        self._simulation = Simulation(start, time.monotonic())
        self._parameters = DEFAULTS
        self._due: dict[str, float] = {}

    def _start(self) -> None:
        self._parameters = DEFAULTS
        self._simulation = Simulation(self._start_state, time.monotonic())
        for topic in LATCHED:
            self._publish_current(topic)
        self._tick()

    async def subscribe(self, topic: str, *, depth: int = 1) -> Subscription:
        """Subscribe to a topic. The first subscription immediately receives the current message of a periodic topic."""
        is_first = not self._is_subscribed(topic)
        subscription = await super().subscribe(topic, depth=depth)
        if is_first and topic in PERIODIC and self._sink is not None:
            self._simulation.advance(time.monotonic())
            self._publish_current(topic)
            self._due[topic] = time.monotonic() + self._period(topic)
        return subscription

    async def publish(
        self, topic: str, type: TypeRef, data: bytes, *, latch: bool = False, deadline: float
    ) -> Published:
        """Publish a message. Never waits, because no subscriber can match later.

        Raises Refused for another type, and for a velocity that cannot be decoded.
        """
        self._require_reachable(deadline)
        schema = self._message(type)
        is_command = topic == CMD_VEL and schema.ref == self._types[CMD_VEL]
        velocity = velocity_of(self._decode(schema, data, topic)) if is_command else None
        published = await super().publish(topic, type, data, latch=latch, deadline=deadline)
        if velocity is not None:
            self._simulation.command(velocity, time.monotonic())
        return published

    async def send_goal(self, action: str, type: TypeRef, goal: bytes, *, deadline: float) -> GoalId:
        """Send a goal for navigation. Raises Refused for an invalid pose, and for another type."""
        sent = await super().send_goal(action, type, goal, deadline=deadline)
        self._report_feedback(time.monotonic())
        return sent

    async def get_parameters(self, names: Sequence[str], *, deadline: float) -> Mapping[str, ParameterValue]:
        self._require_reachable(deadline)
        values = {name: read(self._parameters, name) for name in names}
        return {name: value for name, value in values.items() if value is not None}

    async def set_parameters(self, values: Mapping[str, ParameterValue], *, deadline: float) -> None:
        """Set all parameters, or none if one is refused."""
        self._require_reachable(deadline)
        self._parameters = with_values(self._parameters, values)
        self._simulation.configure(self._parameters, time.monotonic())
        if self._sink is not None:
            for name in values:
                self._sink.parameter_changed(name)

    async def delete_parameters(self, names: Sequence[str], *, deadline: float) -> None:
        """Raise Refused, because declared parameters cannot be deleted, or NotFound for others."""
        self._require_reachable(deadline)
        refuse_deletion(names)

    def _answer(self, service: str, request: Any) -> Mapping[str, object]:
        now = time.monotonic()
        if service != SET_LIGHTS:
            return self._simulation.dock(now)._asdict()
        answer = self._simulation.switch_lights(request.data, now)
        self._publish_current(LIGHTS)
        return answer._asdict()

    def _accept(self, action: str, goal: Message) -> str:
        id = secrets.token_hex(16)
        try:
            self._simulation.navigate(id, goal_of(goal), time.monotonic())
        except Declined as declined:
            raise Refused(f"{action} rejected the goal", words=str(declined)) from declined
        return id

    def _cancel(self, id: str) -> bool:
        return self._simulation.cancel(id, time.monotonic())

    def _parameters_of_graph(self) -> Mapping[str, Parameter]:
        return GRAPH_PARAMETERS

    def _parameter_operations(self, name: str) -> frozenset[Operation]:
        return operations_on(name)

    def _current_goal(self) -> str | None:
        journey = self._simulation.state.journey
        return journey.id if journey is not None else None

    def _tick(self) -> None:
        """Publish what is due, and schedule the next check."""
        now = time.monotonic()
        self._simulation.advance(now)
        for topic in PERIODIC:
            if now >= self._due.get(topic, now) and self._is_subscribed(topic):
                self._publish_current(topic)
                period, due = self._period(topic), self._due.get(topic, now)
                self._due[topic] = due + period if due + period > now else now + period  # a busy loop may miss some
        for ended in self._simulation.take_ended():
            self._report_end(ended)
        if now >= self._due.get(NAVIGATE_TO, now):
            self._report_feedback(now)
        for line in self._simulation.take_log():
            self._publish(ROSOUT, log(line, time.time_ns()))
        self._timer = asyncio.get_running_loop().call_later(PERIOD, self._tick)

    def _period(self, topic: str) -> float:
        return PERIODIC[topic].period(self._simulation.settings)

    def _publish_current(self, topic: str) -> None:
        view = View(self._simulation.state, self._simulation.settings, self._simulation.world, time.time_ns())
        entry = PERIODIC.get(topic) or LATCHED[topic]
        self._publish(topic, entry.compose(view))

    def _report_feedback(self, now: float) -> None:
        journey = self._simulation.state.journey
        if journey is None:
            return
        self._due[NAVIGATE_TO] = now + _FEEDBACK_PERIOD
        time_ns = time.time_ns()
        feedback = navigation_feedback(journey, self._simulation.state.motion, time_ns)
        data = self._encode(self._action(NAVIGATE_TO).feedback, feedback)
        self._announce(NAVIGATE_TO, journey.id, GoalEvent(time_ns, GoalStatus.EXECUTING, feedback=data, own=True))

    def _report_end(self, ended: JourneyEnd) -> None:
        time_ns = time.time_ns()
        result = navigation_result(ended, self._simulation.state.motion, time_ns)
        data = self._encode(self._action(NAVIGATE_TO).result, result)
        self._announce(NAVIGATE_TO, ended.id, GoalEvent(time_ns, ended.outcome, result=data, own=True))
