"""Embedded rover: a mobile robot of one node on the server's event loop.

It resembles a ROS 2 robot: messages in CDR, parameters declared by its node. Messages of a topic are created only while
the topic has a subscription.
"""

from __future__ import annotations

import asyncio
import secrets
import time
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple, cast

from rosld.adapters.base import AdapterOptions, Capabilities, Published, Subscription
from rosld.adapters.embedded import EmbeddedRobot, Interface
from rosld.adapters.model import (
    Choice,
    Descriptor,
    GoalEvent,
    GoalId,
    GoalStatus,
    Message,
    MessageSchema,
    NotFound,
    Operation,
    Parameter,
    ParameterType,
    ParameterValue,
    Range,
    Refused,
    Sent,
    TypeRef,
    coerce,
    freeze,
)
from rosld.adapters.rover.messages import (
    ENCODING,
    Fields,
    View,
    battery_state,
    camera_info,
    compressed_image,
    diagnostics,
    encode,
    fixed_transforms,
    imu,
    laser_scan,
    lights,
    log,
    navigation_feedback,
    navigation_result,
    occupancy_grid,
    odometry,
    raw_image,
    transforms,
)
from rosld.adapters.rover.navigation import Declined, JourneyEnd, Outcome, goal_of, velocity_of
from rosld.adapters.rover.settings import DEFAULTS, NODE, PARAMETERS, Declaration, Settings, Value, problem_of
from rosld.adapters.rover.simulation import Simulation, Start

CMD_VEL = "/cmd_vel"
CMD_VEL_TYPE = "geometry_msgs/msg/Twist"
ROSOUT = "/rosout"
ROSOUT_TYPE = "rcl_interfaces/msg/Log"
LIGHTS = "/lights"
NAVIGATE_TO = "/navigate_to"
NAVIGATE_TO_TYPE = "rosld_rover/action/NavigateTo"
SET_LIGHTS = "/set_lights"
SET_LIGHTS_TYPE = "std_srvs/srv/SetBool"
DOCK = "/dock"
DOCK_TYPE = "std_srvs/srv/Trigger"
_HERTZ = 20.0


class Periodic(NamedTuple):
    """A topic that is published periodically: its type, a function for its message, and the rate in hertz."""

    type: str
    compose: Callable[[View], Fields]
    rate: Callable[[Settings], float]


class Latched(NamedTuple):
    """A latched topic, which is published once and after each change."""

    type: str
    compose: Callable[[View], Fields]


def _always(rate: float) -> Callable[[Settings], float]:
    return lambda _: rate


def _scan_rate(settings: Settings) -> float:
    return float(settings.scan_rate)


def _camera_rate(settings: Settings) -> float:
    return float(settings.camera_rate)


PERIODIC: Mapping[str, Periodic] = MappingProxyType(
    {
        "/odom": Periodic("nav_msgs/msg/Odometry", odometry, _always(_HERTZ)),
        "/tf": Periodic("tf2_msgs/msg/TFMessage", transforms, _always(_HERTZ)),
        "/imu": Periodic("sensor_msgs/msg/Imu", imu, _always(_HERTZ)),
        "/scan": Periodic("sensor_msgs/msg/LaserScan", laser_scan, _scan_rate),
        "/camera/image_raw": Periodic("sensor_msgs/msg/Image", raw_image, _camera_rate),
        "/camera/image_raw/compressed": Periodic("sensor_msgs/msg/CompressedImage", compressed_image, _camera_rate),
        "/camera/camera_info": Periodic("sensor_msgs/msg/CameraInfo", camera_info, _camera_rate),
        "/battery_state": Periodic("sensor_msgs/msg/BatteryState", battery_state, _always(1.0)),
        "/diagnostics": Periodic("diagnostic_msgs/msg/DiagnosticArray", diagnostics, _always(1.0)),
    }
)
LATCHED: Mapping[str, Latched] = MappingProxyType(
    {
        "/map": Latched("nav_msgs/msg/OccupancyGrid", occupancy_grid),
        "/tf_static": Latched("tf2_msgs/msg/TFMessage", fixed_transforms),
        LIGHTS: Latched("std_msgs/msg/Bool", lights),
    }
)


TOPICS: Mapping[str, str] = {
    CMD_VEL: CMD_VEL_TYPE,
    ROSOUT: ROSOUT_TYPE,
    **{name: topic.type for name, topic in PERIODIC.items()},
    **{name: topic.type for name, topic in LATCHED.items()},
}
"""Types of the rover's topics."""
SERVICES: Mapping[str, str] = {SET_LIGHTS: SET_LIGHTS_TYPE, DOCK: DOCK_TYPE}
ACTIONS: Mapping[str, str] = {NAVIGATE_TO: NAVIGATE_TO_TYPE}
_TYPES: Mapping[type, ParameterType] = {
    bool: ParameterType.BOOLEAN,
    int: ParameterType.INTEGER,
    float: ParameterType.DOUBLE,
    str: ParameterType.STRING,
}


def _descriptor(declared: Declaration) -> Descriptor:
    limits = None
    if declared.least is not None and declared.greatest is not None:
        limits = Range(declared.least, declared.greatest)
    return Descriptor(
        _TYPES[type(declared.default)],
        declared.description,
        declared.is_read_only,
        range=limits,
        choices=tuple(Choice(value, description=words) for value, words in (declared.choices or {}).items()),
    )


GRAPH_PARAMETERS = freeze(
    {f"{NODE}/{name}": Parameter(f"{NODE}/{name}", NODE, _descriptor(each)) for name, each in PARAMETERS.items()}
)


_PREFIX = f"{NODE}/"


def operations_on(name: str) -> frozenset[Operation]:
    """Return the operations on a parameter: declared ones cannot be deleted, and others do not exist."""
    declared = PARAMETERS.get(name.removeprefix(_PREFIX)) if name.startswith(_PREFIX) else None
    if declared is None:
        return frozenset()
    return frozenset({Operation.GET_PARAMETER, *([] if declared.is_read_only else [Operation.SET_PARAMETER])})


def read(values: Mapping[str, Value], name: str) -> ParameterValue | None:
    """Return the value of a name, a dict for the node's name or `/`, or None."""
    if name == "/":
        return {NODE.strip("/"): {**values}}
    if name == NODE:
        return {**values}
    return values.get(name.removeprefix(_PREFIX)) if name.startswith(_PREFIX) else None


def with_values(values: Mapping[str, Value], changes: Mapping[str, ParameterValue]) -> Mapping[str, Value]:
    """Return the values with the given ones set. Raises NotFound, and Refused with the node's reason."""
    changed = dict(values)
    for name, value in changes.items():
        if not name.startswith(_PREFIX):
            raise NotFound(f"the parameter {name} belongs to no node: those of the rover begin with {_PREFIX}")
        short = name.removeprefix(_PREFIX)
        if short not in PARAMETERS:
            raise _refusal(name, f"{short} is not declared")
        fit = _fit(name, value)
        if (problem := problem_of(short, fit)) is not None:
            raise _refusal(name, problem)
        changed[short] = cast(Value, fit)
    return changed


def refuse_deletion(names: Sequence[str]) -> None:
    """Raise Refused for a declared parameter, which cannot be deleted, and NotFound for others."""
    for name in names:
        if name not in GRAPH_PARAMETERS:
            raise NotFound(f"there is no parameter {name}")
        raise _refusal(name, "it was declared by its node, which keeps it")


def _fit(name: str, value: ParameterValue) -> ParameterValue:
    """Return the value converted to the declared type if possible; the node checks other values."""
    descriptor = GRAPH_PARAMETERS[name].descriptor
    fit = None if descriptor is None or descriptor.type is None else coerce(value, descriptor.type)
    return value if fit is None else fit


def _refusal(name: str, words: str) -> Refused:
    return Refused(f"{NODE} refuses the parameter {name}", words=words, sent=Sent.YES)


PERIOD = 0.05
"""Seconds between checks of what is due."""
_FEEDBACK_PERIOD = 0.2
_CAPABILITIES = Capabilities(system="rover", encoding=ENCODING, writes=True, creates_topics=True, parameter_trees=False)
_STATUSES: Mapping[Outcome, GoalStatus] = MappingProxyType(
    {
        Outcome.SUCCEEDED: GoalStatus.SUCCEEDED,
        Outcome.CANCELED: GoalStatus.CANCELED,
        Outcome.ABORTED: GoalStatus.ABORTED,
    }
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

    async def close(self) -> None:
        """Stop the rover, end its goal, and stop advertising. Idempotent."""
        goal = self._current_goal()
        if goal is not None:
            event = GoalEvent(time.time_ns(), GoalStatus.LOST, "the rover is no longer there", own=True)
            self._announce(NAVIGATE_TO, goal, event)
        await super().close()

    async def subscribe(self, topic: str, *, depth: int = 1) -> Subscription:
        """Subscribe to a topic. The first subscription immediately receives the current message of a periodic topic."""
        is_first = not self._topics.is_subscribed(topic)
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
        if topic != CMD_VEL or schema.ref != self._types[CMD_VEL]:
            return self._topics.publish(topic, type, data, latch)
        velocity = velocity_of(self._decode(schema, data, topic))
        published = self._topics.publish(topic, type, data, latch)
        self._simulation.command(velocity, time.monotonic())
        return published

    async def send_goal(self, action: str, type: TypeRef, goal: bytes, *, deadline: float) -> GoalId:
        """Send a goal for navigation. Raises Refused for an invalid pose, and for another type."""
        sent = await super().send_goal(action, type, goal, deadline=deadline)
        self._report_feedback(time.monotonic())
        return sent

    async def get_parameters(self, names: Sequence[str], *, deadline: float) -> Mapping[str, ParameterValue]:
        """Return the values of existing parameters."""
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

    def _encode(self, schema: MessageSchema, fields: Mapping[str, object]) -> bytes:
        return encode(schema, fields)  # arrays are not copied

    def _current_goal(self) -> str | None:
        journey = self._simulation.state.journey
        return journey.id if journey is not None else None

    def _tick(self) -> None:
        """Publish what is due, and schedule the next check."""
        now = time.monotonic()
        self._simulation.advance(now)
        for topic in PERIODIC:
            if now >= self._due.get(topic, now) and self._topics.is_subscribed(topic):
                self._publish_current(topic)
                self._due[topic] = _next(self._due.get(topic, now), self._period(topic), now)
        self._report_goals(now)
        for line in self._simulation.take_log():
            self._publish(ROSOUT, log(line, time.time_ns()))
        self._timer = asyncio.get_running_loop().call_later(PERIOD, self._tick)

    def _period(self, topic: str) -> float:
        return 1 / PERIODIC[topic].rate(self._simulation.settings)

    def _publish_current(self, topic: str) -> None:
        view = View(self._simulation.state, self._simulation.settings, self._simulation.world, time.time_ns())
        entry = PERIODIC.get(topic) or LATCHED[topic]
        self._publish(topic, entry.compose(view))

    def _report_goals(self, now: float) -> None:
        """Report ended goals and, periodically, the progress of the rover."""
        for ended in self._simulation.take_ended():
            self._report_end(ended)
        if now >= self._due.get(NAVIGATE_TO, now):
            self._report_feedback(now)

    def _report_feedback(self, now: float) -> None:
        journey = self._simulation.state.journey
        if journey is None:
            return
        self._due[NAVIGATE_TO] = now + _FEEDBACK_PERIOD
        time_ns = time.time_ns()
        feedback = navigation_feedback(journey, self._simulation.state.motion, time_ns)
        data = encode(self._action(NAVIGATE_TO).feedback, feedback)
        self._announce(NAVIGATE_TO, journey.id, GoalEvent(time_ns, GoalStatus.EXECUTING, feedback=data, own=True))

    def _report_end(self, ended: JourneyEnd) -> None:
        time_ns = time.time_ns()
        result = navigation_result(ended, self._simulation.state.motion, time_ns)
        data = encode(self._action(NAVIGATE_TO).result, result)
        self._announce(NAVIGATE_TO, ended.id, GoalEvent(time_ns, _STATUSES[ended.outcome], result=data, own=True))


def _next(due: float, period: float, now: float) -> float:
    """Return when a topic is due next: one period later, or one period from now if a busy loop missed that."""
    return due + period if due + period > now else now + period
