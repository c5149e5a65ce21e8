"""A ROS 2 on zenoh as a robot of the contract suite: nodes that speak like rmw_zenoh, through a router."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rosld.adapters.base import AdapterOptions
from rosld.adapters.ros2.zenoh_adapter import adapter
from tests.adapters.ros1.system import free_port
from tests.adapters.zenoh import robot as nodes
from tests.contracts.robot import Asked, Robot, Spoken

HAS = frozenset(["nowhere", "writable", "answering", "hanging", "owner", "guarded", "vanish", "come_back", "trace"])


@contextmanager
def robot(folder: Path) -> Iterator[object]:
    """Run the nodes."""
    running = nodes.Robot(free_port())
    running.start()
    try:
        yield Robot(
            name="zenoh",
            adapter=lambda: adapter(running.source, AdapterOptions()),
            nowhere=lambda: adapter(f"zenoh://127.0.0.1:{free_port()}", AdapterOptions()),
            readable="/counter",
            writable=Spoken("/cockpit/display", "std_msgs/msg/String", {"data": "cleared for take-off"}),
            answering=Asked("/get_power", "std_srvs/srv/Trigger", {}, response={"message": "off"}),
            hanging=Asked("/hangs", "std_srvs/srv/Trigger", {}),
            owner="/listener",
            guarded=("/listener/seats", 7, "there are four seats at most"),
            vanish=running.stop,
            come_back=running.start,
            trace=running.tokens,
        )
    finally:
        running.stop()
