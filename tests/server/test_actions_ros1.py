"""Actions of a real ROS 1 over HTTP: rospy's servers and clients on one side, plain requests on the other."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests import waiting
from tests.adapters.ros1.system import RosSystem, running
from tests.server.test_actions import ROS, until

JSON = {"Accept": "application/json"}
SUCCEED, ABORT, REJECT, UNTIL_CANCELED, PENDING, VANISH = 1, 2, 3, 4, 5, 6
CONTAINS = "http://www.w3.org/ns/ldp#contains"


@pytest.fixture
def ros(tmp_path: Path) -> Iterator[RosSystem]:
    """A rosmaster of this test's own, with rospy's action servers."""
    with running(tmp_path) as system:
        system.node("action_node.py")
        yield system


@pytest.fixture
def http(ros: RosSystem, serve: Callable[..., Any]) -> httpx.Client:
    """rosld on it."""
    served: httpx.Client = serve(ros.source, "--setting", "call_deadline", "5").http
    return served


def sent(http: httpx.Client, number: int, action: str = "/ways") -> httpx.Response:
    return http.post(f"/actions{action}", json={"goal": number}, headers=JSON)


def goals_of(http: httpx.Client, action: str) -> list[dict[str, Any]]:
    lines = http.get(f"/actions{action}", headers={"Accept": "application/n-triples"}).text.splitlines()
    urls = [line.split(" ")[2].strip("<>") for line in lines if f"<{ROS}hasGoal>" in line]
    return [http.get(url, headers=JSON).json() | {"url": url} for url in urls]


def test_goals_end_in_every_way_and_say_so(http: httpx.Client) -> None:
    done = until(http, sent(http, SUCCEED).headers["location"], "succeeded")[-1]
    assert (done["words"], done["feedback"]) == ("there", {"feedback": 3})
    aborted = until(http, sent(http, ABORT).headers["location"], "aborted")[-1]
    assert aborted["words"] == "the gripper is jammed"
    rejected = sent(http, REJECT)
    assert (rejected.status_code, rejected.json()["robotSaid"]) == (409, "the arm is folded")
    for number in (UNTIL_CANCELED, PENDING):
        goal = sent(http, number).headers["location"]
        assert http.delete(goal).status_code == 202
        told = [each["status"] for each in until(http, goal, "canceled")]
        assert set(told) <= {"accepted", "executing", "canceling", "canceled"}
    lost = until(http, sent(http, VANISH).headers["location"], "lost")[-1]
    assert lost["words"] == "the server of /ways is gone"
    assert sent(http, SUCCEED).status_code in (503, 504)


def test_the_goals_of_others_are_resources_and_can_be_canceled(ros: RosSystem, http: httpx.Client) -> None:
    assert goals_of(http, "/simple") == []
    other = ros.node("action_client.py", "/simple", "600")

    def executing() -> list[dict[str, Any]]:
        found = goals_of(http, "/simple")
        return found if found and found[0]["feedback"] and found[0]["status"] == "executing" else []

    [goal] = waiting.until(executing, "the goal of another")
    assert goal["words"]
    assert "%" not in goal["url"]
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


def test_a_stop_leaves_the_goals_of_others_alone(ros: RosSystem, http: httpx.Client) -> None:
    ros.node("action_client.py", "/simple", "600")
    waiting.until(
        lambda: [each["status"] for each in goals_of(http, "/simple")] == ["executing"], "the goal of another"
    )
    told = http.post("/stop", json={}, headers=JSON)
    assert told.status_code == 200, told.text
    assert told.json()["steps"] == []
    assert [each["status"] for each in goals_of(http, "/simple")] == ["executing"]
