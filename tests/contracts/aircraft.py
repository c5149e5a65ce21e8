"""The embedded aircraft as a robot of the contract suite."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rosld.adapters.aircraft import adapter
from rosld.adapters.base import AdapterOptions
from tests.contracts.robot import Acted, Asked, Robot, Spoken

HAS = frozenset(["writable", "answering", "acting", "rejecting", "parameter"])


@contextmanager
def robot(folder: Path) -> Iterator[object]:
    """Run an aircraft that never fails: it neither hangs nor vanishes, and is always there."""
    yield Robot(
        name="aircraft",
        adapter=lambda: adapter("aircraft", AdapterOptions()),
        nowhere=None,
        readable="/aircraft/engine/speed",
        writable=Spoken("/cockpit/display", "std_msgs/msg/String", {"data": "cleared for take-off"}),
        answering=Asked("/aircraft/get_power", "rosld_aircraft/srv/GetText", {}, response={"data": "off"}),
        acting=Acted(
            "/aircraft/fly",
            "rosld_aircraft/action/Fly",
            quick={"distance": 30.0},
            lasting={"distance": 1e5},
            before=(Asked("/aircraft/start", "std_srvs/srv/Trigger", {}),),
        ),
        rejecting=("/aircraft/fly", "rosld_aircraft/action/Fly", {"distance": -1.0}),
        parameter=("/aircraft/seats", 2),
    )
