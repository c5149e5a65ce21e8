"""A real ROS 1 system as a robot of the contract suite: the aircraft's twin, its cockpit, and services that fail."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rosld.adapters.base import AdapterOptions
from rosld.adapters.ros1 import adapter

_robot = sys.modules["rosld_tests_contracts_robot"]
_system = sys.modules["rosld_tests_ros1_system"]

HAS = frozenset(["nowhere", "writable", "answering", "raising", "hanging", "parameter", "vanish", "come_back", "trace"])


class Twin:
    """The aircraft on a real rosmaster, which can be killed and started anew with all its nodes."""

    def __init__(self, folder: Path) -> None:
        self.system = _system.RosSystem(folder)
        self._classes = folder / "classes"
        self._nodes: list[Any] = []

    def start(self) -> None:
        """A master that knows nothing, and the nodes: those of ROS 1 do not register again by themselves."""
        self.system.start_master()
        self._nodes = [
            self.system.node("aircraft_node.py", str(self._classes)),
            self.system.node("cockpit_node.py"),
            self.system.node("services_node.py"),
        ]

    def vanish(self) -> None:
        """The master dies, and the nodes with it."""
        self.system.kill_master()
        for node in self._nodes:
            node.kill()

    def trace(self) -> object:
        """What the master knows, but for the parameters that every node may set."""
        publishers, subscribers, services = self.system.master.getSystemState("/test")[2]
        kinds = (publishers, subscribers, services)
        return [sorted((name, sorted(nodes)) for name, nodes in kind) for kind in kinds]


@contextmanager
def robot(folder: Path) -> Iterator[object]:
    """The twin, running."""
    _system.require_ros()
    twin = Twin(folder)
    try:
        twin.start()
        yield _robot.Robot(
            name="ros1",
            adapter=lambda: adapter(twin.system.source, AdapterOptions()),
            nowhere=lambda: adapter(f"ros1://127.0.0.1:{_system.free_port()}", AdapterOptions()),
            readable="/aircraft/engine/speed",
            writable=_robot.Spoken("/cockpit/display", "std_msgs/msg/String", {"data": "cleared for take-off"}),
            answering=_robot.Asked("/aircraft/get_power", "rosld_aircraft/srv/GetText", {}, response={"data": "off"}),
            raising=_robot.Asked("/raises", "std_srvs/srv/Trigger", {}, words="the gripper is jammed"),
            hanging=_robot.Asked("/hangs", "std_srvs/srv/Trigger", {}),
            parameter=("/aircraft/seats", 2),
            vanish=twin.vanish,
            come_back=twin.start,
            trace=twin.trace,
        )
    finally:
        twin.system.close()
