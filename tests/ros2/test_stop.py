"""The stop of a base that nobody has mapped, on a real ROS 2: it is told zero, whoever commanded it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from tests.processes import Process
from tests.ros2.system import System, running
from tests.server.conftest import Served, servers
from tests.stopping import release
from tests.waiting import until

DRIVE = "/topics/rover/drive"
STILL = {part: {"x": 0.0, "y": 0.0, "z": 0.0} for part in ("linear", "angular")}
AHEAD = {**STILL, "linear": {"x": 1.5, "y": 0.0, "z": 0.0}}

pytestmark = pytest.mark.ros2


@pytest.fixture(scope="module")
def system() -> Iterator[System]:
    with running("jazzy") as found:
        yield found


def served(start: Any, system: System, *options: str) -> Served:
    """rosld on a system that has the rover."""
    found: Served = start(system.source, *options, python=system.python, environment=system.environment)
    found.http.headers["Accept"] = "application/json"
    until(lambda: found.http.get(DRIVE).status_code == 200, "the rover")
    return found


def speeds(rover: Process) -> list[float]:
    return [float(line.split()[1]) for line in rover.seen if line.startswith("drive ")]


def test_a_rover_that_another_commands_is_told_zero_by_a_server_that_never_published(system: System) -> None:
    with servers() as start:
        rover = system.node("rover.py")
        other, own = served(start, system), served(start, system)
        held = other.http.post(DRIVE, params={"rate": 5, "lease": 5}, json=AHEAD)
        assert held.status_code == 201, held.text
        until(lambda: 1.5 in speeds(rover), "the command")
        told = own.http.post("/stop").json()
        [step] = told["steps"]
        assert (step["does"], step["state"], told["warning"]) == ("publish zero on /rover/drive", "Succeeded", None)
        assert step["subscribers"] in (1, 2), "the rover, and the other server while it looks"
        until(lambda: speeds(rover).count(0.0) >= 15, "zero for a second")
        other.stop()
        until(lambda: own.http.put(DRIVE, json=STILL).status_code == 204, "the other is gone, and zero passes")
        assert own.http.put(DRIVE, json=AHEAD).status_code == 423
        assert release(own.http).status_code == 204
        assert own.http.put(DRIVE, json=AHEAD).is_success
        until(lambda: speeds(rover)[-1] == 1.5, "the command after the release")
