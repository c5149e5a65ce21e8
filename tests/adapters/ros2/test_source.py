"""Sources of ROS 2, and the message if rclpy is missing."""

from __future__ import annotations

import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.adapters.base import AdapterOptions
from rosld.adapters.ros2 import adapter
from rosld.adapters.ros2.adapter import Source, read_source


def test_a_source_names_a_domain_and_a_namespace_and_nonsense_is_told_in_a_sentence_that_names_it() -> None:
    for text, source in {
        "ros2": Source(),
        "ros2:": Source(),
        "ros2:?domain=0": Source(0),
        "ros2:?domain=232&namespace=/robot1": Source(232, "/robot1"),
        "ros2:?namespace=%2Ffleet%2Frobot_1": Source(None, "/fleet/robot_1"),
        "ros2:?namespace=/": Source(),
    }.items():
        assert read_source(text) == source
    for text, named in {
        "ros2:42": "ros2:42",
        "ros2://host:11311": "host:11311",
        "ros2:?domain=233": "233",
        "ros2:?domain=-1": "-1",
        "ros2:?domain=٤٢": "٤٢",
        "ros2:?domain=": "domain",
        "ros2:?domain": "ros2:?domain",
        "ros2:?domain=1&domain=2": "twice",
        "ros2:?domian=1": "domian",
        "ros2:?namespace=robot1": "robot1",
        "ros2:?namespace=/robot-1": "/robot-1",
        "ros2:?namespace=/a//b": "/a//b",
        "ros2:?namespace=/a__b": "/a__b",
    }.items():
        with pytest.raises(ValueError, match=r".{10,}") as caught:
            read_source(text)
        assert named in str(caught.value)


@given(st.text(max_size=40))
def test_whatever_follows_the_scheme_is_a_source_or_an_error_for_the_user(rest: str) -> None:
    try:
        source = read_source(f"ros2:{rest}")
    except ValueError:
        return
    assert source.domain is None or 0 <= source.domain <= 232


def test_without_rclpy_it_is_said_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rclpy", None)
    monkeypatch.delitem(sys.modules, "rclpy.node", raising=False)
    with pytest.raises(ValueError, match="source") as caught:
        adapter("ros2:", AdapterOptions())
    for word in ("/opt/ros/jazzy/setup.bash", "--system-site-packages", "pip install 'rosld[ros2-jazzy]'"):
        assert word in str(caught.value)
