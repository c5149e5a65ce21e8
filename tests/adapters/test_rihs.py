"""The hashes of ROS 2's types, as ROS 2 computes them."""

from __future__ import annotations

import pytest

from rosld.adapters.model import TypeRef, UnknownType
from rosld.adapters.model.library import TypeLibrary

KNOWN = {
    "std_msgs/msg/String": "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    "std_srvs/srv/SetBool": "abe9e4bb6b41b40e6789712c00ec8871923e089af3f667a79992a428cff2da0a",
    "std_srvs/srv/SetBool_Request": "c62fbb99d94e1b25e8ef9e109f9581956bb1b3361a45a4e5810c36a90d29932e",
    "std_srvs/srv/SetBool_Response": "d0814e7f7b4880ab77e9c57426c7aa1562ab69f11eef8e2e968812f9cbd0b059",
}


@pytest.mark.parametrize("name", KNOWN)
def test_a_type_has_the_hash_that_ros_2_ships_with_it(name: str) -> None:
    found = TypeLibrary(ros_version=2).find(TypeRef(name))
    assert found.ref == TypeRef(name, f"RIHS01_{KNOWN[name]}")


def test_a_type_under_another_hash_is_not_taken_for_it() -> None:
    with pytest.raises(UnknownType, match="SetBool"):
        TypeLibrary(ros_version=2).find(TypeRef("std_srvs/srv/SetBool", "RIHS01_" + "0" * 64))
