"""Lifting: the exact RDF of a message."""

from __future__ import annotations

import math
from dataclasses import replace
from decimal import Decimal
from types import MappingProxyType
from typing import cast

import numpy as np
import orjson
import pyoxigraph as ox
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.adapters.model import Field, Message, MessageSchema, MessageType, Nested, Primitive
from rosld.adapters.model.library import TypeLibrary
from rosld.ontology.document import Envelope
from rosld.ontology.fields import field_bytes
from rosld.ontology.lift import LiftSettings, lifter
from rosld.ontology.literals import date_time, json_numbers, scalar_texts, unpack_float32
from rosld.ontology.lower import lowerer
from rosld.ontology.vocab import rdf, xsd

D = "http://127.0.0.1:8080/topics/t"
LIBRARY = TypeLibrary(ros_version=1)
SMALL = LiftSettings(inline_limit=16)


def schema_of(definition: str, name: str = "made_up/msg/Thing") -> MessageSchema:
    return TypeLibrary(ros_version=1).learn_message(name, definition)


def message_of(schema: MessageSchema, value: object) -> Message:
    return lowerer(schema).from_json(value, defaults=True)


def objects(schema: MessageSchema, value: object, settings: LiftSettings = LiftSettings()) -> dict[str, str]:  # noqa: B008
    """Return the object of each field of the message itself."""
    triples = lifter(schema, settings).triples(message_of(schema, value), D, "#message")
    start = settings.types + schema.ref.name + "#"
    return {
        t.predicate.value.removeprefix(start): str(t.object) for t in triples if t.predicate.value.startswith(start)
    }


def test_a_pose_in_turtle_reads_as_a_person_would_write_it() -> None:
    schema = schema_of("float32 x\nfloat32 y", "turtlesim/msg/Pose")
    lift = lifter(schema)
    message = message_of(schema, {"x": 5.544444561004639, "y": 1e-7})
    text = lift.turtle(message, D, "#message", envelope=Envelope(1_700_000_000_500_000_000, 42, "http://h/nodes/n"))
    assert text == (
        "<#message> a turtlesim:Pose ;\n"
        '    ros:received "2023-11-14T22:13:20.5Z"^^xsd:dateTime ;\n'
        "    ros:sequence 42 ;\n"
        "    ros:sentBy <http://h/nodes/n> ;\n"
        '    pose:x "5.5444446"^^xsd:float ;\n'
        '    pose:y "1e-7"^^xsd:float .\n'
    )
    assert lift.prefixes["pose"] == "https://w3id.org/rosld/types/turtlesim/msg/Pose#"
    assert lift.prefixes["turtlesim"] == "https://w3id.org/rosld/types/turtlesim/msg/"


def test_json_is_the_message_as_ros_has_it() -> None:
    schema = schema_of("float32 f\nfloat64[] a\nuint8[] o\nstring s\nuint64 big\nbool b\ntime t\nfloat64 z")
    value = {"f": "NaN", "a": [1.5, "INF", "-0.0"], "o": "AQI=", "s": 'a"\n', "big": 2**64 - 1, "b": True, "z": "-0.0"}
    found = orjson.loads(lifter(schema).json(message_of(schema, value), D))
    stamp = {"t": {"sec": 0, "nanosec": 0}}
    assert found == value | stamp | {"big": "18446744073709551615", "z": -0.0}
    assert math.copysign(1, found["z"]) == -1


@pytest.mark.parametrize(
    ("kind", "value", "literal"),
    [
        ("int8", -128, '"-128"^^<xsd:byte>'),
        ("byte", -1, '"-1"^^<xsd:byte>'),
        ("char", 255, '"255"^^<xsd:unsignedByte>'),
        ("uint8", 255, '"255"^^<xsd:unsignedByte>'),
        ("int16", -1, '"-1"^^<xsd:short>'),
        ("uint16", 1, '"1"^^<xsd:unsignedShort>'),
        ("int32", -1, '"-1"^^<xsd:int>'),
        ("uint32", 1, '"1"^^<xsd:unsignedInt>'),
        ("int64", -(2**63), '"-9223372036854775808"^^<xsd:long>'),
        ("uint64", 2**64 - 1, '"18446744073709551615"^^<xsd:unsignedLong>'),
        ("float32", 0.1, '"0.1"^^<xsd:float>'),
        ("float64", 0.1, '"0.1"^^<xsd:double>'),
        ("float64", "-0.0", '"-0.0"^^<xsd:double>'),
        ("float64", "-INF", '"-INF"^^<xsd:double>'),
        ("bool", True, '"true"^^<xsd:boolean>'),
        ("string", "a\x00\"'", '"a\\u0000\\"\'"'),
        ("uint8[]", [0, 255], '"AP8="^^<xsd:base64Binary>'),
        ("float32[]", [0.1, "NaN", "-0.0"], '"[0.1,\\"NaN\\",\\"-0.0\\"]"^^<rdf:JSON>'),
        ("int8[2]", [-1, 1], '"[-1,1]"^^<rdf:JSON>'),
        ("int64[]", [2**53, -(2**53) - 1], '"[9007199254740992,\\"-9007199254740993\\"]"^^<rdf:JSON>'),
        ("bool[]", [True, False], '"[true,false]"^^<rdf:JSON>'),
        ("string[]", ["a"], '"[\\"a\\"]"^^<rdf:JSON>'),
    ],
)
def test_each_primitive_has_the_exact_datatype_of_its_ros_type(kind: str, value: object, literal: str) -> None:
    found = objects(schema_of(f"{kind} v"), {"v": value})["v"]
    assert found.replace(xsd.iri, "xsd:").replace(rdf.iri, "rdf:") == literal


def test_a_string_that_is_not_utf8_is_its_octets() -> None:
    schema = schema_of("string s\nstring[] a")
    message = schema.codec.build(schema.ref.name, {"s": "a\udcff", "a": ["ok", "\udc80"]})
    text = lifter(schema).ntriples(message, D, "#message")
    assert '"Yf8="^^<http://www.w3.org/2001/XMLSchema#base64Binary>' in text
    array = next(t.object for t in lifter(schema).triples(message, D, "#message") if t.predicate.value.endswith("#a"))
    assert orjson.loads(cast(ox.Literal, array).value) == [
        "ok",
        {"@value": "gA==", "@type": "http://www.w3.org/2001/XMLSchema#base64Binary"},
    ]


@given(st.lists(st.floats(width=32), max_size=6))
def test_float32_has_the_shortest_digits_alone_and_in_arrays(values: list[float]) -> None:
    array = np.array(values, np.float32)
    alone = scalar_texts(unpack_float32(array.tobytes())) if values else []
    within = orjson.loads(json_numbers(array))
    assert [np.float32(form.replace("INF", "inf")).tobytes() for form in alone if form != "NaN"] == [
        value.tobytes() for value in array if value == value
    ]
    assert [str(each) if isinstance(each, str) else each for each in within] == [
        form if form in ("NaN", "INF", "-INF", "-0.0") else float(form) for form in alone
    ]
    finite = [(form, value) for form, value in zip(alone, array, strict=True) if np.isfinite(value)]
    assert [Decimal(form) for form, _ in finite] == [Decimal(str(value)) for _, value in finite]


def test_list_cells_of_two_documents_never_share_a_label() -> None:
    schema = schema_of("Inner[] many\n================\nMSG: made_up/Inner\nint8 v")
    message = message_of(schema, {"many": [{"v": 1}, {"v": 2}]})

    def cells(document: str) -> set[str]:
        triples = lifter(schema).triples(message, document, "#message")
        return {str(t.subject) for t in triples if isinstance(t.subject, ox.BlankNode)}

    assert len(cells(D)) == 2
    assert not cells(D) & cells(D + "2")


def test_a_stamp_gains_a_date_time_unless_it_is_zero_or_time_is_simulated() -> None:
    schema = schema_of("time t\nduration d")
    message = message_of(schema, {"t": {"sec": 1_700_000_000, "nanosec": 20}})
    text = lifter(schema).ntriples(message, D, "#message")
    assert text.count("rosld#dateTime>") == 1
    assert '"2023-11-14T22:13:20.00000002Z"' in text
    zero = message_of(schema, {"t": {"sec": 0, "nanosec": 0}})
    for each, simulated, written in ((message, False, True), (message, True, False), (zero, False, False)):
        made = lifter(schema)
        for text in (made.ntriples, made.turtle, made.jsonld):
            assert ("dateTime" in str(text(each, D, "#message", simulated_time=simulated))) == written


@pytest.mark.parametrize(
    ("seconds", "nanoseconds", "text"),
    [
        (0, 0, "1970-01-01T00:00:00Z"),
        (-1, 500_000_000, "1969-12-31T23:59:59.5Z"),
        (0, 4_294_967_295, "1970-01-01T00:00:04.294967295Z"),
        (2**31 - 1, 1, "2038-01-19T03:14:07.000000001Z"),
        (-(2**31), 0, "1901-12-13T20:45:52Z"),
        (2**40, 0, "36812-02-20T00:36:16Z"),
    ],
)
def test_date_times_of_any_sign_and_size(seconds: int, nanoseconds: int, text: str) -> None:
    assert date_time(seconds, nanoseconds) == text


@pytest.mark.parametrize(
    ("definition", "value", "length"),
    [
        ("uint8[] v", [7] * 17, 17),
        ("float64[] v", [1.0] * 3, 3),
        ("string v", "ü" * 9, 9),
        ("string[] v", ["abcd"] * 3, 3),
        ("Inner[] v\n================\nMSG: made_up/Inner\nfloat64 v", [{"v": 1.0}] * 3, 3),
    ],
)
def test_what_is_too_large_is_left_out_visibly_in_every_syntax(definition: str, value: object, length: int) -> None:
    schema = schema_of(definition)
    message = message_of(schema, {"v": value})
    lift = lifter(schema, SMALL)
    said = {str(triple) for triple in lift.triples(message, D, "#message")}
    assert f"<{D}#message.v> <https://w3id.org/rosld#bytes> <{D}?field=v>" in said
    assert (
        f"<{D}#message.v> <{ox.NamedNode('https://w3id.org/rosld#elidedLength').value}> "
        + (f'"{length}"^^<http://www.w3.org/2001/XMLSchema#integer>')
        in said
    )
    assert len(said) == 5
    context = orjson.dumps(dict(lift.context)).decode()
    jsonld = f'{{"@context":{context},{lift.jsonld(message, D, "#message")[1:]}'
    assert {str(q.triple) for q in ox.parse(jsonld, ox.RdfFormat.JSON_LD, base_iri=D)} == said
    prefixes = "".join([f"@prefix {prefix}: <{iri}> .\n" for prefix, iri in lift.prefixes.items()])
    turtle = f"@base <{D}> .\n{prefixes}{lift.turtle(message, D, '#message')}"
    assert {str(q.triple) for q in ox.parse(turtle, ox.RdfFormat.TURTLE)} == said
    elided = {"elided": True, "length": length, "href": f"{D}?field=v"}
    assert orjson.loads(lift.json(message, D)) == {"v": elided}


def test_the_path_of_what_is_elided_leads_through_arrays_and_queries() -> None:
    schema = schema_of("Inner[] many\n================\nMSG: made_up/Inner\nuint8[] data")
    message = message_of(schema, {"many": [{"data": [1] * 20}]})
    assert f"<{D}?hash=1&field=many.0.data>" in lifter(schema, SMALL).turtle(message, f"{D}?hash=1", "#message")


def test_large_nested_types_are_lifted_by_functions_of_their_own() -> None:
    inner = "\n".join([f"float64 f{i}" for i in range(200)])
    schema = schema_of(f"Inner one\nInner two\n================\nMSG: made_up/Inner\n{inner}")
    message = message_of(schema, {"two": {"f199": 7.5}})
    said = lifter(schema).triples(message, D, "#message")
    assert len(said) == 3 + 2 * 201
    assert orjson.loads(lifter(schema).json(message, D))["two"]["f199"] == 7.5


def test_two_types_of_one_short_name_have_prefixes_of_their_own() -> None:
    schema = schema_of(
        "a_pkg/Pose p\nb_pkg/Pose q\nros/Xsd r\n=====\nMSG: a_pkg/Pose\nint8 x\n=====\nMSG: b_pkg/Pose\nint8 x\n"
        "=====\nMSG: ros/Xsd\nint8 x"
    )
    prefixes = lifter(schema).prefixes
    assert len(set(prefixes.values())) == len(prefixes)
    assert prefixes["a_pkg.Pose"].endswith("/a_pkg/msg/Pose#")
    assert prefixes["ros"] == "https://w3id.org/rosld#"
    message = message_of(schema, {})
    turtle = "".join([f"@prefix {prefix}: <{iri}> .\n" for prefix, iri in prefixes.items()])
    turtle += f"@base <{D}> .\n" + lifter(schema).turtle(message, D, "#message")
    said = {str(q.triple) for q in ox.parse(turtle, ox.RdfFormat.TURTLE)}
    assert said == {str(triple) for triple in lifter(schema).triples(message, D, "#message")}


@pytest.mark.parametrize("attribute", ["x; exit()", "x'", "é", ""])
def test_a_name_that_is_none_never_reaches_the_compiler(attribute: str) -> None:
    schema = schema_of("int8 v")
    name = f"a/msg/{attribute}"
    with pytest.raises(ValueError, match="not a ROS type name"):
        lifter(
            replace(schema, ref=replace(schema.ref, name=name), types=MappingProxyType({name: MessageType(name, ())}))
        )
    field = Field(attribute, Primitive("int8"), attribute)
    types = MappingProxyType({schema.ref.name: MessageType(schema.ref.name, (field,))})
    with pytest.raises(ValueError, match="not a ROS field name"):
        lifter(replace(schema, types=types)).ntriples(cast(Message, None), D, "#message")


def test_a_type_that_contains_itself_is_refused() -> None:
    schema = schema_of("int8 v")
    own = MessageType(schema.ref.name, (Field("own", Nested(schema.ref.name), "own"),))
    with pytest.raises(ValueError, match="contains itself"):
        lifter(replace(schema, types=MappingProxyType({schema.ref.name: own}))).json(cast(Message, None), D)


FIELDS = schema_of(
    "uint8[] o\nfloat32[] f\nstring s\nstring[] t\nInner[] many\nint64 n\nfloat32 single\n"
    "================\nMSG: made_up/Inner\nuint8[] data\nfloat64 v"
)
VALUE = {
    "o": [1, 255], "f": ["NaN", 0.1], "s": "ü", "t": ["a"], "many": [{"data": [5]}, {"v": "INF"}], "n": 5, "single": 0.1
}  # fmt: skip


@pytest.mark.parametrize(
    ("path", "octets", "media_type"),
    [
        ("o", b"\x01\xff", "application/octet-stream"),
        ("f", b'["NaN",0.1]', "application/json"),
        ("s", "ü".encode(), "text/plain; charset=utf-8"),
        ("t", b'["a"]', "application/json"),
        ("many.0.data", b"\x05", "application/octet-stream"),
        ("many.1", b'{"data":"","v":"INF"}', "application/json"),
        ("many", b'[{"data":"BQ==","v":0.0},{"data":"","v":"INF"}]', "application/json"),
        ("n", b"5", "application/json"),
        ("single", b"0.1", "application/json"),
    ],
)
def test_a_field_can_be_fetched_by_its_path(path: str, octets: bytes, media_type: str) -> None:
    assert field_bytes(FIELDS, message_of(FIELDS, VALUE), path) == (octets, media_type)


def test_a_path_of_no_field_is_named() -> None:
    for path in ("", "x", "o.0.1", "many.2", "many.-1", "many.0.x", "s.0", "many..v", "many.99999999999"):
        with pytest.raises(ValueError, match="has no field"):
            field_bytes(FIELDS, message_of(FIELDS, VALUE), path)
