"""A rover that is driven by `/rover/drive`, and braked by `/rover/brake`.

Prints "drive X TIME" for each received command, where X is the forward speed and TIME the seconds of the monotonic
clock, and "brake" when it is braked. Prints "ready" when it is complete; SIGINT ends it in an orderly way.
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
