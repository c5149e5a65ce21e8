"""The aircraft as a ROS 1 behind a rosbridge server that sends JSON only, as a robot of the contract suite."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rosld.adapters.aircraft import adapter
from rosld.adapters.base import AdapterOptions
from tests.adapters.rosbridge.bridge import Bridge
from tests.contracts import aircraft
from tests.contracts.robot import Robot
from tests.contracts.rosbridge import BRIDGED, bridged

HAS = (aircraft.HAS | BRIDGED) - {"acting", "rejecting"}


@contextmanager
def robot(folder: Path) -> Iterator[object]:
    """Run an aircraft behind a bridge."""
    with aircraft.robot(folder) as running:
        assert isinstance(running, Robot)
        with bridged(Bridge(lambda: adapter("aircraft", AdapterOptions()), raw=False), running) as found:
            yield found
