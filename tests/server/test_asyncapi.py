"""`/asyncapi.json`: channels for values and topics, operations as `Allow` says, and nothing that may not be read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from msgspec.structs import replace

from rosld.adapters.base import AdapterOptions
from rosld.adapters.registry import adapter_for
from rosld.server.openapi.description import references
from tests.server.auth.conftest import rule, token, tokens
from tests.server.robots.made_up import MadeUp, served


def operations(document: dict[str, Any]) -> set[tuple[str, str]]:
    """Return the action and the address of every operation."""
    channels = document["channels"]
    return {
        (each["action"], channels[each["channel"]["$ref"].rpartition("/")[2]]["address"])
        for each in document["operations"].values()
    }


def test_values_are_channels_with_the_operations_that_are_allowed() -> None:
    with served(adapter_for("rover", AdapterOptions())) as http:
        answer = http.get("/asyncapi.json")
        assert answer.headers["content-type"] == "application/json"
        found = answer.json()
        assert 'asyncapi.json>; rel="service-desc"' in http.get("/").headers["link"]
        assert http.get("/asyncapi.json", headers={"If-None-Match": answer.headers["etag"]}).status_code == 304
        assert http.get("/asyncapi.json", headers={"Accept": "text/turtle"}).status_code == 406
        typed = http.get("/asyncapi.json", headers={"Accept": "application/vnd.aai.asyncapi+json"})
        assert typed.headers["content-type"] == "application/vnd.aai.asyncapi+json"
        told = operations(found)
        for path in ("/topics/odom", "/topics/cmd_vel"):
            allowed = http.get(path).headers["allow"].split(", ")
            assert {action for action, address in told if address == path} == {"send"} | (
                {"receive"} if "PUT" in allowed else set()
            )
    assert ("receive", "/topics/cmd_vel") in told
    assert ("send", "/channels/WebSocketChannel2023/{token}/messages") in told
    assert {each["protocol"] for each in found["servers"].values()} == {"http", "ws"}
    components = found["components"]
    assert {name for _, name in references(found["channels"], components)} == set(components["schemas"])


def test_topics_of_ros_2_are_channels_with_its_binding() -> None:
    robot = MadeUp()
    robot.capabilities = replace(robot.capabilities, system="ROS 2")
    robot.topic("/odom", "geometry_msgs/msg/Twist")
    with served(robot) as http:
        found = http.get("/asyncapi.json").json()
    (name,) = (name for name, each in found["channels"].items() if each["address"] == "/odom")
    assert found["channels"][name]["servers"] == [{"$ref": "#/servers/ros2"}]
    binding = found["operations"][f"receive_{name}"]["bindings"]["ros2"]
    assert binding == {"role": "subscriber", "node": robot.graph.own_node}


def test_what_an_agent_may_not_read_has_no_channel(tmp_path: Path) -> None:
    file = tmp_path / "auth.toml"
    rules = rule("reader", "read", "/asyncapi.json", "/topics/odom") + rule("admin", "read write control", "/**")
    file.write_text(tokens("reader", "admin") + rules, "utf-8")
    with served(adapter_for("rover", AdapterOptions()), auth=file) as http:
        whole, part = (
            http.get("/asyncapi.json", headers={"Authorization": f"Bearer {token(agent)}"}).json()
            for agent in ("admin", "reader")
        )
        assert http.get("/asyncapi.json").status_code == 401
    assert operations(part) == {("send", "/topics/odom")}
    assert operations(part) < operations(whole)
    assert set(part["components"]["schemas"]) == {"nav_msgs.msg.Odometry"}
    assert part["servers"]["http"]["security"]
