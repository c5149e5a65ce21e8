"""Keys of rmw_zenoh as pamoja, a library for gateways of ROS 2, makes them."""

from __future__ import annotations

import importlib.util

import pytest

from rosld.adapters.model import TypeRef
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.ros2.zenoh_keys import data_key, dds_type, ros_type
from tests.interop.missing import missing


@pytest.mark.parametrize(
    ("name", "type"), [("/chatter", "std_msgs/msg/String"), ("/robot1/lamp/switch", "std_srvs/srv/SetBool")]
)
def test_keys_and_names_of_types_are_those_of_pamoja(name: str, type: str) -> None:
    if importlib.util.find_spec("pamoja") is None:
        missing("there is no pamoja-ros2: pip install '.[interop]'")
    from pamoja import ros2

    hash = TypeLibrary(ros_version=2).find(TypeRef(type)).ref.hash
    assert hash is not None
    assert data_key(42, name, type, hash) == ros2.entity_key(42, name, type, hash)
    assert dds_type(type) == ros2.dds_type_name(type)
    assert ros_type(ros2.dds_type_name(type)) == type
