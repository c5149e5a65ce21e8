"""Values: a property's value in RDF and in plain JSON, and equality of values."""

from __future__ import annotations

import math

import pytest
from msgspec.structs import replace
from pyoxigraph import Literal, NamedNode

from rosld.adapters.model import MessageSchema
from rosld.adapters.model.library import TypeLibrary
from rosld.ontology.lower import lowerer
from rosld.ontology.vocab import xsd
from rosld.server.hypermedia.value import (
    MessageValue,
    Reading,
    StoredValue,
    field_json,
    refusal_text,
    value_literal,
    version_key,
)
from tests.server.html.messages import schema as known

T = "http://127.0.0.1:8080/topics/robot/thing"


def schema_of(definition: str, name: str = "made_up/msg/Thing") -> MessageSchema:
    return TypeLibrary(ros_version=1).learn_message(name, definition)


def value_of(schema: MessageSchema, value: object, *names: str) -> MessageValue:
    """Return the message of a JSON value; with names, only these fields are the value."""
    fields = tuple(field for field in schema.type.fields if not names or field.name in names)
    return MessageValue(schema, lowerer(schema).from_json(value, defaults=True), fields, T)


def scalar(kind: str, value: object) -> MessageValue:
    schema = schema_of(f"{kind} data")
    message = schema.codec.build(schema.ref.name, {"data": value})
    return MessageValue(schema, message, schema.type.fields, T)


def typed(lexical: str, datatype: str) -> Literal:
    return Literal(lexical, datatype=NamedNode(xsd.iri + datatype))


POSE = {"position": {"x": 1.25, "y": -2, "z": 0}, "orientation": {"w": 1}}


def test_a_field_or_an_element_is_selected_by_its_path() -> None:
    pose = value_of(known("geometry_msgs/msg/PoseStamped"), {"pose": POSE})
    scan = value_of(known("sensor_msgs/msg/LaserScan"), {"ranges": [0.1, "NaN", 3]})
    stored = StoredValue({"limits": {"speed": 4.5}, "names": ["a", "b"]})
    tree = value_of(known("tf2_msgs/msg/TFMessage"), {"transforms": [{"child_frame_id": "base"}]})
    selected: list[tuple[MessageValue | StoredValue, str, Literal, bytes]] = [
        (pose, "pose.position.x", typed("1.25", "double"), b"1.25"),
        (pose, "pose.orientation.w", typed("1.0", "double"), b"1.0"),
        (scan, "ranges.0", typed("0.1", "float"), b"0.1"),
        (scan, "ranges.1", typed("NaN", "float"), b'"NaN"'),
        (tree, "transforms.0.child_frame_id", Literal("base"), b'"base"'),
        (stored, "limits.speed", typed("4.5", "double"), b"4.5"),
        (stored, "names.1", Literal("b"), b'"b"'),
    ]
    for value, path, literal, text in selected:
        assert (value_literal(value, path), field_json(value, path)) == (literal, text)


def test_a_path_to_no_scalar_is_an_error() -> None:
    pose = value_of(known("geometry_msgs/msg/PoseStamped"), {"pose": POSE})
    scan = value_of(known("sensor_msgs/msg/LaserScan"), {"ranges": [0.1]})
    stored = StoredValue({"limits": {"speed": 4.5}, "names": ["a", "b"]})
    wrong: dict[MessageValue | StoredValue, tuple[str, tuple[str, ...]]] = {
        pose: ("geometry_msgs/msg/PoseStamped", ("", "nothing", "pose.nothing", "pose.position.x.y", "pose", "pose.0")),
        scan: ("has no field", ("ranges.1", "ranges.-1", "ranges.99999999999999999999")),
        stored: ("", ("limits", "names", "names.2", "other")),
    }
    for value, (words, paths) in wrong.items():
        for path in paths:
            for select in (value_literal, field_json):
                with pytest.raises(ValueError, match=words or path):
                    select(value, path)


def test_a_response_refuses_with_bool_success_false_unless_that_is_its_value() -> None:
    responses: list[tuple[str, object, str | None]] = [
        ("bool success\nstring message", {"success": False, "message": "too fast"}, "too fast"),
        ("bool success\nstring status_message", {"success": False, "status_message": "no"}, "no"),
        ("bool success", {"success": False}, ""),
        ("bool success\nstring message", {"success": True, "message": "fine"}, None),
        ("string success", {"success": ""}, None),
        ("float64 data", {}, None),
    ]
    for definition, value, words in responses:
        schema = schema_of(definition)
        assert refusal_text(schema, lowerer(schema).from_json(value, defaults=True)) == words
    schema = schema_of("bool success")
    assert refusal_text(schema, lowerer(schema).from_json({"success": False}), schema.type.fields) is None


def reading(value: MessageValue | StoredValue | None, failure: str | None = None, at: int = 1) -> Reading:
    return Reading("/robot/thing", value, failure, at, float(at))


def test_tokens_differ_with_the_value_and_the_failure_and_not_with_the_time() -> None:
    vector = known("geometry_msgs/msg/Vector3")
    readings = [
        reading(scalar("float64", 1.0)),
        reading(scalar("float64", -0.0)),
        reading(scalar("float64", 0.0)),
        reading(scalar("float64", math.nan)),
        reading(scalar("string", "NaN")),
        reading(scalar("float32", 1.0)),
        reading(value_of(vector, {"x": 1})),
        reading(value_of(vector, {"x": 2})),
        reading(value_of(vector, {"x": 1}, "x")),
        reading(scalar("string", "x" * 100_000)),
        reading(scalar("string", "x" * 99_999 + "y")),
        reading(StoredValue(1)),
        reading(StoredValue(1.0)),
        reading(StoredValue(True)),
        reading(StoredValue("1")),
        reading(StoredValue([1])),
        reading(StoredValue({})),
        reading(None),
        reading(None, "it refused"),
        reading(None, "it refused again"),
    ]
    tokens = [version_key(each) for each in readings]
    assert len(set(tokens)) == len(tokens)
    assert tokens == [version_key(replace(each, read_ns=99, fresh_until=None)) for each in readings]
