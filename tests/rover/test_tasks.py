"""Number of requests and bytes that a program needs for tasks on the rover, knowing only the entry."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from tests.rover.conftest import StartRover
from tests.rover.rovers import Rover
from tests.rover.tourist import (
    Tourist,
    battery,
    drive_and_stop,
    failing_goal,
    first_value,
    low_battery,
    parameter_in_range,
)
from tests.stopping import release

pytestmark = pytest.mark.slow


@contextmanager
def counted(rover: Rover, task: Callable[[Tourist], object], requests: int, bytes: int) -> Iterator[Any]:
    """Return the result of a task, after checking its number of requests and bytes of bodies."""
    tourist = Tourist(rover.url)
    try:
        yield task(tourist)
    finally:
        tourist.close()
    print(f"{rover.name}: {task.__name__}: {tourist.requests} requests, {tourist.bytes} bytes")
    assert tourist.requests <= requests
    assert tourist.bytes <= bytes


def test_the_first_value_takes_four_requests(rover: Rover) -> None:
    with counted(rover, first_value, 4, 20_000) as position:
        assert {"x", "y"} <= position.keys()


def test_to_drive_and_to_stop_takes_six_requests(rover: Rover) -> None:
    with counted(rover, drive_and_stop, 6, 20_000) as statuses:
        assert statuses[0] == 201
        assert statuses[1:] == [200, 428], "a model stops the robot; a person releases it"
    assert release(rover.http).status_code == 204


def test_to_send_a_goal_and_see_it_fail_takes_six_requests(rover: Rover) -> None:
    with counted(rover, failing_goal, 6, 20_000) as status:
        assert status == "aborted"


def test_to_set_a_parameter_within_its_range_takes_six_requests(rover: Rover) -> None:
    with counted(rover, parameter_in_range, 6, 20_000) as (most, found):
        assert found == most


def test_to_find_the_battery_takes_four_requests(rover: Rover) -> None:
    with counted(rover, battery, 4, 20_000) as percentage:
        assert 0 < percentage <= 1


def test_to_wait_until_the_battery_falls_below_a_fifth_takes_one_request_a_minute(
    start_rover: StartRover,
) -> None:
    rover = start_rover("battery=0.2003&rate=20")
    with counted(rover, low_battery, 6, 20_000) as percentage:
        assert percentage < 0.2
