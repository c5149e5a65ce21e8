"""The rover as an rclpy node, `/rover`: the simulation that rosld embeds, connected to a real ROS 2.

    rclpy_rover.py [rover:?battery=0.21&rate=10]

It continues with the last command, as the embedded one does. Prints "ready"; SIGINT ends it in an orderly way.
"""

from __future__ import annotations

import array
import importlib
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "ros2" / "nodes"))

import numpy as np
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.task import Future
from rosld_rover.action import NavigateTo
from running import begun, run
from std_srvs.srv import SetBool, Trigger

from rosld.adapters.model import GoalStatus
from rosld.adapters.rover.graph import (
    CMD_VEL,
    DOCK,
    LATCHED,
    LIGHTS,
    NAVIGATE_TO,
    PERIODIC,
    SET_LIGHTS,
    TOPICS,
    Latched,
    Periodic,
)
from rosld.adapters.rover.messages import View, navigation_feedback, navigation_result
from rosld.adapters.rover.navigation import Declined, JourneyEnd, goal_of, velocity_of
from rosld.adapters.rover.settings import DEFAULTS, PARAMETERS, Declaration, problem_of
from rosld.adapters.rover.simulation import LogLine, Severity, Simulation, Start, read_source

PERIOD = 0.05
FEEDBACK_PERIOD = 0.2
SENSORS = ("/scan", "/imu", "/camera/")
"""Topics that are published best effort, as drivers of sensors do."""
BEST_EFFORT = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
TRANSIENT_LOCAL = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def class_of(type: str) -> Any:
    """Return the class of a type such as `nav_msgs/msg/Odometry`, or `nav_msgs/Odometry` as in fields."""
    package, *_, name = type.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def fill(made: Any, fields: Mapping[str, object]) -> Any:
    """Return a message with exactly these fields."""
    types = made.get_fields_and_field_types()
    assert types.keys() == fields.keys(), f"{type(made).__name__} has {types.keys()}, not {fields.keys()}"
    for name, value in fields.items():
        setattr(made, name, convert(types[name], getattr(made, name), value))
    return made


def convert(type: str, empty: Any, value: Any) -> Any:
    """Return a value of a message converted to the type of a field with this empty value."""
    if isinstance(value, Mapping):
        return fill(empty, value)
    if type == "octet":
        return bytes([value])
    if isinstance(value, np.ndarray):
        return array.array(value.dtype.char, value.tobytes()) if type.startswith("sequence<") else value
    if isinstance(value, list):
        element = class_of(type.removeprefix("sequence<").removesuffix(">"))
        return [fill(element(), each) for each in value]
    return value


def quality_of(topic: str) -> QoSProfile:
    if topic in LATCHED:
        return TRANSIENT_LOCAL
    return BEST_EFFORT if topic.startswith(SENSORS) else QoSProfile(depth=10)


def descriptor_of(declared: Declaration) -> ParameterDescriptor:
    """Return the declaration of a parameter."""
    made = ParameterDescriptor(
        description=declared.description,
        additional_constraints=declared.constraints,
        read_only=declared.is_read_only,
    )
    if declared.least is not None and declared.greatest is not None:
        ends = {"from_value": declared.least, "to_value": declared.greatest}
        if isinstance(declared.default, int):
            made.integer_range = [IntegerRange(**ends)]
        else:
            made.floating_point_range = [FloatingPointRange(**ends)]
    return made


class Rover(Node):
    def __init__(self, context: Context, start: Start) -> None:
        super().__init__("rover", context=context)
        self.simulation = Simulation(start, time.monotonic())
        self.due: dict[str, float] = {}
        self.goals: dict[str, Any] = {}
        self.ends: dict[str, Future] = {}
        self.voices = {
            name: self.create_publisher(class_of(each.type), name, quality_of(name))
            for name, each in {**PERIODIC, **LATCHED}.items()
        }
        for name, latched in LATCHED.items():
            self.say(name, latched)
        for name, declared in PARAMETERS.items():
            self.declare_parameter(name, declared.default, descriptor_of(declared))
        self.add_on_set_parameters_callback(self.judge)
        self.add_post_set_parameters_callback(self.configure)
        self.create_subscription(class_of(TOPICS[CMD_VEL]), CMD_VEL, self.command, 10)
        self.create_service(SetBool, SET_LIGHTS, self.switch_lights)
        self.create_service(Trigger, DOCK, self.dock)
        self.actions = ActionServer(
            self,
            NavigateTo,
            NAVIGATE_TO,
            self.pursue,
            goal_callback=self.permissions,
            handle_accepted_callback=self.depart,
            cancel_callback=self.cancel,
        )
        self.create_timer(PERIOD, self.tick)

    def command(self, twist: Any) -> None:
        self.simulation.command(velocity_of(twist), time.monotonic())

    def switch_lights(self, request: Any, response: Any) -> Any:
        answer = self.simulation.switch_lights(request.data, time.monotonic())
        self.say(LIGHTS, LATCHED[LIGHTS])
        return fill(response, answer._asdict())

    def dock(self, _: Any, response: Any) -> Any:
        return fill(response, self.simulation.dock(time.monotonic())._asdict())

    def judge(self, parameters: list[Any]) -> SetParametersResult:
        problems = [problem_of(each.name, each.value) for each in parameters if each.name in PARAMETERS]
        reason = next((problem for problem in problems if problem is not None), "")
        return SetParametersResult(successful=not reason, reason=reason)

    def configure(self, _: list[Any]) -> None:
        self.simulation.configure({name: self.get_parameter(name).value for name in DEFAULTS}, time.monotonic())

    def permissions(self, goal: Any) -> GoalResponse:
        try:
            goal_of(goal)
        except Declined as declined:
            self.get_logger().warning(f"a goal is rejected: {declined}")
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def depart(self, handle: Any) -> None:
        id = bytes(handle.goal_id.uuid).hex()
        self.goals[id], self.ends[id] = handle, Future()
        self.simulation.navigate(id, goal_of(handle.request), time.monotonic())
        handle.execute()

    async def pursue(self, handle: Any) -> NavigateTo.Result:
        id = bytes(handle.goal_id.uuid).hex()
        ended: JourneyEnd = await self.ends[id]
        del self.goals[id], self.ends[id]
        ways = {GoalStatus.SUCCEEDED: handle.succeed, GoalStatus.ABORTED: handle.abort}
        ways.get(ended.outcome, handle.canceled)()
        result = navigation_result(ended, self.simulation.state.motion, time.time_ns())
        return fill(NavigateTo.Result(), result)

    def cancel(self, handle: Any) -> CancelResponse:
        canceled = self.simulation.cancel(bytes(handle.goal_id.uuid).hex(), time.monotonic())
        return CancelResponse.ACCEPT if canceled else CancelResponse.REJECT

    def tick(self) -> None:
        now = time.monotonic()
        self.simulation.advance(now)
        for name, each in PERIODIC.items():
            if now >= self.due.get(name, now) and self.voices[name].get_subscription_count():
                self.say(name, each)
                period = each.period(self.simulation.settings)
                self.due[name] = max(self.due.get(name, now), now - PERIOD) + period
        self.tell_of_goals(now)
        for line in self.simulation.take_log():
            self.log(line)

    def log(self, line: LogLine) -> None:
        """Log a line; rclpy requires a separate source line per severity."""
        if line.severity is Severity.INFO:
            self.get_logger().info(line.text)
        elif line.severity is Severity.WARN:
            self.get_logger().warning(line.text)
        else:
            self.get_logger().error(line.text)

    def tell_of_goals(self, now: float) -> None:
        for ended in self.simulation.take_ended():
            self.ends[ended.id].set_result(ended)
        journey, motion = self.simulation.state.journey, self.simulation.state.motion
        if journey is not None and now >= self.due.get(NAVIGATE_TO, now):
            self.due[NAVIGATE_TO] = now + FEEDBACK_PERIOD
            feedback = navigation_feedback(journey, motion, time.time_ns())
            self.goals[journey.id].publish_feedback(fill(NavigateTo.Feedback(), feedback))

    def say(self, name: str, each: Periodic | Latched) -> None:
        simulation = self.simulation
        view = View(simulation.state, simulation.settings, simulation.world, time.time_ns())
        self.voices[name].publish(fill(class_of(each.type)(), each.compose(view)))


def main(source: str) -> None:
    start = read_source(source)
    context = begun()
    run(context, SingleThreadedExecutor(context=context), [Rover(context, start)])


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "rover")
