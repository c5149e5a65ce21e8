"""Other publishers on a real ROS 2: a hold ends when one appears, and one that was killed is forgotten in time."""

from __future__ import annotations

from typing import Any

import httpx
import pytest

from tests.ros2.distros import DISTROS
from tests.ros2.system import System, running
from tests.server.conftest import Served, servers
from tests.waiting import until

DRIVE = "/topics/rover/drive"
STILL = {part: {"x": 0.0, "y": 0.0, "z": 0.0} for part in ("linear", "angular")}
AHEAD = {**STILL, "linear": {"x": 1.5, "y": 0.0, "z": 0.0}}
LEASE = 20.0
"""Seconds after which DDS forgets a participant that is silent: Fast DDS's default, in which ROS 2 leaves it."""

pytestmark = pytest.mark.ros2


def served(start: Any, system: System, *options: str) -> Served:
    """rosld on a system that has the rover."""
    found: Served = start(system.source, *options, python=system.python, environment=system.environment)
    until(lambda: found.http.get(DRIVE).status_code == 200, "the rover")
    return found


def put(http: httpx.Client) -> int:
    return http.put(DRIVE, json=STILL).status_code


def test_a_hold_ends_when_another_node_publishes_and_who_was_killed_is_forgotten_within_the_lease() -> None:
    with running(DISTROS[0]) as system, servers() as start:
        rover = system.node("rover.py")
        first, second = served(start, system), served(start, system, "--allow-publish", "/rover/drive")
        answer = first.http.post(DRIVE, params={"rate": 20, "lease": 5}, json=AHEAD)
        assert answer.status_code == 201, answer.text
        until(lambda: any(line.startswith("drive 1.5") for line in rover.seen), "the hold")
        hold = answer.headers["location"]

        assert put(second.http) == 204

        def is_over() -> bool:
            assert put(second.http) == 204  # it goes on publishing
            return first.http.patch(hold).status_code == 410  # which renews the hold, so that it does not lapse

        until(is_over, "the end of the hold", timeout=60)
        assert "/rover/drive is published by" in first.http.get(hold).json()["detail"]
        assert put(first.http) == 405

        second.process.kill()
        second.process.wait(10)
        until(lambda: put(first.http) == 204, "the first commands the rover again", timeout=LEASE + 40)
