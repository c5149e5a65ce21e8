"""An action server `/fly` for tests: rosld_aircraft/Fly, a metre per tick of 50 ms. Prints "ready".

It rejects negative distances, and aborts at 50 metres, unless the goal is farther. `pilot.py send DISTANCE` is a client
instead, which sends one goal.
"""

from __future__ import annotations

import sys
import time
from typing import Any

from rclpy.action import ActionClient, ActionServer, CancelResponse, GoalResponse
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rosld_aircraft.action import Fly
from running import begun, run


def fly(handle: Any) -> Fly.Result:
    flown = 0.0
    while flown < handle.request.distance:
        if handle.is_cancel_requested:
            handle.canceled()
            return Fly.Result(flown=flown, message="called off")
        if 50 <= flown < handle.request.distance < 1000:
            handle.abort()
            return Fly.Result(flown=flown, message="out of fuel")
        time.sleep(0.05)
        flown += 1
        handle.publish_feedback(Fly.Feedback(flown=flown))
    handle.succeed()
    return Fly.Result(flown=flown, message="arrived")


def permissions(goal: Fly.Goal) -> GoalResponse:
    return GoalResponse.ACCEPT if goal.distance >= 0 else GoalResponse.REJECT


def main(arguments: list[str]) -> None:
    context = begun()
    node = Node("tower" if arguments else "pilot", context=context)
    if arguments:
        client = ActionClient(node, Fly, "/fly")
        assert client.wait_for_server(10)
        client.send_goal_async(Fly.Goal(distance=float(arguments[1])))
        print("sent", flush=True)
    else:
        cancel = {"cancel_callback": lambda _: CancelResponse.ACCEPT}
        server = ActionServer(node, Fly, "/fly", fly, goal_callback=permissions, **cancel)
        assert server is not None
    run(context, MultiThreadedExecutor(6, context=context), [node])


if __name__ == "__main__":
    main(sys.argv[1:])
