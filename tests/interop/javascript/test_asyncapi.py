"""The parser of the AsyncAPI Initiative reads `/asyncapi.json` without errors and warnings."""

from __future__ import annotations

import dataclasses
import json
import subprocess
from typing import Any

from msgspec.structs import replace

from rosld.adapters.base import AdapterOptions
from rosld.adapters.model import Graph, Qos, freeze
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
        found = read(f"{http.base_url}asyncapi.json")
    assert found["problems"] == []
    assert found["version"]
    assert found["servers"] == ["http", "ws"]
    assert ["send", "/topics/odom"] in found["operations"]
    assert ["receive", "/topics/cmd_vel"] in found["operations"]


class Profiled(MadeUp):
    """A robot whose publishers have a quality of service."""

    def _announce(self, graph: Graph) -> None:
        qos = Qos("reliable", "transient_local", "keep_last", 5, liveliness="automatic")
        topics = {}
        for name, each in graph.topics.items():
            publishers = tuple(dataclasses.replace(one, qos=qos) for one in each.publishers)
            topics[name] = dataclasses.replace(each, publishers=publishers)
        super()._announce(dataclasses.replace(graph, topics=freeze(topics)))


def test_the_binding_of_ros_2_is_valid() -> None:
    robot = Profiled()
    robot.capabilities = replace(robot.capabilities, system="ROS 2")
    robot.topic("/odom", "geometry_msgs/msg/Twist")
    with served(robot) as http:
        assert '"transient_local"' in http.get("/asyncapi.json").text
        found = read(f"{http.base_url}asyncapi.json")
    assert found["problems"] == []
    assert found["servers"] == ["http", "ws", "ros2"]
    assert ["receive", "/odom"] in found["operations"]
