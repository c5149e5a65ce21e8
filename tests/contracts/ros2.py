"""A real ROS 2 system as a robot of the contract suite; it has no name service, and its nodes own their parameters."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rosld.adapters.base import AdapterOptions
from rosld.adapters.ros2 import adapter
from tests.contracts.robot import Acted, Asked, Robot, Spoken
from tests.processes import Process
from tests.ros2.system import System, running

HAS = frozenset(
    [
        "writable",
        "answering",
        "hanging",
        "acting",
        "rejecting",
        "other",
        "owner",
        "guarded",
        "vanish",
        "come_back",
        "trace",
    ]
)

_SETTLED = 0.5


class Onlooker:
    """A node of the tests, which sees what every node in the domain can see."""

    def __init__(self, domain: int) -> None:
        from rclpy.context import Context
        from rclpy.node import Node

        self._context = Context()
        self._context.init(args=[], domain_id=domain)
        self._node: Any = Node("_onlooker", context=self._context)

    def sees(self) -> object:
        """Return the visible nodes and publishers of topics, once they have stopped changing."""
        seen, since = self._look(), time.monotonic()
        while time.monotonic() - since < _SETTLED:
            time.sleep(0.02)
            if (now := self._look()) != seen:
                seen, since = now, time.monotonic()
        return seen

    def close(self) -> None:
        self._node.destroy_node()
        self._context.try_shutdown()

    def _look(self) -> object:
        nodes = sorted(name for name in self._node.get_node_names() if not name.startswith("_"))
        topics = [name for name, _ in self._node.get_topic_names_and_types()]
        publishers = [
            (topic, sorted(each.node_name for each in self._node.get_publishers_info_by_topic(topic)))
            for topic in sorted(topics)
            if topic not in ("/parameter_events", "/rosout")
        ]
        return nodes, [(topic, names) for topic, names in publishers if names]


@contextmanager
def robot(folder: Path) -> Iterator[object]:
    """Run the nodes."""
    with running() as system:
        onlooker = Onlooker(system.domain)
        try:
            yield running_robot(system, onlooker)
        finally:
            onlooker.close()


def running_robot(system: System, onlooker: Onlooker) -> Robot:
    nodes: list[Process] = []

    def start() -> None:
        nodes[:] = [system.node("robot.py"), system.node("pilot.py")]

    def vanish() -> None:
        for node in nodes:
            node.told_to_end()
        for node in nodes:
            node.stop()

    start()
    return Robot(
        name="ros2",
        adapter=lambda: adapter(system.source, AdapterOptions()),
        nowhere=None,
        readable="/counter",
        writable=Spoken("/cockpit/display", "std_msgs/msg/String", {"data": "cleared for take-off"}),
        answering=Asked("/get_power", "std_srvs/srv/Trigger", {}, response={"message": "off"}),
        hanging=Asked("/hangs", "std_srvs/srv/Trigger", {}),
        acting=Acted("/fly", "rosld_aircraft/action/Fly", quick={"distance": 5.0}, lasting={"distance": 1e6}),
        rejecting=("/fly", "rosld_aircraft/action/Fly", {"distance": -1.0}),
        other=lambda: system.node("pilot.py", "send", "1e6").stop,
        owner="/free",
        guarded=("/listener/seats", 7, "there are four seats at most"),
        vanish=vanish,
        come_back=start,
        trace=onlooker.sees,
    )
