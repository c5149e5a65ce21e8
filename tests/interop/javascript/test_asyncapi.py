"""The parser of the AsyncAPI Initiative reads `/asyncapi.json` without errors and warnings."""

from __future__ import annotations

import json
import subprocess
from typing import Any

from msgspec.structs import replace

from rosld.adapters.base import AdapterOptions
from rosld.adapters.registry import adapter_for
from tests.interop.javascript.node import node
from tests.server.robots.made_up import MadeUp, served

PATIENCE = 200.0


def read(url: str) -> dict[str, Any]:
    """Return what the parser reads of a description."""
    done = subprocess.run(node("asyncapi.mjs", url), capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_the_description_of_a_robot_is_valid() -> None:
    with served(adapter_for("rover", AdapterOptions())) as http:
        found = read(f"{http.base_url}/asyncapi.json")
    assert found["problems"] == []
    assert found["version"]
    assert found["servers"] == ["http", "ws"]
    assert ["send", "/topics/odom"] in found["operations"]
    assert ["receive", "/topics/cmd_vel"] in found["operations"]


def test_the_binding_of_ros_2_is_valid() -> None:
    robot = MadeUp()
    robot.capabilities = replace(robot.capabilities, system="ROS 2")
    robot.topic("/odom", "geometry_msgs/msg/Twist")
    with served(robot) as http:
        found = read(f"{http.base_url}/asyncapi.json")
    assert found["problems"] == []
    assert found["servers"] == ["http", "ws", "ros2"]
    assert ["receive", "/odom"] in found["operations"]
