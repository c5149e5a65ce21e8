"""A program that knows one URL, and how to read HTTP, JSON and Thing Descriptions; its requests are counted."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

import httpx

JSON = "application/json"
THING = "application/td+json"


class Tourist:
    """A client that starts at the entry each time; `requests` and `sizes` count requests and bytes of bodies."""

    def __init__(self, entry: str) -> None:
        self._http = httpx.Client(timeout=120, headers={"Accept": JSON})
        self._entry = entry
        self.requests = 0
        self.bytes = 0

    def ask(self, method: str, url: str, *, accept: str = JSON, **more: Any) -> httpx.Response:
        """Return the response to a request, after redirects."""
        answer = self._http.request(method, url, headers={"Accept": accept}, follow_redirects=True, **more)
        self.requests += 1 + len(answer.history)
        self.bytes += len(answer.content) + len(answer.request.content)
        return answer

    def guide(self) -> Mapping[str, str]:
        """Return the links of the guide that the entry links to, by name."""
        entry = self.ask("GET", self._entry)
        guide = self.ask("GET", entry.links["help"]["url"], accept="text/plain").text
        return {name.lower(): url for name, url in re.findall(r"\[([^\]]+)\]\((\S+?)\)", guide)}

    def find(self, links: Mapping[str, str], words: str, fits: Callable[[Mapping[str, Any]], object]) -> Any:
        """Return the first matching result of a search."""
        results = self.ask("GET", links["find"].partition("?")[0], params={"q": words}).json()["results"]
        return next(result for result in results if fits(result))

    def describe(self, links: Mapping[str, str], url: str) -> Any:
        """Return the part of the Thing Description about a URL."""
        thing, path = links["thing description"].partition("?")[0], httpx.URL(url).path
        return self.ask("GET", thing, params={"below": path}, accept=THING).json()

    def close(self) -> None:
        """End its connections."""
        self._http.close()


def first_value(tourist: Tourist) -> Any:
    """Return the position of the robot, from its odometry."""
    found = tourist.find(tourist.guide(), "odometry", lambda result: result["kind"] == "topic")
    return tourist.ask("GET", found["url"]).json()["pose"]["pose"]["position"]


def drive_and_stop(tourist: Tourist) -> list[int]:
    """Drive by any topic of type Twist, stop, and try to release the stop."""
    links = tourist.guide()
    found = tourist.find(links, "twist", lambda one: one["kind"] == "topic" and one.get("type", "").endswith("/Twist"))
    driven = tourist.ask("PUT", found["url"], json={"linear": {"x": 0.2}})
    stopped = tourist.ask("POST", links["stop"])
    released = tourist.ask("DELETE", links["stop"])
    return [driven.status_code, stopped.status_code, released.status_code]


def failing_goal(tourist: Tourist) -> Any:
    """Send an unreachable goal, with the form of its description, and follow it to its end."""
    links = tourist.guide()
    found = tourist.find(links, "navigate", lambda result: result["kind"] == "action")
    action = next(iter(tourist.describe(links, found["resource"])["actions"].values()))
    assert "position" in action["input"]["properties"]["pose"]["properties"]["pose"]["properties"]
    invoke = next(form for form in action["forms"] if form["op"] == "invokeaction")
    sent = tourist.ask("POST", invoke["href"], json={"pose": {"pose": {"position": {"x": 90.0}}}})
    assert sent.status_code == 201, sent.text
    ended = "status != 'accepted' and status != 'executing' and status != 'canceling'"
    return tourist.ask("GET", sent.headers["location"], params={"until": ended, "timeout": "60"}).json()["status"]


def parameter_in_range(tourist: Tourist) -> tuple[float, Any]:
    """Set a parameter to the maximum of its description, and read it; return both."""
    links = tourist.guide()
    found = tourist.find(links, "max_speed", lambda result: result["kind"] == "parameter")
    most = next(iter(tourist.describe(links, found["resource"])["properties"].values()))["maximum"]
    assert tourist.ask("PUT", found["url"], json=most).status_code == 204
    return most, tourist.ask("GET", found["url"]).json()


def battery(tourist: Tourist) -> float:
    """Find the battery and return its charge."""
    found = tourist.find(tourist.guide(), "battery", lambda result: "BatteryState" in result.get("type", ""))
    percentage: float = tourist.ask("GET", found["url"]).json()["percentage"]
    return percentage


def low_battery(tourist: Tourist) -> float:
    """Wait until the battery falls below 20 %."""
    found = tourist.find(tourist.guide(), "battery", lambda result: "BatteryState" in result.get("type", ""))
    while True:
        answer = tourist.ask("GET", found["url"], params={"until": "percentage < 0.2", "timeout": "60"})
        if answer.status_code == 200:
            percentage: float = answer.json()["percentage"]
            return percentage
        assert answer.status_code == 204, answer.text
