"""The rclpy aircraft over HTTP: each end that a goal can come to, hidden names, and `--qos`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import httpx
import pytest
from pyoxigraph import NamedNode, RdfFormat, parse

from rosld.ontology.vocab import ldp, ros
from tests.ros2.system import running
from tests.server.conftest import servers
from tests.waiting import until

FLY = "/actions/aircraft/fly"

pytestmark = pytest.mark.ros2


@pytest.fixture(scope="module")
def http() -> Iterator[httpx.Client]:
    """A client of the aircraft, as JSON."""
    with running("jazzy") as system, servers() as start:
        system.node("aircraft.py")
        options = ("--qos", "/cockpit/*=best_effort,depth:3")
        served = start(system.source, *options, python=system.python, environment=system.environment)
        client: httpx.Client = served.http
        client.headers["Accept"] = "application/json"
        for path in (FLY, "/services/aircraft/start", "/services/aircraft/stop", "/services/aircraft/engine/set_speed"):
            until(lambda path=path: client.get(path).status_code == 200, path)
        yield client


def fly(http: httpx.Client, distance: float, speed: float) -> str:
    """Start, set the speed, send a goal; its path."""
    http.post("/services/aircraft/start")
    assert http.post("/services/aircraft/engine/set_speed", json={"data": speed}).json()["success"] is True
    sent = http.post(FLY, json={"distance": distance})
    assert sent.status_code == 201, sent.text
    return httpx.URL(sent.headers["location"]).path


def ended(http: httpx.Client, goal: str, status: str) -> Any:
    """The goal, once it has this status and its result."""

    def found() -> Any:
        shown = http.get(goal).json()
        return shown if shown["status"] == status and shown["result"] is not None else None

    return until(found, status)


def stop(http: httpx.Client) -> None:
    """Come to rest, and switch off."""
    http.post("/services/aircraft/engine/set_speed", json={"data": 0.0})
    until(lambda: http.post("/services/aircraft/stop").json()["success"], "the aircraft off")


def test_a_goal_is_rejected_while_the_aircraft_is_off(http: httpx.Client) -> None:
    stop(http)
    sent = http.post(FLY, json={"distance": 5.0})
    assert sent.status_code == 409, sent.text
    assert http.get(sent.headers["location"]).json()["status"] == "rejected"


def test_a_goal_gives_feedback_and_succeeds(http: httpx.Client) -> None:
    goal = fly(http, 5.0, 20.0)
    shown = ended(http, goal, "succeeded")
    assert shown["result"]["message"] == "there"
    assert shown["result"]["flown"] >= 5.0
    assert shown["feedback"]["flown"] > 0.0
    stop(http)


def test_a_goal_is_canceled_by_delete(http: httpx.Client) -> None:
    goal = fly(http, 1e6, 20.0)
    until(lambda: http.get(goal).json()["feedback"], "feedback")
    assert http.delete(goal).status_code == 202
    assert ended(http, goal, "canceled")["result"]["message"] == "canceled"
    stop(http)


def test_a_goal_is_aborted_when_the_aircraft_is_switched_off(http: httpx.Client) -> None:
    goal = fly(http, 1e6, 0.0)
    stop(http)
    assert ended(http, goal, "aborted")["result"]["message"] == "the aircraft is off"


def listed(http: httpx.Client, path: str) -> set[str]:
    """The URLs that a container lists, relative to it."""
    answer = http.get(path, headers={"Accept": "application/n-triples"})
    assert answer.status_code == 200, answer.text
    url = str(answer.url).partition("?")[0]
    triples = (quad.triple for quad in parse(answer.content, format=RdfFormat.N_TRIPLES))
    return {one.object.value.removeprefix(url) for one in triples if one.predicate == ldp.contains}


def test_the_inner_names_of_an_action_are_listed_when_hidden_ones_are_asked_for(
    http: httpx.Client,
) -> None:
    assert "fly/" not in listed(http, "/topics/aircraft/")
    assert "fly/" in listed(http, "/topics/aircraft/?hidden=true")
    inner = f"{FLY.removeprefix('/actions')}/_action"
    assert listed(http, f"/topics{inner}/") == {"feedback", "status"}
    assert listed(http, f"/services{inner}/") == {"send_goal", "cancel_goal", "get_result"}
    assert http.get(f"/topics{inner}/status", headers={"Accept": "text/turtle"}).status_code == 200
    called = http.post(f"/services{inner}/send_goal", json={})
    assert called.status_code == 405
    assert f"the action {FLY.removeprefix('/actions')}" in called.json()["detail"]
    assert http.put(f"/topics{inner}/feedback", json={}).status_code == 405
    members = http.get("/resources/aircraft/").json()
    assert "_action" not in str(members)


def test_a_glob_of_qos_overrides_what_rosld_publishes_with_and_the_mismatch_is_told(http: httpx.Client) -> None:
    until(lambda: http.get("/topics/cockpit/display").status_code == 200, "the cockpit")
    put = http.put("/topics/cockpit/display", json={"data": "climb"})
    assert put.status_code == 202, put.text  # who wants all of it does not hear who promises nothing
    told = http.get("/topics/cockpit/display", headers={"Accept": "application/n-triples"})
    triples = [quad.triple for quad in parse(told.content, format=RdfFormat.N_TRIPLES)]

    def said(predicate: NamedNode, about: str) -> list[str]:
        return [one.object.value for one in triples if one.predicate == predicate and about in str(one.subject)]

    assert said(ros.reliability, "qos/publisher/rosld") == ["best_effort"]
    assert said(ros.offered, "qos-mismatch") == ["best_effort"]
    assert said(ros.requested, "qos-mismatch") == ["reliable"]
