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
    last_minute,
    low_battery,
    parameter_in_range,
    picture,
)
from tests.stopping import release
from tests.waiting import until

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


def test_the_first_value_takes_three_requests(rover: Rover) -> None:
    with counted(rover, first_value, 3, 12_000) as position:
        assert {"x", "y"} <= position.keys()


def test_to_drive_and_to_stop_takes_six_requests(rover: Rover) -> None:
    with counted(rover, drive_and_stop, 6, 12_000) as statuses:
        assert statuses[0] == 201
        assert statuses[1:] == [200, 428], "a model stops the robot; a person releases it"
    assert release(rover.http).status_code == 204


def test_to_send_a_goal_and_see_it_fail_takes_five_requests(rover: Rover) -> None:
    with counted(rover, failing_goal, 5, 12_000) as status:
        assert status == "aborted"


def test_to_set_a_parameter_within_its_range_takes_five_requests(rover: Rover) -> None:
    with counted(rover, parameter_in_range, 5, 12_000) as (most, found):
        assert found == most


def test_to_find_the_battery_takes_three_requests(rover: Rover) -> None:
    with counted(rover, battery, 3, 12_000) as percentage:
        assert 0 < percentage <= 1


def test_to_look_at_the_camera_takes_four_requests(rover: Rover) -> None:
    with counted(rover, picture, 4, 12_000) as data:
        assert data[:2] == b"\xff\xd8", "a JPEG file"


def test_to_ask_where_it_was_in_the_last_minute_takes_four_requests(start_rover: StartRover) -> None:
    rover = start_rover("", "--history", "/odom")
    until(lambda: rover.http.get("/topics/odom?series=pose.pose.position.x").is_success, "a recorded message")
    with counted(rover, last_minute, 4, 12_000) as points:
        assert points


def test_to_wait_until_the_battery_falls_below_a_fifth_takes_one_request_a_minute(
    start_rover: StartRover,
) -> None:
    rover = start_rover("battery=0.2003&rate=20")
    with counted(rover, low_battery, 6, 12_000) as percentage:
        assert percentage < 0.2
