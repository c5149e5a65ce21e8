"""Requests and bytes for tasks on the rover, of a program that knows one URL, and how to read HTTP, JSON and offers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import httpx
import pytest

from tests.rover.conftest import StartRover
from tests.rover.rovers import Rover
from tests.stopping import release
from tests.waiting import until

pytestmark = pytest.mark.slow

JSON = "application/json"
OFFER = "application/vnd.rosld.offer+json"


class Tourist:
    """A client that starts at the entry each time; `requests` and `sizes` count requests and bytes of bodies."""

    def __init__(self, entry: str) -> None:
        self._http = httpx.Client(timeout=120, headers={"Accept": JSON})
        self._entry = entry
        self._links: Any = None
        self.requests = 0
        self.bytes = 0

    def ask(self, method: str, url: str, *, accept: str = JSON, **more: Any) -> httpx.Response:
        """Return the response to a request, after redirects."""
        answer = self._http.request(method, url, headers={"Accept": accept}, follow_redirects=True, **more)
        self.requests += 1 + len(answer.history)
        self.bytes += len(answer.content) + len(answer.request.content)
        return answer

    def entry(self) -> Any:
        """Return the offer of the entry, which leads to the search and the stop; asked for once."""
        if self._links is None:
            self._links = self.ask("GET", self._entry, accept=OFFER).json()
        return self._links

    def find(self, words: str, fits: Callable[[Mapping[str, Any]], object]) -> Any:
        """Return the first matching result of a search."""
        results = self.ask("GET", self.entry()["search"], params={"q": words}).json()["results"]
        return next(result for result in results if fits(result))

    def offer(self, url: str) -> Any:
        """Return the offer of the resource at a URL."""
        return self.ask("GET", url, accept=OFFER).json()

    def close(self) -> None:
        """End its connections."""
        self._http.close()


def first_value(tourist: Tourist) -> Any:
    """Return the position of the robot, from its odometry."""
    found = tourist.find("odometry", lambda result: result["kind"] == "topic")
    return tourist.ask("GET", found["url"]).json()["pose"]["pose"]["position"]


def drive_and_stop(tourist: Tourist) -> list[int]:
    """Drive a metre by holding any topic of type Twist, stop, and try to release the stop."""
    found = tourist.find("twist", lambda one: one["kind"] == "topic" and one.get("type", "").endswith("/Twist"))
    offered = tourist.offer(found["url"])
    [hold] = [each for each in offered["do"] if {"rate", "for"} <= each.get("query", {}).keys()]
    speed = {"linear": {**offered["example"]["linear"], "x": 0.25}}
    driven = tourist.ask(hold["method"], found["url"], params={"rate": "10", "for": "4"}, json=speed)
    stop = tourist.entry()["stop"]
    stopped = tourist.ask("POST", stop)
    released = tourist.ask("DELETE", stop)
    return [driven.status_code, stopped.status_code, released.status_code]


def failing_goal(tourist: Tourist) -> Any:
    """Send an unreachable goal, as its offer says, and follow it to its end."""
    found = tourist.find("navigate", lambda result: result["kind"] == "action")
    offered = tourist.offer(found["url"])
    goal = offered["example"]
    goal["pose"]["pose"]["position"]["x"] = 90.0
    [send] = offered["do"]
    sent = tourist.ask(send["method"], offered["url"], json=goal)
    assert sent.status_code == 201, sent.text
    ended = tourist.ask("GET", sent.headers["location"], params={"until": "status = 'succeeded'", "timeout": "60"})
    assert ended.status_code == 409, ended.text
    return ended.json()["state"]["status"]


def parameter_in_range(tourist: Tourist) -> tuple[float, Any]:
    """Set a parameter to the maximum of its offer, and read it; return both."""
    found = tourist.find("max_speed", lambda result: result["kind"] == "parameter")
    most = tourist.offer(found["url"])["input"]["maximum"]
    assert tourist.ask("PUT", found["url"], json=most).status_code == 204
    return most, tourist.ask("GET", found["url"]).json()


def battery(tourist: Tourist) -> float:
    """Find the battery and return its charge."""
    found = tourist.find("battery", lambda result: "BatteryState" in result.get("type", ""))
    percentage: float = tourist.ask("GET", found["url"]).json()["percentage"]
    return percentage


def picture(tourist: Tourist) -> bytes:
    """Return a small picture of the camera, in a media type of its offer."""
    found = tourist.find("what does the camera see", lambda result: result["kind"] == "topic")
    offered = tourist.offer(found["url"])
    assert "?width=" in offered["read"]["also"]
    answer = tourist.ask("GET", f"{offered['url']}?width=120", accept=offered["read"]["types"][0])
    assert answer.headers["content-type"].startswith("image/"), answer.text
    return answer.content


def last_minute(tourist: Tourist) -> list[Any]:
    """Return where the robot was in the last minute, in few points."""
    found = tourist.find("odometry", lambda result: result["kind"] == "topic")
    offered = tourist.offer(found["url"])
    assert "?series=" in offered["read"]["also"]
    query = {"series": "pose.pose.position.x", "from": "-60", "points": "20"}
    series: list[Any] = tourist.ask("GET", offered["url"], params=query).json()["time"]
    return series


def low_battery(tourist: Tourist) -> float:
    """Wait until the battery falls below 20 %."""
    found = tourist.find("battery", lambda result: "BatteryState" in result.get("type", ""))
    while True:
        answer = tourist.ask("GET", found["url"], params={"until": "percentage < 0.2", "timeout": "60"})
        if answer.status_code == 200:
            percentage: float = answer.json()["percentage"]
            return percentage
        assert answer.status_code == 204, answer.text


def carry_out(rover: Rover, task: Callable[[Tourist], object], requests: int, bytes: int = 12_000) -> Any:
    """Return the result of a task, after checking its number of requests and bytes of bodies."""
    tourist = Tourist(rover.url)
    try:
        result = task(tourist)
    finally:
        tourist.close()
    print(f"{rover.name}: {task.__name__}: {tourist.requests} requests, {tourist.bytes} bytes")
    assert tourist.requests <= requests
    assert tourist.bytes <= bytes
    return result


def test_a_value_the_battery_a_picture_and_a_parameter_take_three_to_five_requests(rover: Rover) -> None:
    assert {"x", "y"} <= carry_out(rover, first_value, 3).keys()
    assert 0 < carry_out(rover, battery, 3) <= 1
    assert carry_out(rover, picture, 4)[:2] == b"\xff\xd8", "a JPEG file"
    most, found = carry_out(rover, parameter_in_range, 5)
    assert found == most


def test_to_drive_and_to_stop_takes_six_requests(rover: Rover) -> None:
    driven, *others = carry_out(rover, drive_and_stop, 6)
    assert driven == 201
    assert others == [200, 428], "a model stops the robot; a person releases it"
    assert release(rover.http).status_code == 204


def test_to_send_a_goal_and_see_it_fail_takes_five_requests(rover: Rover) -> None:
    assert carry_out(rover, failing_goal, 5) == "aborted"


def test_to_ask_where_it_was_in_the_last_minute_takes_four_requests(start_rover: StartRover) -> None:
    rover = start_rover("", "--history", "/odom")
    until(lambda: rover.http.get("/topics/odom?series=pose.pose.position.x").is_success, "a recorded message")
    assert carry_out(rover, last_minute, 4)


def test_to_wait_until_the_battery_falls_below_a_fifth_takes_one_request_a_minute(start_rover: StartRover) -> None:
    assert carry_out(start_rover("battery=0.2003&rate=20"), low_battery, 6) < 0.2
