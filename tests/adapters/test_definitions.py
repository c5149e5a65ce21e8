"""Definitions shipped with rosld, hashes of types, and types that ROS 2 derives."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from rosld.adapters.model import ActionSchema, MessageSchema, ServiceSchema, TypeRef, UnknownType
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
"""MD5 sums from recordings and headers of packages that Debian lacks."""

ROS2_ONLY = ("action_msgs/", "lifecycle_msgs/", "rcl_interfaces/", "type_description_interfaces/")

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
    return TypeLibrary(ros_version=2 if name.startswith(ROS2_ONLY) else 1).find(TypeRef(name)).ref.hash


@pytest.mark.slow
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


FLY = "rosld_aircraft/action/Fly"
HASHES = {
    "std_msgs/msg/String": "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    "std_srvs/srv/SetBool": "abe9e4bb6b41b40e6789712c00ec8871923e089af3f667a79992a428cff2da0a",
    f"{FLY}_FeedbackMessage": "d18a3556a261de15d29e8ccd38eded71e72e111a0e2783639ac60888e1ac2db8",
    f"{FLY}_SendGoal_Request": "f37b07c532f46ff9d99339e187247a7af5a90170f68df20abb5283c98e2bf661",
    f"{FLY}_SendGoal_Response": "5b33199b9de335324844a52d16e750707da311834db70ab831ade06cbfb830a0",
    f"{FLY}_GetResult_Request": "ab4141fe40eb4c4f0299a60e6e902473852ad1969cc4f3c07015f607e9358415",
    f"{FLY}_GetResult_Response": "a6b6c16144dbcfca39245f4d18b12c97c679550f4d7bfc13b26da3e1c15aab2d",
    "std_srvs/srv/Trigger_Request": "d010825374ce8918e72bfd826c82603e60f45419e932ea976f807b74a863a199",
    "std_srvs/srv/Trigger_Response": "2d946c21e2fc3f1e9ca6986a8191d85fcc70097a8bb7771a053564bc47009cdf",
}
"""As shipped with ROS 2 and, for derived types, as reported by the endpoints of a node of Jazzy."""


@pytest.fixture(scope="module")
def library() -> TypeLibrary:
    return TypeLibrary(ros_version=2)


def test_a_type_has_the_hash_that_ros_2_gives_it(library: TypeLibrary) -> None:
    for name, hash in HASHES.items():
        wanted = TypeRef(name, f"RIHS01_{hash}")
        assert library.find(wanted).ref == library.find(TypeRef(name)).ref == wanted
    with pytest.raises(UnknownType, match="SetBool"):
        library.find(TypeRef("std_srvs/srv/SetBool", "RIHS01_" + "0" * 64))


def test_what_is_derived_is_a_message_or_a_service(library: TypeLibrary) -> None:
    kinds = {
        FLY: ActionSchema,
        f"{FLY}_SendGoal": ServiceSchema,
        f"{FLY}_GetResult": ServiceSchema,
        f"{FLY}_GetResult_Event": MessageSchema,
        f"{FLY}_Result": MessageSchema,
        "action_msgs/srv/CancelGoal": ServiceSchema,
        "action_msgs/srv/CancelGoal_Event": MessageSchema,
    }
    assert {name: type(library.find(TypeRef(name))) for name in kinds} == kinds
    for name in ("odd/action/Walk_FeedbackMessage", "odd/srv/Ask_Event", "odd/action/Walk_SendGoal"):
        with pytest.raises(UnknownType, match=r"needs odd/(action/Walk|srv/Ask)_"):
            library.find(TypeRef(name))


def test_ros_1_derives_nothing(tmp_path: Path) -> None:
    folder = tmp_path / "diary" / "srv"
    folder.mkdir(parents=True)
    (folder / "New_Event.srv").write_text("string what\n---\n")
    assert isinstance(TypeLibrary(ros_version=1, folders=[folder]).find(TypeRef("diary/srv/New_Event")), ServiceSchema)
    with pytest.raises(UnknownType):
        TypeLibrary(ros_version=1).find(TypeRef("std_srvs/srv/Trigger_Event"))
