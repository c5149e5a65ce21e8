"""Robots in use: after writes, calls, goals, holds and refusals, so that a crawl finds everything that can be said."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx

from tests.adapters.ros1 import system as ros1
from tests.ontology.crawl import Crawl, crawl
from tests.ros2 import system as ros2
from tests.server.conftest import servers
from tests.waiting import until

TURTLE = {"Content-Type": "text/turtle"}
BESIDE = ("stop", "status", "channels/", "sparql", ".well-known/")
"""What not every robot links to."""
AHEAD = {"linear": {"x": 1.0, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}


def told(http: httpx.Client) -> Crawl:
    """What a robot that is in use says."""
    return crawl(http, *BESIDE)


@contextmanager
def aircraft() -> Iterator[httpx.Client]:
    """The embedded aircraft in flight."""
    with servers() as start:
        http = start("aircraft").http
        _keep(http)
        _done(http.put("/topics/cockpit/display", json={"data": "ready"}), 202, 204)
        _refused(http.put("/topics/cockpit/display", json={"data": 5}))
        _refused(http.put("/topics/aircraft/engine/speed", json={"data": 5}))
        _done(http.post("/services/aircraft/start", json={}), 201)
        _refused(http.post("/services/aircraft/engine/set_speed", json={"speed": "fast"}))
        _done(http.put("/resources/aircraft/engine/speed", json=20), 204)
        _done(http.put("/parameters/aircraft/livery", json="red"), 201, 204)
        _done(http.post("/actions/aircraft/fly", json={"distance": 90000}), 201)
        _refused(http.post("/actions/aircraft/fly", json={"distance": 90000}))
        _refused(http.post("/actions/aircraft/fly", json={"distance": "far"}))
        _done(http.post("/topics/cockpit/display", params={"rate": 5, "lease": 5}, json={"data": "held"}), 201)
        _refused(http.post("/topics/cockpit/display", params={"rate": 5, "lease": 5}, json={"data": "held"}))
        yield http


@contextmanager
def rover() -> Iterator[httpx.Client]:
    """The embedded rover, stopped while it drives."""
    with servers() as start:
        http = start("rover").http
        _done(http.post("/topics/cmd_vel", params={"rate": 10, "lease": 5}, json=AHEAD), 201)
        for path in ("/topics/scan", "/topics/odom", "/topics/tf", "/topics/camera/image_raw", "/topics/battery_state"):
            http.get(path)
        _done(http.post("/stop", json={"reason": "for the test"}), 200, 202)
        _refused(http.post("/topics/cmd_vel", params={"rate": 10, "lease": 5}, json=AHEAD))
        yield http


@contextmanager
def a_ros_1(folder: Path) -> Iterator[httpx.Client]:
    """A real ROS 1 of rospy's nodes: services and goals that end in every way, a type that two nodes disagree on."""
    with ros1.running(folder) as system, servers() as start:
        for script in ("services_node.py", "action_node.py"):
            system.node(script)
        system.node("tf_node.py", "arm")
        system.node("listener.py", "/cmd_vel", "geometry_msgs/Twist")
        http = start(system.source, "--setting", "call_deadline", "2").http
        for path in ("/services/works", "/actions/ways", "/topics/cmd_vel"):
            until(lambda path=path: http.get(path).status_code == 200, path)
        for service in ("works", "raises", "refuses", "hangs"):
            http.post(f"/services/{service}", json={})
        _refused(http.post("/services/echoes", json={"data": "yes"}))
        for number in (1, 2, 3, 4):
            http.post("/actions/ways", json={"goal": number})
        _done(http.put("/parameters/speed", json=0.5), 201, 204)
        _done(http.put("/parameters/limits", json={"low": 0, "high": [1, 2]}), 201, 204)
        _done(http.put("/topics/cmd_vel", json=AHEAD), 202, 204)
        _done(http.post("/topics/cmd_vel", params={"rate": 10, "lease": 5}, json=AHEAD), 201)
        _refused(http.put("/topics/cmd_vel", json={"linear": 1}))
        yield http


@contextmanager
def a_ros_2(distro: str) -> Iterator[httpx.Client]:
    """A real ROS 2 of a distro: managed nodes, parameters that are declared, qualities of service, goals and holds."""
    with ros2.running(distro) as system, servers() as start:
        for script in ("rover.py", "aircraft.py", "managed.py"):
            system.node(script)
        http = start(system.source, python=system.python, environment=system.environment).http
        for path in ("/topics/rover/drive", "/services/rover/brake", "/actions/aircraft/fly", "/nodes/camera"):
            until(lambda path=path: http.get(path).status_code == 200, path)
        http.post("/nodes/camera", json={"transition": "configure"})
        _refused(http.post("/nodes/camera", json={"transition": "leap"}))
        for service in ("rover/brake", "aircraft/start"):
            _done(http.post(f"/services/{service}", json={}), 201)
        _done(http.post("/actions/aircraft/fly", json={"distance": 90000}), 201)
        _done(http.put("/topics/rover/drive", json=AHEAD), 202, 204)
        _done(http.post("/topics/rover/drive", params={"rate": 10, "lease": 5}, json=AHEAD), 201)
        _refused(http.post("/topics/rover/drive", params={"rate": 10, "lease": 5}, json=AHEAD))
        yield http


def _keep(http: httpx.Client) -> None:
    """What clients keep: data, a mapping, a query, limits; some of it is refused and some deleted."""
    _done(http.put("/data/notes", content='<> <http://purl.org/dc/terms/title> "Notes" .', headers=TURTLE), 201)
    _done(http.put("/data/picture", content=b"\x89PNG", headers={"Content-Type": "image/png"}), 201)
    _done(http.post("/data/", content="<> a <https://example.org/Log> .", headers={**TURTLE, "Slug": "log"}), 201)
    _done(http.delete("/data/log"), 204)
    shown = '[ map:predicate av:sign ; map:member "/cockpit/display" ]'
    mapping = f'<#a> a map:ComplexResource ; map:path "/cabin/" ; map:property {shown} .'
    prefixes = "@prefix map: <https://w3id.org/rosld/mapping#> . @prefix av: <https://w3id.org/rosld/aircraft#> . "
    _done(http.put("/mappings/cabin", content=prefixes + mapping, headers=TURTLE), 201)
    _refused(http.put("/mappings/bad", content=prefixes + "<#a> a map:ComplexResource .", headers=TURTLE))
    query = {"Content-Type": "application/sparql-query"}
    _done(http.put("/queries/mine", content="# The nodes.\nSELECT ?node { ?node a ros:Node }", headers=query), 201)
    _refused(http.put("/queries/bad", content="SELECT", headers=query))


def _done(answer: httpx.Response, *statuses: int) -> httpx.Response:
    assert answer.status_code in statuses, f"{answer.request.method} {answer.url}: {answer.status_code} {answer.text}"
    return answer


def _refused(answer: httpx.Response) -> None:
    assert 400 <= answer.status_code < 500, f"{answer.request.method} {answer.url}: {answer.status_code} {answer.text}"
