"""Types fetched from the robot: their nested types are known as well, and ROS 2's descriptions are parsed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import pytest

from rosld.adapters.model import ActionSchema, Array, MessageSchema, Primitive, ServiceSchema, TypeRef, UnknownType
from rosld.adapters.model.library import SEPARATOR, TypeLibrary
from rosld.adapters.model.rihs import describe_type  # the same structure, which determines the hash
from rosld.adapters.model.schema import DUMMY
from rosld.adapters.ros2.types import definition_of

GRIP = f"""Tip left
Tip right
{SEPARATOR}
MSG: gripper_own/Tip
# where it touches
std_msgs/Header header
float64 force
{SEPARATOR}
MSG: std_msgs/Header
string frame_id
"""


def test_a_type_that_is_nested_in_one_that_was_learnt_is_known_itself() -> None:
    library = TypeLibrary(ros_version=1)
    with pytest.raises(UnknownType):
        library.find(TypeRef("gripper_own/msg/Tip"))
    grip = library.learn_message("gripper_own/msg/Grip", GRIP)
    tip = library.find(TypeRef("gripper_own/msg/Tip"))
    assert isinstance(tip, MessageSchema)
    assert tip.types == {name: grip.types[name] for name in ("gripper_own/msg/Tip", "std_msgs/msg/Header")}
    assert "# where it touches" in tip.definition
    assert library.find(tip.ref) is tip


def test_a_nested_type_is_the_robots_own_and_not_the_one_that_ships_under_its_name() -> None:
    library = TypeLibrary(ros_version=1)
    shipped = TypeLibrary(ros_version=1).find(TypeRef("std_msgs/msg/Header"))
    library.learn_message("gripper_own/msg/Grip", GRIP)
    found = library.find(TypeRef("std_msgs/msg/Header"))
    assert isinstance(found, MessageSchema)
    assert [each.name for each in found.type.fields] == ["frame_id"]
    assert library.find(shipped.ref).ref == shipped.ref


def test_a_nested_type_that_ships_keeps_its_constants_and_comments() -> None:
    library = TypeLibrary(ros_version=2)
    known = TypeLibrary(ros_version=2).find(TypeRef("diagnostic_msgs/msg/DiagnosticStatus"))
    assert isinstance(known, MessageSchema)
    status = [*described(known), Described("made_up/msg/Doubt", [Field("status", FieldType(1, 0, 0, known.ref.name))])]
    library.learn_message("made_up/msg/Doubt", definition_of("made_up/msg/Doubt", status))
    found = library.find(TypeRef("diagnostic_msgs/msg/DiagnosticStatus"))
    assert isinstance(found, MessageSchema)
    assert found.ref == known.ref
    assert found.type.constants == known.type.constants != ()


# Descriptions


@dataclass
class FieldType:
    type_id: int
    capacity: int = 0
    string_capacity: int = 0
    nested_type_name: str = ""


@dataclass
class Field:
    name: str
    type: FieldType
    default_value: str = ""


@dataclass
class Described:
    type_name: str
    fields: list[Field] = field(default_factory=list)


def described(schema: MessageSchema) -> Iterator[Described]:
    """Yield a schema as a node would describe it."""
    for kind in schema.types.values():
        told = describe_type(kind)
        fields = [Field(each["name"], FieldType(**each["type"])) for each in told["fields"]]  # type: ignore[attr-defined]
        yield Described(kind.name, fields)


TYPES = [
    "geometry_msgs/msg/PoseStamped",
    "sensor_msgs/msg/PointCloud2",
    "std_msgs/msg/Empty",
    "std_srvs/srv/SetBool",
    "nav_msgs/srv/GetPlan",
    "rosld_aircraft/action/Fly",
]


def test_a_description_without_sources_gives_the_type_with_its_hash() -> None:
    for name in TYPES:
        known: Any = TypeLibrary(ros_version=2).find(TypeRef(name))
        parts = {
            ServiceSchema: lambda of: [of.request, of.response],
            ActionSchema: lambda of: [of.goal, of.result, of.feedback],
        }.get(type(known), lambda of: [of])(known)
        told = [each for part in parts for each in described(part)]
        library = TypeLibrary(ros_version=2)
        learn: Any = {"msg": library.learn_message, "srv": library.learn_service, "action": library.learn_action}
        assert learn[name.split("/")[1]](name, definition_of(name, told), known.ref.hash).ref == known.ref


def test_every_kind_of_field_is_read_from_a_description() -> None:
    text = "string<=3 a\nstring[] b\nuint8[4] c\nint64[<=5] d\nstring<=6[<=7] e\nbool f\nbyte g\nfloat32[2] h"
    known = TypeLibrary(ros_version=2).learn_message("made_up/msg/All", text)
    found = TypeLibrary(ros_version=2).learn_message(
        "made_up/msg/All", definition_of("made_up/msg/All", described(known)), known.ref.hash
    )
    assert found.type == known.type
    assert found.type.fields[4].type == Array(Primitive("string", 6), bound=7)


def test_a_description_that_cannot_be_a_definition_is_refused() -> None:
    lacking = FieldType(1, nested_type_name="made_up/msg/Lacking")
    for told in (
        [],
        *([Described("made_up/msg/All", [Field("a", type)])] for type in (lacking, FieldType(12), FieldType(255))),
    ):
        with pytest.raises(ValueError, match=r"description of|field type id|no name in a"):
            definition_of("made_up/msg/All", told)
    empty = Described("std_msgs/msg/Empty", [Field(DUMMY, FieldType(3))])
    assert definition_of("std_msgs/msg/Empty", [empty]), "its member is not shown"
