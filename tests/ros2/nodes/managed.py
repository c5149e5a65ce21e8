"""Managed nodes of a real ROS 2: `/camera` works, `/lidar` fails and hangs, `/plain` has no lifecycle.

The first configuration of `/lidar` fails, and its activation lasts until the service `/go` is called. `managed.py mute`
is `/mute` instead, a managed node that answers nothing. Prints "ready".
"""

from __future__ import annotations

import sys
import threading

from rclpy.context import Context
from rclpy.executors import MultiThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from running import begun, run
from std_msgs.msg import String
from std_srvs.srv import Trigger

GO = threading.Event()


class Camera(LifecycleNode):
    """A node that makes every transition, and publishes a topic while it is active."""

    def __init__(self, context: Context) -> None:
        super().__init__("camera", context=context)
        self.declare_parameter("exposure", 0.02)
        self.image = self.create_lifecycle_publisher(String, "/camera/image", 5)


class Lidar(LifecycleNode):
    """A node that fails at first, and then takes long."""

    def __init__(self, context: Context) -> None:
        super().__init__("lidar", context=context)
        self.tries = 0

    def on_configure(self, _: LifecycleState) -> TransitionCallbackReturn:
        self.tries += 1
        return TransitionCallbackReturn.FAILURE if self.tries == 1 else TransitionCallbackReturn.SUCCESS

    def on_activate(self, _: LifecycleState) -> TransitionCallbackReturn:
        GO.wait(60)
        return TransitionCallbackReturn.SUCCESS


def go(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
    GO.set()
    response.success = True
    return response


def answering(context: Context) -> list[Node]:
    """Return the nodes that answer."""
    plain = Node("plain", context=context)
    plain.create_service(Trigger, "/go", go)
    return [Camera(context), Lidar(context), plain]


def main(way: str) -> None:
    context = begun(GO)
    executor = MultiThreadedExecutor(4, context=context)
    nodes = [LifecycleNode("mute", context=context)] if way == "mute" else answering(context)
    run(context, executor, [] if way == "mute" else nodes)  # a node without an executor answers nothing


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "")
