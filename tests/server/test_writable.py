"""Writable topics: not those of ROS itself, of the robot's nodes, or without subscribers."""

from __future__ import annotations

import pytest

from rosld.server.robot.write_policy import RESERVED
from tests.server.robots.asking import detail
from tests.server.robots.made_up import MadeUp, Serving

STRING = "std_msgs/msg/String"


def reserved(robot: MadeUp) -> None:
    """Topics with ROS's names and a subscriber, and one other topic."""
    for name in (*RESERVED, "/display"):
        robot.topic(name, STRING, {"data": "of the robot"}, published=False, heard=True)


def test_a_glob_does_not_open_a_topic_of_ros_itself(robot: MadeUp, serving: Serving) -> None:
    reserved(robot)
    for globs in (("*",), tuple(f"{name[:-1]}?" for name in RESERVED), ("/[!d]*",)):
        http = serving(allow_publish=globs)
        for name in RESERVED:
            refused = http.put(f"/topics{name}", json={"data": "x"})
            assert f"--allow-publish {name}" in detail(refused, 405)
            assert "PUT" not in refused.headers["allow"]
        assert robot.sent.keys() <= {"/display"}
        assert http.put("/topics/display", json={"data": "x"}).status_code == 204


def test_the_exact_name_opens_a_topic_of_ros_itself_and_no_other(robot: MadeUp, serving: Serving) -> None:
    reserved(robot)
    http = serving(allow_publish=("/tf",))
    for name in RESERVED:
        assert http.put(f"/topics{name}", json={"data": "x"}).status_code == (204 if name == "/tf" else 405)
    assert robot.sent == {"/tf": [{"data": "x"}]}


def test_a_glob_does_not_open_the_topics_of_an_action(robot: MadeUp, serving: Serving) -> None:
    parts = ("goal", "cancel", "status", "feedback", "result")
    for part in parts:
        robot.topic(f"/fly/{part}", STRING, published=False, heard=True)
    http = serving(allow_publish=("*",))
    for part in parts:
        assert f"--allow-publish /fly/{part}" in detail(http.put(f"/topics/fly/{part}", json={"data": "x"}), 405)
    assert robot.sent == {}


@pytest.mark.slow
def test_a_topic_without_a_subscriber_is_written_only_where_that_is_allowed(robot: MadeUp, serving: Serving) -> None:
    """It is visible although no node publishes it, as with a ROS master that knows its type."""
    robot.topic("/unheard", STRING, published=False, heard=False)
    http = serving()
    refused = http.put("/topics/unheard", json={"data": "x"})
    assert "No node subscribes to /unheard" in detail(refused, 405)
    assert "PUT" not in refused.headers["allow"]
    assert robot.sent == {}
    for glob in ("/unheard", "/unh*"):
        answer = serving(allow_publish=(glob,)).put("/topics/unheard", json={"data": "x"})
        assert "no subscriber" in detail(answer, 202)
    as_resource = serving(allow_publish=("/unheard",)).put("/resources/unheard", json="y")
    assert "/unheard had no subscriber" in detail(as_resource, 202)
    assert robot.sent == {"/unheard": [{"data": "x"}, {"data": "x"}, {"data": "y"}]}


def test_a_topic_of_the_robot_is_opened_by_a_glob_that_fits_whole(robot: MadeUp, serving: Serving) -> None:
    for name in ("/arm/speed", "/arm/speed_limit"):
        robot.topic(name, STRING, {"data": "x"}, published=True, heard=True)
    http = serving(allow_publish=("/*/speed",))
    assert http.put("/topics/arm/speed", json={"data": "y"}).status_code == 204
    assert "is published by /robot" in detail(http.put("/topics/arm/speed_limit", json={"data": "y"}), 405)
    assert robot.sent == {"/arm/speed": [{"data": "y"}]}
