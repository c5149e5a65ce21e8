"""A playing recording as a robot of the contract suite."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rosld.adapters.base import AdapterOptions
from rosld.adapters.recording import adapter
from tests.adapters.recording import recorder
from tests.contracts.robot import Robot

HAS = frozenset(["nowhere", "trace", "read_only"])


@contextmanager
def robot(folder: Path) -> Iterator[object]:
    """Play a ROS 1 bag of one minute, so that no loop begins during the suite; files cannot vanish."""
    path = recorder.write_rosbag1(folder / "run.bag", recorder.lines(count=1200, every=0.05), compression="lz4")
    yield Robot(
        name="recording",
        adapter=lambda: adapter(str(path), AdapterOptions()),
        nowhere=lambda: adapter(str(folder / "missing.bag"), AdapterOptions()),
        readable="/chatter",
        trace=lambda: sorted((each.name, each.stat().st_mtime_ns) for each in folder.iterdir()),
    )
