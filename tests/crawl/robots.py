"""Robots in use: after writes, calls, goals, holds and refusals, so that a crawl finds all kinds of statements."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TypeAlias

import httpx
import numpy as np
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

from tests.adapters.ros1 import system as ros1_system
from tests.ros2 import system as ros2_system
from tests.server.conftest import servers
from tests.waiting import until

TURTLE = {"Content-Type": "text/turtle"}
JSON = {"Accept": "application/json"}
AHEAD = {"linear": {"x": 1.0, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}
HELD = {"rate": 5, "for": 60}
RIGHTS = """[[rule]]
agents = ["anybody"]
modes = ["read", "write", "control", "administer"]
paths = ["/**"]
"""
PREFIXES = """@prefix sh: <http://www.w3.org/ns/shacl#> . @prefix rdf: <http://www.w3.org/1999/02/22-rdf-syntax-ns#> .
@prefix map: <https://w3id.org/rosld/mapping#> . @prefix av: <https://w3id.org/rosld/aircraft#> .
"""
MAPPING = """<#a> a map:ComplexResource ; map:path "/cabin/" ; map:property [
  map:predicate av:sign ; map:member "/cockpit/display" ] ."""
LIMITS = """<#slow> a sh:NodeShape ; sh:targetNode <../resources/aircraft/engine/speed> ;
  sh:property [ sh:path rdf:value ; sh:maxInclusive 900 ] ."""
QUERY = "# Everything.\n# @param most integer 5 -- what it is\nSELECT * { ?s ?p ?most }"


@contextmanager
def aircraft(folder: Path) -> Iterator[httpx.Client]:
    """Run the embedded aircraft in flight, with everything that a client may store."""
    rights = folder / "auth.toml"
    rights.write_text(RIGHTS)
    rights.chmod(0o600)
    with servers() as start:
        http = start("aircraft", "--auth", str(rights)).http
        _keep(http)
        _done(http.put("/topics/cockpit/display", json={"data": "ready"}))
        _refused(http.put("/topics/cockpit/display", json={"data": 5}))
        _refused(http.put("/topics/aircraft/engine/speed", json={"data": 5}))
        _done(http.post("/services/aircraft/start", json={}))
        _refused(http.post("/services/aircraft/engine/set_speed", json={"speed": "fast"}))
        _done(http.put("/resources/aircraft/engine/speed", json=20))
        _refused(http.put("/resources/aircraft/engine/speed", json=5000))
        _done(http.put("/parameters/aircraft/livery", json="red"))
        _done(http.put("/parameters/cockpit/layout", json={"left": [1, {"a": "b"}], "right": 0.5}))
        _done(http.post("/actions/aircraft/fly", json={"distance": 90000}))
        _refused(http.post("/actions/aircraft/fly", json={"distance": 90000}))
        _refused(http.post("/actions/aircraft/fly", json={"distance": "far"}))
        _done(http.post("/topics/cockpit/display", params=HELD | {"then": "zero"}, json={"data": "held"}))
        _refused(http.post("/topics/cockpit/display", params=HELD, json={"data": "held"}))
        yield http


@contextmanager
def rover(folder: Path) -> Iterator[httpx.Client]:
    """Run the embedded rover, stopped while it drives."""
    with servers() as start:
        http = start("rover").http
        _done(http.post("/topics/cmd_vel", params=HELD, json=AHEAD))
        for path in ("/topics/scan", "/topics/odom", "/topics/tf", "/topics/camera/image_raw", "/topics/battery_state"):
            http.get(path)
        _done(http.post("/stop", json={"reason": "for the test"}))
        _refused(http.post("/topics/cmd_vel", params=HELD, json=AHEAD))
        yield http


@contextmanager
def recording(folder: Path) -> Iterator[httpx.Client]:
    """Play a recording of an image, of points, and of a string that is not UTF-8."""
    path, types = folder / "walk.bag", get_typestore(Stores.ROS1_NOETIC)
    made = types.types
    header = made["std_msgs/msg/Header"](seq=1, stamp=made["builtin_interfaces/msg/Time"](5, 6), frame_id="eye")
    pixels = np.zeros(480 * 1920, np.uint8)
    messages = {
        "/eye": made["sensor_msgs/msg/Image"](header, 480, 640, "rgb8", 0, 1920, pixels),
        "/place": made["geometry_msgs/msg/Point"](1.0, np.nan, -np.inf),
    }
    said = [(topic, one.__msgtype__, types.serialize_ros1(one, one.__msgtype__)) for topic, one in messages.items()]
    said.append(("/name", "std_msgs/msg/String", b"\x02\0\0\0\xff\xfe"))
    path.unlink(missing_ok=True)
    with Writer(path) as bag:
        for number, (topic, name, data) in enumerate(said):
            bag.write(bag.add_connection(topic, name, typestore=types, callerid="/walker"), 10**18 + number, data)
    with servers() as start:
        yield start(str(path)).http


@contextmanager
def ros1(folder: Path) -> Iterator[httpx.Client]:
    """Run a real ROS 1: a rospy aircraft, transforms, services and goals that end in every way, a large string."""
    with ros1_system.running(folder) as system, servers() as start:
        system.node("aircraft_node.py", str(folder / "classes"))
        for script in ("cockpit_node.py", "services_node.py", "action_node.py", "odd_type_node.py"):
            system.node(script)
        system.node("tf_node.py", "wing")
        system.node("latched_node.py", "talker", "/large", "a" * 70_000)
        system.node("listener.py", "/cmd_vel", "geometry_msgs/Twist")
        http = start(system.source, "--setting", "call_deadline", "2").http
        for path in (
            *("/topics/tf", "/topics/large", "/topics/odd", "/topics/cmd_vel"),
            *("/services/raises", "/services/works", "/actions/simple", "/actions/ways"),
        ):
            until(lambda path=path: http.get(path).status_code == 200, path)
        for path in ("/topics/tf", "/topics/large"):
            until(lambda path=path: http.get(path, headers=JSON).json(), f"a message of {path}")
        for service in ("works", "raises", "refuses", "hangs"):
            http.post(f"/services/{service}", json={})
        _done(http.post("/services/echoes", json={"data": True}))
        _refused(http.post("/services/echoes", json={"data": "yes"}))
        for number in (1, 2, 3, 4):
            http.post("/actions/ways", json={"goal": number})
        _done(http.put("/parameters/speed", json=0.5))
        _done(http.put("/parameters/arm", json={"length": 1.5, "names": ["a"], "limits": {"low": 0, "high": [1, 2]}}))
        _done(http.put("/topics/cmd_vel", json=AHEAD))
        _done(http.post("/topics/cmd_vel", params=HELD, json=AHEAD))
        _refused(http.put("/topics/cmd_vel", json={"linear": 1}))
        yield http


@contextmanager
def ros2(folder: Path) -> Iterator[httpx.Client]:
    """Run a real ROS 2: managed nodes, declared parameters, qualities of service, goals and holds."""
    with ros2_system.running("jazzy") as system, servers() as start:
        for script in ("rover.py", "pilot.py", "managed.py"):
            system.node(script)
        http = start(system.source, python=system.python, environment=system.environment).http
        for path in ("/topics/rover/drive", "/services/rover/brake", "/actions/fly", "/nodes/camera"):
            until(lambda path=path: http.get(path).status_code == 200, path)
        until(lambda: "unconfigured" in http.get("/nodes/camera").text, "the state of the camera")
        http.post("/nodes/camera", json={"transition": "configure"})
        _refused(http.post("/nodes/camera", json={"transition": "leap"}))
        _done(http.post("/services/rover/brake", json={}))
        _done(http.post("/actions/fly", json={"distance": 90000}))
        _done(http.put("/topics/rover/drive", json=AHEAD))
        _done(http.post("/topics/rover/drive", params=HELD, json=AHEAD))
        _refused(http.post("/topics/rover/drive", params=HELD, json=AHEAD))
        yield http


Robot: TypeAlias = Callable[[Path], AbstractContextManager[httpx.Client]]
ROBOTS: Mapping[str, Robot] = {
    "aircraft": aircraft,
    "rover": rover,
    "recording": recording,
    "ros1": ros1,
    "ros2": ros2,
}


def _keep(http: httpx.Client) -> None:
    """Store data, a mapping, limits and queries; some are rejected and one is deleted."""
    _done(http.put("/data/notes", content=f"{PREFIXES} <> a rdf:Bag ; av:sign [ ] .", headers=TURTLE))
    _done(http.put("/data/folder/b", content="<#x> <http://ex.org/p> 5 .", headers=TURTLE))
    _done(http.put("/data/picture", content=b"\x89PNG", headers={"Content-Type": "image/png"}))
    _done(http.post("/data/", content="<> a <https://example.org/Log> .", headers={**TURTLE, "Slug": "log"}))
    _done(http.delete("/data/log"))
    _done(http.put("/mappings/cabin", content=PREFIXES + MAPPING, headers=TURTLE))
    _refused(http.put("/mappings/bad", content=f"{PREFIXES} <#a> a map:ComplexResource .", headers=TURTLE))
    _done(http.put("/shapes/slow", content=PREFIXES + LIMITS, headers=TURTLE))
    query = {"Content-Type": "application/sparql-query"}
    _done(http.put("/queries/mine", content=QUERY, headers=query))
    _refused(http.put("/queries/bad", content="SELECT", headers=query))


def _done(answer: httpx.Response) -> None:
    assert answer.is_success, f"{answer.request.method} {answer.url}: {answer.status_code} {answer.text}"


def _refused(answer: httpx.Response) -> None:
    assert 400 <= answer.status_code < 500, f"{answer.request.method} {answer.url}: {answer.status_code} {answer.text}"
