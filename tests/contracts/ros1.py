"""A real ROS 1 system as a robot of the contract suite: a rospy aircraft, its cockpit, and services that fail."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rosld.adapters.base import AdapterOptions
from rosld.adapters.ros1 import adapter
from tests.adapters.ros1.system import RosSystem, free_port, require_ros
from tests.contracts.robot import Acted, Asked, Robot, Spoken

HAS = frozenset(
    [
        "nowhere",
        "writable",
        "answering",
        "raising",
        "hanging",
        "acting",
        "rejecting",
        "other",
        "parameter",
        "vanish",
        "come_back",
        "trace",
    ]
)


class Twin:
    """The aircraft on a real rosmaster, which can be killed and restarted with all its nodes."""

    def __init__(self, folder: Path) -> None:
        self.system = RosSystem(folder)
        self._classes = folder / "classes"
        self._nodes: list[Any] = []

    def start(self) -> None:
        """Start an empty master, and the nodes: those of ROS 1 do not register again by themselves."""
        self.system.start_master()
        self._nodes = [
            self.system.node("aircraft_node.py", str(self._classes)),
            self.system.node("cockpit_node.py"),
            self.system.node("services_node.py"),
            self.system.node("action_node.py"),
        ]

    def vanish(self) -> None:
        """Kill the master and the nodes."""
        self.system.kill_master()
        for node in self._nodes:
            node.kill()

    def send(self) -> Callable[[], None]:
        """Let another node send a goal that lasts."""
        ending: Callable[[], None] = self.system.node("action_client.py", "/simple", "600").kill
        return ending

    def trace(self) -> object:
        """Return the state of the master without the parameters that every node may set."""
        publishers, subscribers, services = self.system.master.getSystemState("/test")[2]
        kinds = (publishers, subscribers, services)
        return [sorted((name, sorted(nodes)) for name, nodes in kind) for kind in kinds]


@contextmanager
def robot(folder: Path) -> Iterator[object]:
    """Run the system."""
    require_ros()
    twin = Twin(folder)
    try:
        twin.start()
        yield Robot(
            name="ros1",
            adapter=lambda: adapter(twin.system.source, AdapterOptions()),
            nowhere=lambda: adapter(f"ros1://127.0.0.1:{free_port()}", AdapterOptions()),
            readable="/aircraft/engine/speed",
            writable=Spoken("/cockpit/display", "std_msgs/msg/String", {"data": "cleared for take-off"}),
            answering=Asked("/aircraft/get_power", "rosld_aircraft/srv/GetText", {}, response={"data": "off"}),
            raising=Asked("/raises", "std_srvs/srv/Trigger", {}, words="the gripper is jammed"),
            hanging=Asked("/hangs", "std_srvs/srv/Trigger", {}),
            acting=Acted("/simple", "actionlib/action/Test", quick={"goal": 5}, lasting={"goal": 600}),
            rejecting=("/ways", "actionlib/action/Test", {"goal": 3}),
            other=twin.send,
            parameter=("/aircraft/seats", 2),
            vanish=twin.vanish,
            come_back=twin.start,
            trace=twin.trace,
        )
    finally:
        twin.system.close()
