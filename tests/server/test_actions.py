"""Actions over HTTP: POST sends a goal, the goal is a resource, DELETE cancels it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import httpx
import pytest

from rosld.adapters.base import AdapterOptions
from rosld.adapters.registry import adapter_for
from tests.server.robots.made_up import served

pytestmark = pytest.mark.slow

FLY = "/actions/aircraft/fly"
JSON = {"Accept": "application/json"}
ROS = "https://w3id.org/rosld#"
TYPES = "https://w3id.org/rosld/types/"
STREAM = {"Accept": "text/event-stream"}


@pytest.fixture
def plane(own_aircraft: httpx.Client) -> httpx.Client:
    """An aircraft for one test, with its engine on."""
    assert own_aircraft.post("/services/aircraft/start", json={}).status_code == 201
    return own_aircraft


def sent(http: httpx.Client, distance: float, **headers: str) -> httpx.Response:
    return http.post(FLY, json={"distance": distance}, headers={**JSON, **headers})


def events(http: httpx.Client, url: str) -> Iterator[dict[str, Any]]:
    """Yield the events of a resource's event stream."""
    with http.stream("GET", url, headers=STREAM) as stream:
        assert stream.headers["content-type"].startswith("text/event-stream")
        for line in stream.iter_lines():
            if line.startswith("data: "):
                yield json.loads(line.removeprefix("data: "))


def until(http: httpx.Client, url: str, status: str) -> list[dict[str, Any]]:
    """Return the events of a goal until it has this status."""
    told: list[dict[str, Any]] = []
    for event in events(http, url):
        told.append(event)
        if event["status"] == status:
            return told
    raise AssertionError(f"never {status}: {told}")


def says(http: httpx.Client, url: str, predicate: str) -> list[str]:
    """Return the objects of a predicate of a resource."""
    lines = http.get(url, headers={"Accept": "application/n-triples"}).text.splitlines()
    return [line.split(" ", 2)[2].removesuffix(" .") for line in lines if line.split(" ")[1] == f"<{predicate}>"]


def test_an_action_says_what_it_takes_and_who_serves_it(plane: httpx.Client) -> None:
    base = str(plane.base_url)
    assert says(plane, FLY, f"{ROS}hasActionType") == [f"<{TYPES}rosld_aircraft/action/Fly>"]
    assert says(plane, FLY, f"{ROS}provider") == [f"<{base}nodes/aircraft>"]
    for part in ("goal", "result", "feedback"):
        [shape] = set(says(plane, FLY, f"{ROS}{part}Shape"))
        assert plane.get(shape.strip("<>")).status_code == 200
    assert f"<{base}actions/aircraft/fly>" in says(plane, "/nodes/aircraft", f"{ROS}provides")
    contains = "http://www.w3.org/ns/ldp#contains"
    assert f"<{base}actions/>" in says(plane, "/", contains)
    assert says(plane, "/actions/", contains) == [f"<{base}actions/aircraft/>"]
    assert says(plane, "/actions/aircraft/", contains) == [f"<{base}actions/aircraft/fly>"]
    kind = plane.get("/types/rosld_aircraft/action/Fly", headers={"Accept": "text/turtle"})
    assert "ros:ActionType" in kind.text
    assert "ros:feedbackType" in kind.text


def test_a_goal_is_created_streamed_and_has_a_result_also_in_the_dataset(plane: httpx.Client) -> None:
    answer = sent(plane, 50)
    assert answer.status_code == 201, answer.text
    goal = answer.headers["location"]
    assert answer.headers["content-location"] == goal
    assert answer.json() | {"feedback": None} == {
        "id": goal.rpartition("/")[2],
        "url": goal,
        "offer": f"{goal}?offer",
        "sentBy": "anybody",
        "ended": None,
        "action": "/aircraft/fly",
        "status": "accepted",
        "words": None,
        "goal": {"distance": 50.0},
        "feedback": None,
        "result": None,
    }
    told = until(plane, goal, "succeeded")
    flown = [each["feedback"]["flown"] for each in told if each["feedback"]]
    assert flown == sorted(flown)
    assert len(set(flown)) > 2
    assert told[-1]["result"] == {"flown": 50.0, "message": "arrived"}
    assert {each["status"] for each in told} <= {"accepted", "executing", "succeeded"}
    assert says(plane, goal, f"{ROS}status") == [f"<{ROS}Succeeded>"]
    assert says(plane, goal, f"{ROS}statusWord") == ['"succeeded"']
    assert says(plane, goal, "http://www.w3.org/ns/prov#endedAtTime")
    assert says(plane, FLY, f"{ROS}hasGoal") == [f"<{goal}>"]
    action = f"{plane.base_url}actions/aircraft/fly"
    ask = (
        f"ASK {{ GRAPH <{goal}> {{ <{goal}> <{ROS}status> <{ROS}Succeeded> ; <{ROS}isGoalOf> <{action}> }} "
        f"GRAPH <{action}> {{ <{action}> <{ROS}hasGoal> <{goal}> }} }}"
    )
    assert plane.get("/sparql", params={"query": ask}, headers=JSON).json()["boolean"]


def test_a_goal_is_canceled_and_then_forgotten_by_what_rdf_and_pages_offer(plane: httpx.Client) -> None:
    html = {"Accept": "text/html"}
    page = plane.get(FLY, headers=html).text
    assert "Send a goal" in page
    assert 'name="distance"' in page
    goal = sent(plane, 100_000).headers["location"]
    assert "DELETE" in plane.get(goal).headers["allow"]
    assert "Cancel the goal" in plane.get(goal, headers=html).text
    operations = "https://www.w3.org/2019/wot/hypermedia#hasOperationType"
    cancels = "<https://www.w3.org/2019/wot/td#cancelAction>"
    assert cancels in says(plane, goal, operations)
    answer = plane.delete(goal)
    assert (answer.status_code, answer.headers["location"]) == (202, goal)
    assert until(plane, goal, "canceled")[-1]["result"]["message"] == "canceled"
    assert cancels not in says(plane, goal, operations)
    assert "Forget the goal" in plane.get(goal, headers=html).text
    assert plane.delete(goal).status_code == 204
    assert plane.get(goal).status_code == 410
    assert plane.delete(goal).status_code in (405, 410)
    assert plane.get("/goals/never").status_code == 404


def test_while_it_is_being_canceled_nothing_more_can_be_done(plane: httpx.Client) -> None:
    goal = sent(plane, 100_000).headers["location"]
    for _ in range(20):  # the time between is a tenth of a second at most
        assert plane.delete(goal).status_code == 202
        now = plane.get(goal, headers=JSON)
        if now.json()["status"] == "canceling":
            assert "DELETE" not in now.headers["allow"]
            return
        until(plane, goal, "canceled")
        goal = sent(plane, 100_000).headers["location"]
    raise AssertionError("never seen while it was being canceled")


def test_a_rejected_goal_is_409_with_the_robots_words_and_is_kept(own_aircraft: httpx.Client) -> None:
    http = own_aircraft
    answer = sent(http, 1)
    assert answer.status_code == 409
    assert answer.json()["robotSaid"] == "the aircraft is off: start it first"
    goal = http.get(answer.headers["location"], headers=JSON).json()
    assert (goal["status"], goal["words"]) == ("rejected", answer.json()["robotSaid"])
    assert says(http, answer.headers["location"], f"{ROS}status") == [f"<{ROS}Rejected>"]


def test_a_goal_may_be_sent_as_rdf_and_must_fit_its_type_and_its_limits(plane: httpx.Client) -> None:
    fly = f"{TYPES}rosld_aircraft/action/Fly_Goal"
    for body in ({"distance": "far"}, {"distance": None}, {"distance": 1.0, "speed": 2}):
        answer = plane.post(FLY, json=body)
        assert answer.status_code == 422, body
        assert f"{FLY}?shape>" in answer.headers["link"]
    limit = (
        "@prefix sh: <http://www.w3.org/ns/shacl#> .\n"
        f"<#short> a sh:NodeShape ; sh:targetClass <{fly}> ; sh:property [\n"
        f"  sh:path <{fly}#distance> ; sh:maxInclusive 30 ] .\n"
    )
    assert plane.put("/shapes/short", content=limit, headers={"Content-Type": "text/turtle"}).status_code == 201
    assert sent(plane, 31).status_code == 422
    assert "ldp#contains" not in plane.get("/goals/", headers={"Accept": "application/n-triples"}).text
    body = f'[] a <{fly}> ; <{fly}#distance> "20"^^<http://www.w3.org/2001/XMLSchema#double> .'
    answer = plane.post(FLY, content=body, headers={"Content-Type": "text/turtle", **JSON})
    assert answer.status_code == 201, answer.text
    assert answer.json()["goal"] == {"distance": 20.0}


def test_a_closed_action_takes_no_goals() -> None:
    with served(adapter_for("aircraft", AdapterOptions()), resources_only=("/aircraft/*",)) as http:
        assert "POST" not in http.get(FLY).headers["allow"]
        assert sent(http, 1).status_code == 405
        assert "invokeAction" not in http.get(FLY, headers={"Accept": "application/n-triples"}).text


def test_the_oldest_goal_goes_when_there_are_too_many(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rosld.server.robot.session.MAX_GOALS", 3)
    with served(adapter_for("aircraft", AdapterOptions())) as http:
        urls = [sent(http, 1).headers["location"] for _ in range(4)]
        assert [http.get(url).status_code for url in urls] == [410, 200, 200, 200]
