"""The stop of the rover, which nobody has mapped and which has no watchdog: it stands, whatever commanded it."""

from __future__ import annotations

from typing import Any

from rosld.adapters.rover.topics import CMD_VEL, NAVIGATE_TO
from tests.rover.conftest import StartRover
from tests.rover.rovers import STANDSTILL, Rover
from tests.stopping import release
from tests.waiting import until


def stop(rover: Rover) -> dict[str, Any]:
    answer = rover.http.post("/stop", headers={"Accept": "application/json"})
    assert answer.status_code == 200, answer.text
    told: dict[str, Any] = answer.json()
    return told


def test_a_command_and_a_goal_end_with_the_stop_and_nothing_passes_until_its_release(start_rover: StartRover) -> None:
    rover = start_rover("", "--stop-cancels", "others")
    rover.drive(0.2, 0.5)
    until(lambda: rover.velocity() == (0.2, 0.5), "motion")
    told = stop(rover)
    zero, cancel = told["steps"]
    assert zero == {"does": f"publish zero on {CMD_VEL}", "state": "Succeeded", "subscribers": 1, "words": None}
    assert (cancel["does"], told["warning"]) == (f"cancel all goals of {NAVIGATE_TO}", None)
    rover.stands()
    assert rover.http.put(f"/topics{CMD_VEL}", json=STANDSTILL).status_code == 204
    ahead = {**STANDSTILL, "linear": {"x": 0.2, "y": 0.0, "z": 0.0}}
    assert rover.http.put(f"/topics{CMD_VEL}", json=ahead).status_code == 423
    assert rover.send(1.0, 0.0).status_code == 423
    assert rover.velocity() == (0.0, 0.0)
    assert release(rover.http).status_code == 204
    goal = rover.send(4.4, -3.4).headers["location"]
    until(lambda: rover.velocity() != (0.0, 0.0), "motion after the release")
    assert stop(rover)["warning"] is None
    assert rover.end_of(goal)["status"] == "canceled"
    rover.stands()
