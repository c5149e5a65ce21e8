"""An embedded robot behind a rosbridge server, as a robot of the contract suite: ROS 2, or ROS 1 in `rosbridge1`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from rosld.adapters.base import AdapterOptions
from rosld.adapters.rosbridge import adapter
from rosld.adapters.rover import rover_adapter
from tests.adapters.ros1.system import free_port
from tests.adapters.rosbridge.bridge import Bridge
from tests.contracts import rover
from tests.contracts.robot import Robot

BRIDGED = frozenset({"nowhere", "vanish", "come_back", "trace"})
HAS = rover.HAS | BRIDGED


@contextmanager
def robot(folder: Path) -> Iterator[object]:
    """Run a rover behind a bridge."""
    with rover.robot(folder) as running:
        assert isinstance(running, Robot)
        bridge = Bridge(lambda: rover_adapter("rover:?rate=0.1", AdapterOptions()))
        with bridged(bridge, running) as found:
            yield found


@contextmanager
def bridged(bridge: Bridge, running: Robot) -> Iterator[object]:
    """Run a bridge, and yield its robot."""
    bridge.start()
    try:
        yield replace(
            running,
            name="rosbridge",
            adapter=lambda: adapter(bridge.source, AdapterOptions()),
            nowhere=lambda: adapter(f"rosbridge://127.0.0.1:{free_port()}", AdapterOptions()),
            vanish=bridge.stop,
            come_back=bridge.start,
            trace=bridge.trace,
        )
    finally:
        bridge.stop()
