"""Actions of a real ROS 1 over HTTP: goals of other clients, and arrays in feedback."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import httpx
import pytest

from tests import waiting
from tests.adapters.ros1.system import RosSystem, running
from tests.server.test_actions import ROS, until
from tests.stopping import release

pytestmark = pytest.mark.slow

JSON = {"Accept": "application/json"}


@pytest.fixture(scope="module")
def ros(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RosSystem]:
    """A rosmaster with rospy's action servers."""
    with running(tmp_path_factory.mktemp("ros")) as system:
        system.node("action_node.py")
        yield system


@pytest.fixture(scope="module")
def http(ros: RosSystem, start_server: Callable[..., Any]) -> httpx.Client:
    """rosld on it."""
    served: httpx.Client = start_server(ros.source, "--setting", "call_deadline", "5").http
    return served


def goals_of(http: httpx.Client, action: str) -> list[dict[str, Any]]:
    lines = http.get(f"/actions{action}", headers={"Accept": "application/n-triples"}).text.splitlines()
    urls = [line.split(" ")[2].strip("<>") for line in lines if f"<{ROS}hasGoal>" in line]
    return [http.get(url, headers=JSON).json() | {"url": url} for url in urls]


def test_the_goals_of_others_are_resources_that_are_canceled_one_by_one(ros: RosSystem, http: httpx.Client) -> None:
    assert goals_of(http, "/simple") == []
    other = ros.node("action_client.py", "/simple", "600")

    def executing() -> list[dict[str, Any]]:
        found = goals_of(http, "/simple")
        return found if found and found[0]["feedback"] and found[0]["status"] == "executing" else []

    [goal] = waiting.until(executing, "the goal of another")
    assert goal["words"]
    assert "%" not in goal["url"]
    told = http.post("/stop", json={}, headers=JSON)
    assert told.status_code == 200, told.text
    assert told.json()["steps"] == [], "a stop leaves the goals of others alone"
    assert release(http).status_code == 204
    assert executing()
    assert http.delete(goal["url"]).status_code == 202
    assert until(http, goal["url"], "canceled")[-1]["words"] == "preempted"
    other.line("done 2")  # PREEMPTED


def test_feedback_with_arrays_goes_on_to_the_last_and_so_does_the_result(ros: RosSystem, http: httpx.Client) -> None:
    ros.node("fibonacci_node.py")
    waiting.until(lambda: http.get("/actions/fibonacci").status_code == 200, "the action")
    goal = http.post("/actions/fibonacci", json={"order": 7}, headers=JSON)
    assert goal.status_code == 201, goal.text
    told = until(http, goal.headers["location"], "succeeded")
    assert len({len(each["feedback"]["sequence"]) for each in told if each["feedback"]}) > 1
    last = http.get(goal.headers["location"], headers=JSON).json()
    assert last["result"] == last["feedback"] == {"sequence": [0, 1, 1, 2, 3, 5, 8]}
