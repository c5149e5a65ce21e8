"""The rospy rover itself: its parameters of dynamic_reconfigure, set with ROS 1's own tool."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.adapters.ros1 import system as ros1
from tests.adapters.ros1.system import RosSystem
from tests.rover.rovers import NODES


@pytest.fixture(scope="module")
def system(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RosSystem]:
    """A rosmaster with the rover, and nothing of rosld."""
    folder: Path = tmp_path_factory.mktemp("rospy")
    with ros1.running(folder) as found:
        ros1.require("the rover", "numpy", "diagnostic_msgs", "dynamic_reconfigure")
        found.start([ros1.PYTHON, str(NODES / "rospy_rover.py")]).line("ready")
        yield found


def reconfigured(system: RosSystem, kind: str, name: str, value: object) -> dict[str, object]:
    """What the node made of a parameter that it was asked to set: all that it has of this kind."""
    asked = f"config: {{{kind}: [{{name: {name}, value: {value}}}]}}"
    told = system.yaml(system.run("/usr/bin/rosservice", "call", "/rover/set_parameters", asked))
    return {each["name"]: each["value"] for each in told["config"][kind]}


def test_a_parameter_takes_the_value_within_its_range(system: RosSystem) -> None:
    assert reconfigured(system, "doubles", "max_speed", 0.3)["max_speed"] == 0.3
    assert reconfigured(system, "doubles", "max_speed", 7.0)["max_speed"] == 1.0
    assert reconfigured(system, "ints", "scan_rate", 0)["scan_rate"] == 1
    assert system.master.getParam("/test", "/rover/max_speed")[2] == 1.0


def test_a_value_that_is_none_of_the_enumeration_changes_nothing(system: RosSystem) -> None:
    assert reconfigured(system, "strs", "drive_mode", "sport")["drive_mode"] == "sport"
    assert reconfigured(system, "strs", "drive_mode", "warp")["drive_mode"] == "sport"


def test_the_descriptions_tell_ranges_and_the_values_of_the_enumeration(system: RosSystem) -> None:
    told = system.echo("/rover/parameter_descriptions")
    described = {each["name"]: each for each in told["groups"][0]["parameters"]}
    assert described["max_speed"]["description"] == "The fastest that the rover drives, in m/s."
    assert "'value': 'eco'" in described["drive_mode"]["edit_method"]
    assert {each["name"]: each["value"] for each in told["max"]["doubles"]}["max_speed"] == 1.0
    assert {each["name"]: each["value"] for each in told["min"]["ints"]}["scan_rate"] == 1
    assert "wheel_separation" not in described
