"""The embedded aircraft as a robot of the contract suite."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rosld.adapters.aircraft import adapter
from rosld.adapters.base import AdapterOptions

_robot = sys.modules["rosld_tests_contracts_robot"]

HAS = frozenset(["writable", "answering", "parameter"])


@contextmanager
def robot(folder: Path) -> Iterator[object]:
    """An aircraft that nothing can go wrong with: it neither hangs nor vanishes, and is always there."""
    yield _robot.Robot(
        name="aircraft",
        adapter=lambda: adapter("aircraft", AdapterOptions()),
        nowhere=None,
        readable="/aircraft/engine/speed",
        writable=_robot.Spoken("/cockpit/display", "std_msgs/msg/String", {"data": "cleared for take-off"}),
        answering=_robot.Asked("/aircraft/get_power", "rosld_aircraft/srv/GetText", {}, response={"data": "off"}),
        parameter=("/aircraft/seats", 2),
    )
