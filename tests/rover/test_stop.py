"""The stop of the rover, which nobody has mapped and which has no watchdog: it stands, whatever commanded it."""

from __future__ import annotations

from typing import Any

from rosld.adapters.rover.topics import CMD_VEL, NAVIGATE_TO
from tests.rover.conftest import StartRover
from tests.rover.rovers import STANDSTILL, Rover
from tests.stopping import release
from tests.waiting import until

JSON = {"Accept": "application/json"}


def stop(rover: Rover) -> dict[str, Any]:
    answer = rover.http.post("/stop", headers=JSON)
    assert answer.status_code == 200, answer.text
    told: dict[str, Any] = answer.json()
    return told


def stands(rover: Rover) -> None:
    until(lambda: rover.velocity() == (0.0, 0.0), "standstill")


def test_a_command_that_is_never_repeated_ends_with_the_stop(rover: Rover) -> None:
    rover.drive(0.2, 0.5)
    until(lambda: rover.velocity() == (0.2, 0.5), "motion")
    told = stop(rover)
    try:
        step = {"does": f"publish zero on {CMD_VEL}", "state": "Succeeded", "subscribers": 1, "words": None}
        assert (told["steps"], told["warning"]) == ([step], None)
        stands(rover)
        assert rover.http.put(f"/topics{CMD_VEL}", json=STANDSTILL).status_code == 204
        ahead = {**STANDSTILL, "linear": {"x": 0.2, "y": 0.0, "z": 0.0}}
        assert rover.http.put(f"/topics{CMD_VEL}", json=ahead).status_code == 423
        assert rover.send(1.0, 0.0).status_code == 423
        assert rover.velocity() == (0.0, 0.0)
    finally:
        assert release(rover.http).status_code == 204
    rover.drive(0.1)
    until(lambda: rover.velocity()[0] == 0.1, "motion after the release")
    rover.drive(0.0)
    stands(rover)


def test_a_goal_that_is_pursued_is_canceled_and_so_are_all_where_that_is_asked_for(start_rover: StartRover) -> None:
    rover = start_rover("", "--stop-cancels", "others")
    goal = rover.send(4.4, -3.4).headers["location"]
    until(lambda: rover.velocity() != (0.0, 0.0), "motion")
    told = stop(rover)
    assert [step["does"] for step in told["steps"]] == [
        f"publish zero on {CMD_VEL}",
        f"cancel all goals of {NAVIGATE_TO}",
    ]
    assert told["warning"] is None
    assert rover.end_of(goal)["status"] == "canceled"
    stands(rover)
