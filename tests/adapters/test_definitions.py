"""The definitions shipped with rosld: all can be read, and hash to what ROS's own generator says."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from rosld.adapters.model import TypeRef
from rosld.adapters.model.library import SHIPPED, TypeLibrary

NAMES = sorted(f"{path.parts[-3]}/{path.parts[-2]}/{path.stem}" for path in SHIPPED.glob("*/*/*"))

PUBLISHED = {
    "ackermann_msgs/msg/AckermannDrive": "3512e91b48d69674a0e86fadf1ea8231",
    "ackermann_msgs/msg/AckermannDriveStamped": "1fd5d7f58889cefd44d29f6653240d0c",
    "actionlib_tutorials/msg/FibonacciAction": "f59df5767bf7634684781c92598b2406",
    "control_msgs/msg/FollowJointTrajectoryAction": "bc4f9b743838566551c0390c65f1a248",
    "control_msgs/msg/GripperCommandAction": "950b2a6ebe831f5d4f4ceaba3d8be01e",
    "control_msgs/srv/QueryTrajectoryState": "ec93cdecbd8062d761aa52b7c90cd44b",
    "diagnostic_msgs/srv/AddDiagnostics": "e6ac9bbde83d0d3186523c3687aecaee",
    "dynamic_reconfigure/srv/Reconfigure": "bb125d226a21982a4a98760418dc2672",
    "map_msgs/srv/GetMapROI": "81aa75ecf00f4571a9be0d9dc6dea512",
    "nodelet/srv/NodeletLoad": "8cfbf33bf3fbd4c54a833f6e2b105331",
    "roslib/msg/Header": "2176decaecbce78abc3b96ef049fabed",
    "tf/msg/tfMessage": "94810edda583a504dfda3829e70d7eec",
    "topic_tools/srv/MuxSelect": "053052240ca985e1f2eedbb0dae9b1f7",
    "turtlesim/msg/Color": "353891e354491c51aabe32df673fb446",
    "turtlesim/msg/Pose": "863b248d5016ca62ea2e895ae5265cf9",
    "turtlesim/srv/Spawn": "0b2d2e872a8e2887d5ed626f2bf2c561",
}
"""MD5s as seen in recordings and headers of packages that Debian does not have."""

SAYS = """
import importlib, json, sys
found = {}
for name in json.load(sys.stdin):
    package, kind, short = name.split("/")
    try:
        found[name] = getattr(importlib.import_module(package + "." + kind), short)._md5sum
    except (ImportError, AttributeError):
        pass
print(json.dumps(found))
"""


def hash_of(name: str) -> str | None:
    return TypeLibrary(ros_version=2 if name.startswith("action_msgs/") else 1).find(TypeRef(name)).ref.hash


def test_every_shipped_definition_is_read_and_has_its_published_md5() -> None:
    hashes = {name: hash_of(name) for name in NAMES}
    assert all(hashes.values())
    assert hashes.items() >= PUBLISHED.items()


@pytest.mark.slow
def test_shipped_definitions_have_the_md5_that_genpy_says() -> None:
    if not Path("/usr/bin/rosmaster").exists():
        pytest.skip("no ROS 1 here: install the packages of tests/debian-ros.txt")
    said = subprocess.run(
        ["/usr/bin/python3", "-c", SAYS], input=json.dumps(NAMES), capture_output=True, text=True, check=True
    )
    expected = json.loads(said.stdout)
    assert len(expected) >= 20
    assert {name: hash_of(name) for name in expected} == expected
