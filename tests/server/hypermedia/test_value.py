"""Values: how a property's value is written in RDF and in plain JSON, and when two are the same."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from datetime import datetime, timezone

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyoxigraph import Literal, NamedNode, RdfFormat, parse

from rosld.adapters.model import Encoding, MessageSchema, TypeRef
from rosld.adapters.model.library import TypeLibrary
from rosld.ontology.document import Document
from rosld.ontology.lift import LiftSettings
from rosld.ontology.lower import lowerer, parse_json
from rosld.ontology.lower_graph import term_leaf
from rosld.ontology.serialize import Syntax, serialize
from rosld.ontology.vocab import rdf, ros, xsd
from rosld.server.hypermedia.value import (
    MessageValue,
    Reading,
    StoredValue,
    field_json,
    lift_value,
    plain_json,
    refusal_text,
    scalar_field,
    select_fields,
    value_literal,
    version_key,
)

P = "http://127.0.0.1:8080/resources/robot/thing"
T = "http://127.0.0.1:8080/topics/robot/thing"
LIFTING = LiftSettings()
LIBRARY = TypeLibrary(ros_version=1)


def schema_of(definition: str, name: str = "made_up/msg/Thing") -> MessageSchema:
    return TypeLibrary(ros_version=1).learn_message(name, definition)


def known(name: str) -> MessageSchema:
    schema = LIBRARY.find(TypeRef(name))
    assert isinstance(schema, MessageSchema)
    return schema


def value_of(schema: MessageSchema, value: object, *names: str) -> MessageValue:
    """The message of a JSON value; with names, only these fields of it are the value."""
    fields = tuple(field for field in schema.type.fields if not names or field.name in names)
    return MessageValue(schema, lowerer(schema).from_json(value, defaults=True), fields, T)


def scalar(kind: str, value: object) -> MessageValue:
    schema = schema_of(f"{kind} data")
    message = schema.codec.build(schema.ref.name, {"data": value})
    return MessageValue(schema, message, schema.type.fields, T)


def typed(lexical: str, datatype: str) -> Literal:
    return Literal(lexical, datatype=NamedNode(xsd.iri + datatype))


@pytest.mark.parametrize(
    ("kind", "value", "expected", "plain"),
    [
        ("bool", True, typed("true", "boolean"), b"true"),
        ("byte", -3, typed("-3", "byte"), b"-3"),
        ("char", 200, typed("200", "unsignedByte"), b"200"),
        ("int32", -7, typed("-7", "int"), b"-7"),
        ("uint64", 2**64 - 1, typed("18446744073709551615", "unsignedLong"), b'"18446744073709551615"'),
        ("int64", 7, typed("7", "long"), b"7"),
        ("float32", float(np.float32(0.1)), typed("0.1", "float"), b"0.1"),
        ("float64", 0.1, typed("0.1", "double"), b"0.1"),
        ("float64", math.nan, typed("NaN", "double"), b'"NaN"'),
        ("float32", -math.inf, typed("-INF", "float"), b'"-INF"'),
        ("string", "off", Literal("off"), b'"off"'),
        ("string", "", Literal(""), b'""'),
        ("string", 'a "b"\n𝄞', Literal('a "b"\n𝄞'), '"a \\"b\\"\\n𝄞"'.encode()),
        (
            "string",
            b"\xff\xfe".decode("utf-8", "surrogateescape"),
            typed("//4=", "base64Binary"),
            b'{"@value":"//4=","@type":"http://www.w3.org/2001/XMLSchema#base64Binary"}',
        ),
    ],
)
def test_a_scalar_is_the_literal_of_its_primitive_and_a_bare_json_value(
    kind: str, value: object, expected: Literal, plain: bytes
) -> None:
    assert value_literal(scalar(kind, value)) == expected
    assert plain_json(scalar(kind, value), LIFTING) == plain


@settings(deadline=None)
@given(st.floats() | st.sampled_from([-0.0, 5e-324]), st.floats(width=32))
def test_a_float_reads_back_as_the_very_same(number: float, single: float) -> None:
    value = scalar("float64", number)
    found = value_literal(value)
    assert found is not None
    schema = value.schema
    field = scalar_field(schema.type.fields)
    assert field is not None
    back = term_leaf(field.type)(found)  # type: ignore[arg-type]
    from_json = lowerer(schema).from_json({"data": parse_json(plain_json(value, LIFTING))})
    for each in (back, getattr(from_json, "data")):  # noqa: B009
        assert isinstance(each, float)
        assert np.float64(each).tobytes() == np.float64(number).tobytes() or (math.isnan(each) and math.isnan(number))
    found = value_literal(scalar("float32", single))
    assert found is not None
    assert found.datatype == xsd.float
    assert np.float32(found.value.replace("INF", "inf")) == np.float32(single) or math.isnan(single)


def test_a_long_string_that_is_the_value_is_whole() -> None:
    text = "x" * 100_000
    value = scalar("string", text)
    assert value_literal(value) == Literal(text)
    assert json.loads(plain_json(value, LiftSettings(inline_limit=10))) == text


RESPONSE = "float32 x\nfloat32 y\nbool success\nstring message"


def test_fields_that_are_not_the_value_are_left_out() -> None:
    value = value_of(schema_of(RESPONSE), {"x": 1, "y": 2, "success": True, "message": "ok"}, "x", "y")
    assert value_literal(value) is None
    assert plain_json(value, LIFTING) == b'{"x":1.0,"y":2.0}'
    triples = lift_value(value, "#value", LIFTING).triples(Document(P, ()))
    assert {each.predicate.value.rpartition("#")[2] for each in triples} == {"x", "y", "type"}
    kinds = [each.object for each in triples if each.predicate == rdf.type]
    assert kinds == [NamedNode(LIFTING.types + "made_up/msg/Thing")]
    with pytest.raises(ValueError, match="success"):
        value_literal(value, "success")
    one = value_of(schema_of(RESPONSE), {"x": 1.5}, "x")
    assert (plain_json(one, LIFTING), value_literal(one)) == (b"1.5", typed("1.5", "float"))
    array = value_of(schema_of("float64[] data"), {"data": [1]})
    assert (plain_json(array, LIFTING), value_literal(array)) == (b'{"data":[1.0]}', None)


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


@pytest.mark.parametrize(
    ("value", "expected", "plain"),
    [
        (2, typed("2", "integer"), b"2"),
        (0.5, typed("0.5", "double"), b"0.5"),
        (False, typed("false", "boolean"), b"false"),
        ("RO-SLD", Literal("RO-SLD"), b'"RO-SLD"'),
        (b"\x00\xff", typed("AP8=", "base64Binary"), b'{"@value":"AP8=","@type":"xsd:base64Binary"}'),
        (
            datetime(2026, 1, 31, tzinfo=timezone.utc),
            typed("2026-01-31T00:00:00Z", "dateTime"),
            b'{"@value":"2026-01-31T00:00:00Z","@type":"xsd:dateTime"}',
        ),
        (["fuel", 2], Literal('["fuel",2]', datatype=rdf.JSON), b'["fuel",2]'),
        ({"a": {"b": 1}}, None, b'{"a":{"b":1}}'),
    ],
)
def test_a_parameter_is_its_literal_and_its_json(value: object, expected: Literal | None, plain: bytes) -> None:
    stored = StoredValue(value)  # type: ignore[arg-type]
    assert value_literal(stored) == expected
    assert plain_json(stored, LIFTING) == plain


def test_the_bytes_of_elided_fields_are_asked_of_where_they_are() -> None:
    """In a document of another URL they still lead to the topic."""
    small = LiftSettings(inline_limit=4)
    value = value_of(schema_of("uint8[] data\nfloat32 x"), {"data": [1] * 9, "x": 1})
    document = Document(P, (), (lift_value(value, "#thing", small),))
    href = NamedNode(f"{T}?field=data")
    for syntax in (Syntax.TURTLE, Syntax.N_TRIPLES, Syntax.JSON_LD):
        quads = parse(serialize(document, syntax), format=_format(syntax), base_iri=P)
        assert [each.object for each in quads if each.predicate == ros.bytes] == [href], syntax
    assert [each.object for each in document.all_triples() if each.predicate == ros.bytes] == [href]
    assert json.loads(plain_json(value, small))["data"] == {"elided": True, "length": 9, "href": href.value}


def _format(syntax: Syntax) -> RdfFormat:
    found = RdfFormat.from_media_type(syntax.media_type)
    assert found is not None
    return found


def test_a_part_of_a_message_builds_the_whole_with_defaults() -> None:
    schema = schema_of(RESPONSE)
    part = select_fields(schema, schema.type.fields[:2])
    message = lowerer(part).from_json({"x": 1, "y": 2})
    assert schema.codec.decode(schema.codec.encode(message, Encoding.ROS1), Encoding.ROS1) == message
    assert plain_json(MessageValue(schema, message, schema.type.fields, T), LIFTING) == (
        b'{"x":1.0,"y":2.0,"success":false,"message":""}'
    )
    assert select_fields(schema, schema.type.fields) is schema


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


@settings(deadline=None)
@given(st.floats(), st.floats())
def test_two_tokens_are_alike_just_when_the_values_are(one: float, other: float) -> None:
    same = np.float64(one).tobytes() == np.float64(other).tobytes() or (math.isnan(one) and math.isnan(other))
    assert (version_key(reading(scalar("float64", one))) == version_key(reading(scalar("float64", other)))) == same
