"""Managed nodes of a real ROS 2 over HTTP: their states, transitions, and how they and their endpoints are told."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import httpx
import pytest

from tests.ros2.system import running
from tests.server.conftest import servers
from tests.waiting import until

ROS = "https://w3id.org/rosld#"

pytestmark = pytest.mark.ros2


@pytest.fixture(scope="module")
def http() -> Iterator[httpx.Client]:
    """A client of the managed nodes."""
    with running("jazzy") as system, servers() as start:
        system.node("managed.py")
        client: httpx.Client = start(system.source, python=system.python, environment=system.environment).http
        for name in ("camera", "lidar"):
            until(lambda name=name: word(client, name) == "unconfigured", name)
        yield client


def said(http: httpx.Client, name: str) -> str:
    """What is said of a node, as N-Triples."""
    return http.get(f"/nodes/{name}", headers={"Accept": "application/n-triples"}).text


def word(http: httpx.Client, name: str) -> str | None:
    """The state of a node in its own word."""
    mark = f"<{ROS}lifecycleStateWord> "
    return next((line.partition(mark)[2].split('"')[1] for line in said(http, name).splitlines() if mark in line), None)


def post(http: httpx.Client, name: str, transition: str) -> httpx.Response:
    return http.post(f"/nodes/{name}", json={"transition": transition})


def test_transitions_are_made_told_of_by_events_and_refused_where_they_are_not_legal(http: httpx.Client) -> None:
    refused = post(http, "camera", "activate")
    assert refused.status_code == 409, refused.text
    assert refused.json()["transitions"] == ["configure", "shutdown"]
    with http.stream("GET", "/nodes/camera?format=nt", headers={"Accept": "text/event-stream"}) as stream:
        lines = stream.iter_lines()
        assert next(line for line in lines if f"{ROS}Unconfigured" in line)
        assert post(http, "camera", "configure").status_code == 204
        assert next(line for line in lines if f"{ROS}Inactive" in line)
    assert word(http, "camera") == "inactive"
    rdf = {"Content-Type": "text/turtle", "Prefer": "return=representation", "Accept": "application/n-triples"}
    shown = http.post("/nodes/camera", content=f"<> <{ROS}transition> 'activate' .", headers=rdf)
    assert shown.status_code == 200
    assert f"<{ROS}Active>" in shown.text
    assert http.post("/nodes/plain", json={"transition": "configure"}).status_code == 405


def test_a_transition_that_fails_or_hangs_is_told_as_such(http: httpx.Client) -> None:
    failed = post(http, "lidar", "configure")
    assert failed.status_code == 409, failed.text
    assert (failed.json()["state"], failed.json()["sent"]) == ("unconfigured", "yes")
    assert post(http, "lidar", "configure").status_code == 204
    until(lambda: http.get("/services/go").status_code == 200, "the service that lets it go on")
    with ThreadPoolExecutor(1) as thread:
        slow = thread.submit(post, http, "lidar", "activate")
        until(lambda: word(http, "lidar") == "activating", "activating")
        again = post(http, "lidar", "activate")
        assert again.status_code == 409, again.text
        assert (again.json()["state"], again.json()["transitions"]) == ("activating", [])
        assert http.post("/services/go").status_code == 201
        assert slow.result().status_code == 204, slow.result().text
    assert word(http, "lidar") == "active"


def test_a_node_tells_its_endpoints_its_parameters_and_what_it_provides(http: httpx.Client) -> None:
    until(lambda: "/parameters/camera/exposure>" in said(http, "camera"), "the parameter")
    camera = said(http, "camera")
    endpoint = f"{http.base_url}topics/camera/image#publisher/camera"
    assert f"<{ROS}hasEndpoint> <{endpoint}>" in camera
    assert f"<{endpoint}> <{ROS}ofTopic> <{http.base_url}topics/camera/image>" in camera
    assert f'<{ROS}reliability> "reliable"' in camera
    assert f"<{ROS}provides> <{http.base_url}services/camera/change_state>" in camera
    rows = http.get("/queries/lifecycles?format=csv").text.splitlines()
    assert any(row.startswith(f"{http.base_url}nodes/camera,/camera,") for row in rows), rows
