"""A robot for tests: a talker and a listener, services that answer, hang and fail, and parameters.

Prints "ready" once it is complete, and "heard TEXT" for each message on /cockpit/display. SIGINT ends it in an orderly
way.
"""

from __future__ import annotations

import sys

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.context import Context
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from running import ENDING, begun, run, say
from std_msgs.msg import Float64, String
from std_srvs.srv import SetBool, Trigger

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BEST_EFFORT = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)


class Talker(Node):
    """Publisher of a count at 20 Hz on /counter, and of a latched description on /description."""

    def __init__(self, context: Context) -> None:
        super().__init__("talker", context=context)
        self.count = 0
        self.counter = self.create_publisher(Float64, "/counter", 10)
        self.description = self.create_publisher(String, "/description", LATCHED)
        self.hidden = self.create_publisher(String, "/_hidden/topic", 10)
        self.description.publish(String(data="a robot"))
        self.create_timer(0.05, self.tick)

    def tick(self) -> None:
        self.count += 1
        self.counter.publish(Float64(data=float(self.count)))


class Listener(Node):
    """Subscriber that prints messages; it has parameters of all kinds."""

    def __init__(self, context: Context) -> None:
        super().__init__("listener", context=context)
        self.create_subscription(String, "/cockpit/display", lambda m: say(f"heard {m.data}"), 10)
        self.create_subscription(String, "/shy/display", lambda m: say(f"shy heard {m.data}"), BEST_EFFORT)
        self.create_subscription(String, "/latched/display", lambda m: say(f"latched heard {m.data}"), LATCHED)
        self.declare_parameter("seats", 2)
        self.declare_parameter("speed", 1.5)
        self.declare_parameter("name", "Ada")
        self.declare_parameter("flying", False)
        self.declare_parameter("camera.exposures", [1.0, 2.0])
        self.declare_parameter("bytes", [b"\x01", b"\xff"])
        self.declare_parameter("odd/name with spaces", [1, 2])
        self.add_on_set_parameters_callback(self.judge)

    def judge(self, parameters: list) -> SetParametersResult:
        for each in parameters:
            if each.name == "seats" and each.value is not None and each.value > 4:
                return SetParametersResult(successful=False, reason="there are four seats at most")
        return SetParametersResult(successful=True)


class Free(Node):
    """A node that accepts any parameter."""

    def __init__(self, context: Context) -> None:
        super().__init__("free", context=context, allow_undeclared_parameters=True)


class Lamp(Node):
    """A node that declares parameters in every way; /lamp/grow declares one more, and redeclares another."""

    def __init__(self, context: Context) -> None:
        super().__init__("lamp", context=context)
        level = ParameterDescriptor(description="How bright it is.", additional_constraints="Even looks best.")
        level.integer_range = [IntegerRange(from_value=0, to_value=20, step=5)]
        gain = ParameterDescriptor(floating_point_range=[FloatingPointRange(from_value=0.0, to_value=1.0, step=0.1)])
        self.declare_parameter("level", 5, level)
        self.declare_parameter("gain", 0.5, gain)
        self.declare_parameter("serial", "A7", ParameterDescriptor(read_only=True))
        self.declare_parameter("any", 1, ParameterDescriptor(dynamic_typing=True))
        self.declare_parameter("weights", [0.5, 1.0])
        self.declare_parameter("later", Parameter.Type.INTEGER)
        self.declare_parameter("changed", 1, ParameterDescriptor(description="As it was."))
        self.create_service(Trigger, "/lamp/grow", self.grow)

    def grow(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.declare_parameter("grown", True, ParameterDescriptor(description="New."))
        self.undeclare_parameter("changed")
        self.declare_parameter("changed", 1, ParameterDescriptor(description="As it is."))
        response.success = True
        return response


class Server(Node):
    """Services: one that answers, one that hangs, and any number of further ones that answer."""

    def __init__(self, context: Context, many: int) -> None:
        super().__init__("server", context=context)
        group = ReentrantCallbackGroup()
        self.create_service(Trigger, "/get_power", self.answer, callback_group=group)
        self.create_service(SetBool, "/set_power", self.switch, callback_group=group)
        self.create_service(Trigger, "/hangs", self.hang, callback_group=group)
        for number in range(many):
            self.create_service(Trigger, f"/many/service_{number}", self.answer, callback_group=group)

    def answer(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = True, "off"
        return response

    def switch(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        response.success, response.message = True, "on" if request.data else "off"
        return response

    def hang(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        ENDING.wait(60)
        return response


def main(many: int) -> None:
    context = begun()
    nodes = [Talker(context), Listener(context), Free(context), Lamp(context), Server(context, many)]
    run(context, MultiThreadedExecutor(8, context=context), nodes)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 0)
