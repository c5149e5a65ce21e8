"""The pages of real servers: of the aircraft, the rover, and a robot with all kinds of resources."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import httpx
import numpy as np

from rosld.adapters.base import AdapterOptions
from rosld.adapters.model import Service, TypeRef
from rosld.adapters.registry import adapter_for
from tests.server.robots.asking import mapped
from tests.server.robots.made_up import MadeUp, served

HTML = {"Accept": "text/html"}
STOPPED = {
    "entry": "/", "display": "/topics/cockpit/display", "service": "/services/aircraft/engine/set_speed",
    "message_type": "/types/std_msgs/msg/Float64", "sparql": "/sparql", "problem": "/no/such/place",
    "results": "/sparql?query=SELECT * { ?topic a ros:Topic ; ros:hasMessageType ?type }",
    "query": "/queries/silent-topics", "aircraft_stopped": "/resources/aircraft/",
    "select": "/resources/aircraft/power",
    "press": "/resources/aircraft/start", "parameter": "/parameters/cockpit/night", "stop": "/stop",
    "find": "/find?q=speed",
}  # fmt: skip
STARTED = {
    "aircraft_started": "/resources/aircraft/",
    "engine": "/resources/aircraft/engine/", "number": "/resources/aircraft/engine/speed",
}  # fmt: skip
ROVER = {
    "rover_camera": "/topics/camera/image_raw", "graph": "/graph",
    "space": "/space", "frames": "/frames", "rover_map": "/topics/map",
    "diagnostics": "/diagnostics", "diagnostic": "/diagnostics?name=rover%3A%20battery",
    "twist": "/topics/cmd_vel", "rover_scan": "/topics/scan",
    "node": "/nodes/rover",
    "rover_resources": "/resources/rover/", "actions": "/actions/", "action": "/actions/navigate_to",
}  # fmt: skip
TURTLE = {
    "odometry": "/topics/odom",
    "transforms": "/topics/tf", "topics": "/topics/", "camera": "/topics/camera/",
    "unmapped": "/resources/turtle1/", "pose": "/resources/arm/goal",
    "gains": "/parameters/turtle1/gains/", "wing": "/resources/wing/",
}  # fmt: skip
POSE = "geometry_msgs/msg/PoseStamped"
MAPPING = """
<#wing> a map:ComplexResource ; map:path "/wing/" ; map:property [
  map:predicate ex:speed ; map:member "speed" ;
  <http://qudt.org/schema/qudt/hasUnit> <http://qudt.org/vocab/unit/REV-PER-MIN> ] .
"""
LIMITS = """
@prefix sh: <http://www.w3.org/ns/shacl#> . @prefix rdf: <http://www.w3.org/1999/02/22-rdf-syntax-ns#> .
<#gear> a sh:NodeShape ; sh:targetNode <resources/turtle1/gear> ; sh:property [ sh:path rdf:value ; sh:in ( 1 2 ) ] .
"""


def turtle() -> MadeUp:
    """Return a robot without a mapping, with everything that may be in a namespace."""
    robot = MadeUp()
    robot.topic("/odom", "nav_msgs/msg/Odometry", {"child_frame_id": "base_link"}, heard=True)
    robot.topic("/camera/image_raw", "sensor_msgs/msg/Image", {"height": 480, "data": "AAECAwQFBgcICQ=="})
    robot.topic("/camera/image_raw/compressed", "sensor_msgs/msg/CompressedImage")
    ranges = [round(1 + 0.5 * float(np.sin(step / 40)), 4) for step in range(360)]
    robot.topic("/front_laser_scan", "sensor_msgs/msg/LaserScan", {"ranges": [*ranges, "INF"]})
    frames = ("base_link", "laser", "camera", "left_wheel", "right_wheel", "arm", "gripper")
    robot.topic("/tf", "tf2_msgs/msg/TFMessage", {"transforms": [{"child_frame_id": frame} for frame in frames]})
    robot.topic("/arm/goal", POSE, {"pose": {"position": {"x": 1.5}}}, heard=True)
    robot.topic("/turtle1/pose", "turtlesim/msg/Pose", {"x": 5.5})
    robot.variable("/turtle1/gear", "Byte", value=3)
    robot.variable("/turtle1/lamp", "Byte", get=None, value=1)
    robot.variable("/turtle1/battery", "Byte", set=None, value=1)
    robot.hold("/turtle1/get_battery")
    robot.parameter("/turtle1/awake", True)
    robot.topic("/turtle1/distance", "std_msgs/msg/Float64")
    robot.variable("/wing/speed", "Byte", value=5)
    for name, value in (("name", "Leonardo"), ("limits", [0.5, 1.0, 1.5]), ("gains", {"p": 1.5, "i": [1, 2, 3]})):
        robot.parameter(f"/turtle1/{name}", value)
    robot.answer("/turtle1/reset", "std_srvs/srv/Empty")
    robot.answer("/turtle1/set_pen", "turtlesim/srv/SetPen")
    robot.strange(Service("/turtle1/dance", TypeRef("odd/srv/Dance"), uncallable="its type is known to nobody here"))
    robot.answer("/turtle1/draw", "std_srvs/srv/Trigger", success=False, message="there is no ink")
    robot.answer("/turtle1/left_arm/wave", "std_srvs/srv/Trigger", success=True)
    return robot


def page(http: httpx.Client, path: str) -> bytes:
    """Return a page, or the text of a problem as one."""
    answer = http.get(path, headers=HTML)
    assert answer.headers["content-type"].startswith("text/html"), (path, answer.status_code, answer.text[:500])
    return answer.content


def submitted(http: httpx.Client, path: str, action: str, **fields: str) -> bytes:
    """Return the response to a form of a page filled in with these fields."""
    text = http.get(path, headers=HTML).text.partition("<main")[2]
    form = next(each for each in re.findall(r"<form.*?</form>", text, re.DOTALL) if f'value="{action}"' in each)
    hidden = dict(re.findall(r'<input type="hidden" name="([^"]+)" value="([^"]*)"', form))
    answer = http.post(path, data={**hidden, **fields}, headers={**HTML, "Origin": str(http.base_url).rstrip("/")})
    assert answer.headers["content-type"].startswith("text/html"), answer.text[:500]
    return answer.content


def real_pages(folder: Path) -> Mapping[str, bytes]:
    """Return all pages by name."""
    found: dict[str, bytes] = {}
    with served(adapter_for("aircraft", AdapterOptions())) as http:
        found |= {name: page(http, path) for name, path in STOPPED.items()}
        call = http.post("/services/aircraft/start", json={}).headers["location"]
        found["call"] = page(http, call)
        found |= {name: page(http, path) for name, path in STARTED.items()}
        found["limited"] = submitted(http, "/resources/aircraft/engine/speed", "PUT", value="1200")
    with served(adapter_for("rover", AdapterOptions())) as http:
        found |= {name: page(http, path) for name, path in ROVER.items()}
        found["refused"] = submitted(http, "/topics/cmd_vel", "PUT", **{"linear.x": "fast"})
    robot, limits = turtle(), folder / "limits.ttl"
    limits.write_text(LIMITS)
    with served(robot, shapes=(limits,), read_deadline=0.5, allow_publish=("/odom",)) as http:
        latest = http.get("/topics/odom", headers={"Accept": "application/json"}).json()
        http.put("/topics/odom", json=latest).raise_for_status()
        mapped(http, MAPPING)
        robot.publishes("/odom", {"child_frame_id": "base_link"})
        found |= {name: page(http, path) for name, path in TURTLE.items()}
        found["declined"] = submitted(http, "/resources/turtle1/draw", "POST")
        robot.release("/turtle1/get_battery")
        robot.goes_stale("no answer since 01:31:41 UTC")
        found["stale"] = page(http, "/")
    return found
