"""A real ROS 2 over HTTP: declared parameters, lifecycles, hidden names, `--qos`, goals, holds and the stop."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import httpx
import pyshacl
import pytest
import rdflib

from tests.processes import Process
from tests.ros2.system import System, running
from tests.server.conftest import Served, servers
from tests.stopping import release
from tests.waiting import until

pytestmark = [pytest.mark.slow, pytest.mark.ros2]

FLY, DRIVE, BRAKE = "/actions/fly", "/topics/rover/drive", "/services/rover/brake"
LAMP, DISPLAY = "/parameters/lamp/", "/topics/cockpit/display"
ROS = rdflib.Namespace("https://w3id.org/rosld#")
LDP = rdflib.Namespace("http://www.w3.org/ns/ldp#")
NTRIPLES = {"accept": "application/n-triples"}
MERGE = {"content-type": "application/merge-patch+json"}
STILL = {part: {"x": 0.0, "y": 0.0, "z": 0.0} for part in ("linear", "angular")}
AHEAD = {**STILL, "linear": {"x": 1.5, "y": 0.0, "z": 0.0}}


@pytest.fixture(scope="module")
def system() -> Iterator[System]:
    """A robot, an action, and nodes with a lifecycle."""
    with running("jazzy") as found:
        for node in ("robot.py", "pilot.py", "managed.py"):
            found.node(node)
        yield found


@pytest.fixture(scope="module")
def rover(system: System) -> Process:
    """A rover that prints its commands."""
    return system.node("rover.py")


def served(start: Any, system: System, *options: str) -> Served:
    """Run a server of the system and wait until it has found the rover."""
    found: Served = start(system.source, *options, python=system.python, environment=system.environment)
    found.http.headers["accept"] = "application/json"
    until(lambda: found.http.get(DRIVE).status_code == 200, "the rover")
    return found


@pytest.fixture(scope="module")
def server(system: System, rover: Process) -> Iterator[Served]:
    """The server, once it knows everything that the tests use."""
    with servers() as start:
        found = served(start, system, "--qos", "/cockpit/*=best_effort,depth:3")
        for path in (f"{LAMP}level", "/parameters/listener/seats"):
            until(lambda path=path: "?shape" in found.http.get(path).headers.get("link", ""), path)
        for path in (FLY, BRAKE, DISPLAY):
            until(lambda path=path: found.http.get(path).status_code == 200, path)
        until(lambda: state_of(found.http, "camera") == "unconfigured", "the camera")
        yield found


@pytest.fixture
def http(server: Served) -> httpx.Client:
    return server.http


def graph(http: httpx.Client, path: str) -> rdflib.Graph:
    return rdflib.Graph().parse(data=http.get(path, headers={"accept": "text/turtle"}).text, format="turtle")


# Parameters


def test_what_nodes_declare_of_parameters_is_told_and_held_and_they_judge_the_rest(http: httpx.Client) -> None:
    found = graph(http, f"{LAMP}level")
    (subject,) = found.subjects(ROS.value)
    assert str(found.value(subject, rdflib.DCTERMS.description)) == "How bright it is."
    for value, good in ((0, True), (20, True), (25, False), (7, False), (0.5, False)):
        found.set((subject, ROS.value, rdflib.Literal(value)))
        assert pyshacl.validate(found, shacl_graph=found)[0] is good, value
    for name, methods in {"level": {"PUT", "PATCH"}, "serial": set(), "any": {"PUT", "PATCH", "DELETE"}}.items():
        allowed = set(http.get(LAMP + name).headers["allow"].split(", "))
        assert allowed == {"GET", "HEAD", "OPTIONS"} | methods
    assert http.put(f"{LAMP}gain", json=1).status_code == 204  # a double, though JSON says it as an integer
    assert http.patch(LAMP, json={"level": 15, "gain": 0.3}, headers=MERGE).status_code == 204
    assert http.put(f"{LAMP}level", json=12).status_code == 422, "between two steps"
    assert http.patch(LAMP, json={"level": 10, "gain": 2.0}, headers=MERGE).status_code == 422
    values = http.get(LAMP).json()
    assert (values["level"], values["gain"], values["serial"]) == (15, 0.3, "A7")
    refused = http.patch("/parameters/listener/", json={"seats": 9, "name": "Grace"}, headers=MERGE)
    assert refused.status_code == 422
    assert "there are four seats at most" in refused.json()["robotSaid"]
    assert http.get("/parameters/listener/name").json() == "Ada"


# Lifecycles


def state_of(http: httpx.Client, name: str) -> str | None:
    """Return the name of a node's state."""
    return next(map(str, graph(http, f"/nodes/{name}").objects(None, ROS.lifecycleStateWord)), None)


def change(http: httpx.Client, name: str, transition: str) -> httpx.Response:
    return http.post(f"/nodes/{name}", json={"transition": transition})


def test_transitions_are_made_told_of_by_events_and_refused_where_they_are_not_legal(http: httpx.Client) -> None:
    refused = change(http, "camera", "activate")
    assert refused.status_code == 409, refused.text
    assert refused.json()["transitions"] == ["configure", "shutdown"]
    with http.stream("GET", "/nodes/camera?format=nt", headers={"accept": "text/event-stream"}) as stream:
        lines = stream.iter_lines()
        assert next(line for line in lines if f"{ROS}Unconfigured" in line)
        assert change(http, "camera", "configure").status_code == 204
        assert next(line for line in lines if f"{ROS}Inactive" in line)
    assert state_of(http, "camera") == "inactive"
    assert change(http, "camera", "activate").status_code == 204
    assert state_of(http, "camera") == "active"
    assert change(http, "plain", "configure").status_code == 405


# Hidden names, and quality of service


def listed(http: httpx.Client, path: str) -> set[str]:
    """Return the URLs that a container lists, relative to it."""
    url = f"{str(http.base_url).rstrip('/')}{path}".partition("?")[0]
    return {str(each).removeprefix(url) for each in graph(http, path).objects(None, LDP.contains)}


def test_the_inner_names_of_an_action_are_listed_when_hidden_ones_are_asked_for(http: httpx.Client) -> None:
    assert "fly/" not in listed(http, "/topics/")
    assert "fly/" in listed(http, "/topics/?hidden=true")
    assert listed(http, "/topics/fly/_action/") == {"feedback", "status"}
    assert listed(http, "/services/fly/_action/") == {"send_goal", "cancel_goal", "get_result"}
    assert http.get("/topics/fly/_action/status", headers=NTRIPLES).status_code == 200
    called = http.post("/services/fly/_action/send_goal", json={})
    assert called.status_code == 405
    assert "the action /fly" in called.json()["detail"]
    assert http.put("/topics/fly/_action/feedback", json={}).status_code == 405
    assert "_action" not in http.get("/resources/").text


def test_a_glob_of_qos_overrides_what_rosld_publishes_with_and_the_mismatch_is_told(http: httpx.Client) -> None:
    put = http.put(DISPLAY, json={"data": "climb"})
    assert put.status_code == 202, put.text  # a reliable subscriber does not receive from a best-effort publisher
    found = graph(http, DISPLAY)

    def told(predicate: rdflib.URIRef, about: str) -> list[str]:
        return [str(value) for subject, value in found.subject_objects(predicate) if about in str(subject)]

    assert told(ROS.reliability, "qos/publisher/rosld") == ["best_effort"]
    assert told(ROS.offered, "qos-mismatch") == ["best_effort"]
    assert told(ROS.requested, "qos-mismatch") == ["reliable"]


# Holds and the stop


def speeds(rover: Process) -> list[float]:
    """Return the commands of the rover since its output was last cleared."""
    return [float(line.split()[1]) for line in rover.seen if line.startswith("drive ")]


def hold(http: httpx.Client, rover: Process, **query: Any) -> str:
    """Hold the drive forwards; return the URL of the hold, once the rover receives it."""
    rover.seen.clear()
    answer = http.post(DRIVE, params={"rate": 20, **query}, json=AHEAD)
    assert answer.status_code == 201, answer.text
    until(lambda: len(speeds(rover)) > 3, "commands")
    return str(answer.headers["location"])


def stands(rover: Process) -> None:
    until(lambda: speeds(rover)[-1:] == [0.0], "standing still")


def put(http: httpx.Client, twist: Any = STILL) -> int:
    return http.put(DRIVE, json=twist).status_code


def test_a_stop_and_a_hold_heed_other_publishers_and_forget_those_that_were_killed(
    http: httpx.Client, system: System, rover: Process
) -> None:
    with servers() as start:
        other = served(start, system, "--allow-publish", "/rover/drive")
        theirs = hold(other.http, rover, **{"for": 60})
        stopped = http.post("/stop").json()  # by a server that never published
        [step] = stopped["steps"]
        assert (step["does"], step["state"]) == ("publish zero on /rover/drive", "Succeeded")
        assert stopped["warning"] is None
        assert step["subscribers"] in (1, 2), "the rover, and the other server while it looks"
        until(lambda: speeds(rover).count(0.0) >= 15, "zero for a second")
        assert [other.http.delete(url).status_code for url in (theirs, DRIVE)] == [204, 204]
        until(lambda: put(http) == 204, "the other is no publisher any more, and zero passes")
        assert put(http, AHEAD) == 423
        assert release(http).status_code == 204

        held = hold(http, rover, lease=5)
        assert put(other.http) == 204

        def is_over() -> bool:
            assert put(other.http) == 204  # it continues publishing
            return http.patch(held).status_code == 410  # which renews the hold, so that it does not expire

        until(is_over, "the end of the hold")
        assert "/rover/drive is published by" in http.get(held).json()["detail"]
        assert put(http) == 405
        other.process.kill()
        other.process.wait(10)
        until(lambda: put(http) == 204, "the first commands the rover again")


def test_the_rover_stands_still_before_the_server_has_ended(server: Served, rover: Process) -> None:
    """This must be the last test of the system, as it ends the server."""
    hold(server.http, rover, lease=5)
    before = len(speeds(rover))
    assert server.stop() == 0
    stands(rover)
    assert speeds(rover)[before:].count(0.0) == 1
