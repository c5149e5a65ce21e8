"""What keeps a robot on the web from running on, on a real ROS 2: holds end with a message, a stop ends everything."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import httpx
import pytest

from tests.processes import Process
from tests.ros2.system import running
from tests.server.conftest import Served, servers
from tests.stopping import release
from tests.waiting import until

DRIVE, BRAKE, FLY = "/topics/rover/drive", "/services/rover/brake", "/actions/aircraft/fly"
MAPPING = """@prefix map: <https://w3id.org/rosld/mapping#> .
<#rover> a map:ComplexResource ; map:path "/rover/" ; map:stop [ map:call "/rover/brake" ] ."""
AHEAD = {"linear": {"x": 1.5, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}

pytestmark = pytest.mark.ros2


@dataclass(frozen=True)
class Driven:
    """A server of the rover and the aircraft, and what the rover says it was told."""

    served: Served
    rover: Process

    @property
    def http(self) -> httpx.Client:
        return self.served.http

    def speeds(self) -> list[float]:
        """Each speed that it was driven at since it was asked last, in order."""
        return [float(line.split()[1]) for line in self.rover.seen if line.startswith("drive ")]

    def hold(self, **query: Any) -> str:
        """Hold the drive ahead; the URL of the hold, once the rover hears it."""
        self.rover.seen.clear()
        answer = self.http.post(DRIVE, params={"rate": 20, **query}, json=AHEAD)
        assert answer.status_code == 201, answer.text
        until(lambda: len(self.speeds()) > 3, "commands")
        return str(answer.headers["location"])

    def stands(self) -> None:
        """Wait until the last that it was told is to stand still."""
        until(lambda: self.speeds()[-1:] == [0.0], "standing still")


@pytest.fixture(scope="module")
def driven() -> Iterator[Driven]:
    """The rover and the aircraft."""
    with running("kilted") as system, servers() as start:
        rover = system.node("rover.py")
        system.node("aircraft.py")
        served = start(system.source, python=system.python, environment=system.environment)
        served.http.headers["Accept"] = "application/json"
        for path in (DRIVE, BRAKE, FLY, "/services/aircraft/start", "/services/aircraft/engine/set_speed"):
            until(lambda path=path: served.http.get(path).status_code == 200, path)
        mapped = served.http.put("/mappings/rover", content=MAPPING, headers={"Content-Type": "text/turtle"})
        assert mapped.status_code == 201, mapped.text
        yield Driven(served, rover)


def test_a_hold_drives_until_its_lease_lapses_and_then_stands_still(driven: Driven) -> None:
    hold = driven.hold(lease=1)
    driven.stands()
    until(lambda: driven.http.get(hold).status_code == 410, "its end")
    assert "its lease lapsed" in driven.http.get(hold).text
    assert driven.speeds().count(0.0) == 1
    assert set(driven.speeds()) == {1.5, 0.0}


def test_a_hold_that_is_renewed_goes_on_and_another_is_told_whose_the_topic_is(driven: Driven) -> None:
    hold = driven.hold(lease=5)
    assert driven.http.patch(hold).status_code == 204
    second = driven.http.post(DRIVE, params={"rate": 20}, json=AHEAD)
    assert second.status_code == 409
    assert hold in second.text
    assert driven.http.put(DRIVE, json=AHEAD).status_code == 409
    assert driven.http.delete(hold).status_code == 204
    driven.stands()


def test_a_stop_ends_the_hold_cancels_the_goal_brakes_and_lets_nothing_pass(driven: Driven) -> None:
    http = driven.http
    http.post("/services/aircraft/start")
    assert http.post("/services/aircraft/engine/set_speed", json={"data": 20.0}).json()["success"] is True
    goal = http.post(FLY, json={"distance": 1e6}).headers["location"]
    hold = driven.hold(lease=5)
    until(lambda: http.get(goal).json()["feedback"], "feedback")
    told = http.post("/stop", json={"reason": "a person on the track"}).json()
    try:
        assert told["stopped"], told
        assert {step["state"] for step in told["steps"]} == {"Succeeded"}, told
        assert len(told["steps"]) == 4
        driven.stands()
        until(lambda: "brake" in driven.rover.seen, "the brake")
        assert http.get(hold).status_code == 410
        until(lambda: http.get(goal).json()["status"] == "canceled", "the goal canceled")
        for method, path, body in (
            ("PUT", DRIVE, AHEAD),
            ("POST", BRAKE, {}),
            ("POST", FLY, {"distance": 5.0}),
            ("PUT", "/parameters/cockpit/night", True),
        ):
            refused = http.request(method, path, json=body)
            assert refused.status_code == 423, (method, path, refused.text)
            assert refused.json()["agentSaid"] == "a person on the track"
        assert driven.speeds()[-1] == 0.0
    finally:
        assert release(http).status_code == 204
    receipt = http.get(http.post(BRAKE, json={}).links["http://www.w3.org/ns/prov#has_provenance"]["url"])
    assert receipt.status_code == 200
    assert http.post("/services/aircraft/engine/set_speed", json={"data": 0.0}).status_code == 201


def test_the_rover_stands_still_before_the_server_has_ended(driven: Driven) -> None:
    """The last test of a system: its server is gone after it."""
    driven.hold(lease=5)
    assert driven.served.stop() == 0
    driven.stands()
    assert driven.speeds().count(0.0) == 1
