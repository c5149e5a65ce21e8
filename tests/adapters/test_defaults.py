"""Default values of fields in ROS 2 definitions: parsed as by ROS 2's own parser."""

from __future__ import annotations

import json
import subprocess
from typing import Any

import pytest

from rosld.adapters.model import MessageSchema, TypeRef
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.ros2.types import definition_of
from tests.adapters.test_learnt_types import Described, Field, FieldType
from tests.ros2 import distros

QUATERNION = "geometry_msgs/msg/Quaternion"
DEFINITION = r"""# Everything that has a default, and what has none.
bool yes true
bool no 0
byte octet 200
char letter 65
int8 least -128
uint8 tool 3 # a comment is no part of it
int16 hex 0x1F
int64 far -9223372036854775808
uint64 farther 18446744073709551615
float32 half .5
float64	tabs	1e-3
float64 whole 2
string bare hello world
string double "say \"hi\" to 'her'"
string single 'it\'s'
string empty ""
string cut a#b
string<=8 short "up to 8"
int32 none
string CONSTANT="is none"
int32 ANOTHER=5
bool[2] flags [true, False]
int32[] some [1, -2 ,3]
int32[] nothing []
float64[3] three [0.0, 1.5, 2]
uint8[<=4] octets [1, 2]
string[] words ["a", 'b, c', "d\"e"]
string[2] bare_words [left, right]
float64[9] zeros
"""
WITHOUT = (
    "int8 x 128",
    "uint8 x -1",
    "int32 x many",
    "bool x yes",
    "string<=2 x abc",
    "int32[2] x [1]",
    "int32[<=1] x [1, 2]",
    "int32[] x 1",
    "string[] x [, a]",
    "int32 x " + "9" * 101,
    "std_msgs/Header x 5",
    "std_msgs/Header[] x []",
)
"""Fields that ROS 2 refuses to build."""
_PARSED_BY_ROS = """
import json, sys
from rosidl_adapter.parser import parse_message_string
fields = parse_message_string("made_up", "Thing", sys.stdin.read()).fields
json.dump({field.name: field.default_value for field in fields}, sys.stdout)
"""


def learnt(definition: str, version: Any = 2, name: str = "made_up/msg/Thing") -> MessageSchema:
    return TypeLibrary(ros_version=version).learn_message(name, definition)


def defaults(schema: MessageSchema) -> dict[str, object]:
    """Return the defaults of a message's fields, arrays as lists."""
    return {
        one.name: list(one.default) if isinstance(one.default, tuple) else one.default for one in schema.type.fields
    }


@pytest.mark.slow
@pytest.mark.ros2
def test_defaults_are_those_that_ros_reads() -> None:
    command = [distros.require("kilted").python, "-c", _PARSED_BY_ROS]
    done = subprocess.run(
        command, input=DEFINITION, env=distros.environment(0), capture_output=True, text=True, check=True
    )
    assert defaults(learnt(DEFINITION)) == json.loads(done.stdout)


def test_a_default_that_ros_would_refuse_is_none_and_its_field_is_read_all_the_same() -> None:
    for line in WITHOUT:
        assert defaults(learnt(f"{line}\nint32 other 7")) == {"x": None, "other": 7}
    assert learnt("int32 x 5").ref == learnt("int32 x").ref, "defaults are in no hash"


def test_a_quaternion_turns_nothing_unless_it_says_so() -> None:
    for version in (1, 2):
        found = TypeLibrary(ros_version=version).find(TypeRef(QUATERNION))  # type: ignore[arg-type]
        assert isinstance(found, MessageSchema)
        assert defaults(found)["w"] == 1
    assert defaults(learnt("float64 x\nfloat64 y\nfloat64 z\nfloat64 w"))["w"] is None
    assert defaults(learnt("float64 x\nfloat64 w 0.5", name=QUATERNION)) == {"x": None, "w": 0.5}


def test_defaults_are_read_from_a_description_too() -> None:
    fields = [
        Field("yes", FieldType(15), "True"),
        Field("speed", FieldType(11), "1.5"),
        Field("words", FieldType(17), 'say "hi"'),
        Field("lines", FieldType(17), "a\nb"),
        Field("three", FieldType(6 + 48, 3), "(1, 2, 3)"),
        Field("one", FieldType(6 + 144), "(4,)"),
        Field("names", FieldType(17 + 144), "('a', 'b, c')"),
        Field("pose", FieldType(1, nested_type_name="made_up/msg/Other"), ""),
        Field("plain", FieldType(6), ""),
    ]
    described = [Described("made_up/msg/Thing", fields), Described("made_up/msg/Other", [Field("x", FieldType(6))])]
    assert defaults(learnt(definition_of("made_up/msg/Thing", described))) == {
        "yes": True,
        "speed": 1.5,
        "words": 'say "hi"',
        "lines": None,
        "three": [1, 2, 3],
        "one": [4],
        "names": ["a", "b, c"],
        "pose": None,
        "plain": None,
    }
