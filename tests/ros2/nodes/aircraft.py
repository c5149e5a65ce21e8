"""The paper's aircraft as nodes of a real ROS 2: the twin of the rospy one and of rosld's embedded one.

Three nodes in one process, as composed nodes are: the aircraft, its cockpit, which prints "display TEXT" for what it is
shown, and `/paper`, which takes any parameter, as the parameter server of ROS 1 does. Prints "ready" when all is there;
SIGINT ends it tidily.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.context import Context
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rosld_aircraft.action import Fly
from rosld_aircraft.srv import GetNumber, GetText, SetNumber, SetText
from running import ENDING, begun, run, say
from std_msgs.msg import Float64, String
from std_srvs.srv import Trigger

ACCELERATION = 100.0
PERIOD = 0.1
PARAMETERS = {
    "aircraft": {
        "registration": "RO-SLD",
        "seats": 2,
        "engine/cylinders": 6,
        "engine/limits/oil_pressure": 4.5,
        "engine/limits/temperature": 230.0,
    },
    "cockpit": {"brightness": 0.8, "night": False, "checklist": ["fuel", "flaps", "radio"]},
}


class Declined(Exception):
    """What the aircraft will not do now."""


class Flight:
    """Power, speed and direction; the speed follows the command by 100 a second."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.on = False
        self.speed = self.commanded = self.direction = self.way = 0.0
        self.at = time.monotonic()

    def advance(self) -> float:
        """The speed now."""
        now = time.monotonic()
        lasted, self.at = now - self.at, now
        step, missing = ACCELERATION * lasted, self.commanded - self.speed
        self.speed = self.commanded if abs(missing) <= step else self.speed + (step if missing > 0 else -step)
        self.way += self.speed * lasted
        return self.speed

    def start(self) -> None:
        if self.on:
            raise Declined("the aircraft is already started")
        self.on = True

    def stop(self) -> None:
        if self.on and self.speed > 0:
            raise Declined("the aircraft still moves: set the speed to 0 first")
        self.on, self.speed, self.commanded = False, 0.0, 0.0

    def power(self, word: str) -> None:
        if word not in ("on", "off"):
            raise Declined(f"the power is 'on' or 'off', not {word!r}")
        (self.start if word == "on" else self.stop)()

    def accelerate(self, speed: float) -> None:
        self.commanded = self.settable("speed", speed, 1000.0)

    def turn(self, direction: float) -> None:
        self.direction = self.settable("direction", direction, 360.0)

    def settable(self, what: str, value: float, limit: float) -> float:
        if not self.on:
            raise Declined(f"the aircraft is off: start it before setting its {what}")
        if not 0.0 <= value <= limit:
            raise Declined(f"the {what} must be between 0 and {limit:g}, not {value:g}")
        return value + 0.0


class Aircraft(Node):
    """The node /aircraft."""

    def __init__(self, context: Context) -> None:
        super().__init__("aircraft", context=context)
        self.flight = flight = Flight()
        declare(self)
        self.speed = self.create_publisher(Float64, "/aircraft/engine/speed", 10)
        self.command("/aircraft/start", Trigger, lambda _: flight.start(), "started")
        self.command("/aircraft/stop", Trigger, lambda _: flight.stop(), "stopped")
        self.command("/aircraft/set_power", SetText, lambda asked: flight.power(asked.data), "power set")
        self.command("/aircraft/engine/set_speed", SetNumber, lambda asked: flight.accelerate(asked.data), "speed set")
        self.command(
            "/aircraft/engine/set_direction", SetNumber, lambda asked: flight.turn(asked.data), "direction set"
        )
        self.getter("/aircraft/get_power", GetText, lambda: "on" if flight.on else "off")
        self.getter("/aircraft/engine/get_direction", GetNumber, lambda: flight.direction)
        self.create_timer(PERIOD, self.tell)
        self.action = ActionServer(
            self,
            Fly,
            "/aircraft/fly",
            self.fly,
            goal_callback=self.permissions,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=ReentrantCallbackGroup(),
        )

    def tell(self) -> None:
        with self.flight.lock:
            speed = self.flight.advance()
        self.speed.publish(Float64(data=speed))

    def command(self, name: str, kind: Any, act: Callable[[Any], None], done: str) -> None:
        """A service that answers with success and a message."""

        def answer(request: Any, response: Any) -> Any:
            with self.flight.lock:
                self.flight.advance()
                try:
                    act(request)
                    response.success, response.message = True, done
                except Declined as words:
                    response.success, response.message = False, str(words)
            return response

        self.create_service(kind, name, answer)

    def getter(self, name: str, kind: Any, ask: Callable[[], object]) -> None:
        """A service that answers with a value."""

        def answer(_: Any, response: Any) -> Any:
            with self.flight.lock:
                response.data = ask()
            return response

        self.create_service(kind, name, answer)

    def permissions(self, goal: Any) -> GoalResponse:
        """A distance that is none is rejected, and so is every goal while the aircraft is off."""
        with self.flight.lock:
            return GoalResponse.ACCEPT if self.flight.on and goal.distance > 0.0 else GoalResponse.REJECT

    def fly(self, goal: Any) -> Any:
        """Tell how far it has flown until that is far enough; an aircraft that is switched off aborts."""
        asked = goal.request.distance
        with self.flight.lock:
            began = self.flight.way
        while True:
            with self.flight.lock:
                self.flight.advance()
                flown, on = self.flight.way - began, self.flight.on
            goal.publish_feedback(Fly.Feedback(flown=flown))
            if not on:
                goal.abort()
                return Fly.Result(flown=flown, message="the aircraft is off")
            if goal.is_cancel_requested:
                goal.canceled()
                return Fly.Result(flown=flown, message="canceled")
            if flown >= asked:
                goal.succeed()
                return Fly.Result(flown=flown, message="there")
            if ENDING.wait(PERIOD):
                goal.abort()
                return Fly.Result(flown=flown, message="the node ends")


class Cockpit(Node):
    """The node /cockpit."""

    def __init__(self, context: Context) -> None:
        super().__init__("cockpit", context=context)
        declare(self)
        self.create_subscription(String, "/cockpit/display", lambda text: say(f"display {text.data}"), 1000)


class Paper(Node):
    """The node /paper, whose parameters come and go as clients want."""

    def __init__(self, context: Context) -> None:
        super().__init__("paper", context=context, allow_undeclared_parameters=True)


def declare(node: Node) -> None:
    for name, value in PARAMETERS[node.get_name()].items():
        node.declare_parameter(name, value)


def main() -> None:
    context = begun()
    executor = MultiThreadedExecutor(4, context=context)
    run(context, executor, [Aircraft(context), Cockpit(context), Paper(context)])


if __name__ == "__main__":
    main()
