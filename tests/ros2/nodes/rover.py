"""A rover that is driven by `/rover/drive`, and braked by `/rover/brake`.

Prints "drive X MOMENT" for each command that it hears, X being how fast ahead and MOMENT the seconds of the clock that
never jumps, and "brake" when it is braked. Prints "ready" when all is there; SIGINT ends it tidily.
"""

from __future__ import annotations

import time
from typing import Any

from geometry_msgs.msg import Twist
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from running import begun, run, say
from std_srvs.srv import Trigger


class Rover(Node):
    """The node /rover."""

    def __init__(self, context: Context) -> None:
        super().__init__("rover", context=context)
        self.create_subscription(Twist, "/rover/drive", self.drive, 100)
        self.create_service(Trigger, "/rover/brake", self.brake)

    def drive(self, command: Twist) -> None:
        say(f"drive {command.linear.x:g} {time.monotonic():.6f}")

    def brake(self, _: Any, response: Any) -> Any:
        say("brake")
        response.success, response.message = True, "braked"
        return response


def main() -> None:
    context = begun()
    run(context, SingleThreadedExecutor(context=context), [Rover(context)])


if __name__ == "__main__":
    main()
