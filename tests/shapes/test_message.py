"""Shapes of message types, validated by pyshacl: lifted messages conform, broken ones do not."""

from __future__ import annotations

from functools import cache

import pytest
from pyoxigraph import Literal, NamedNode, Triple
from pyshacl.shapes_graph import ShapesGraph

from rosld.adapters.model import Message, MessageSchema, ServiceSchema, TypeRef
from rosld.ontology.document import Document, Envelope, LiftedMessage
from rosld.ontology.lift import lifter
from rosld.ontology.lower import lowerer
from rosld.ontology.urls import Space
from rosld.ontology.vocab import rdf, ros, xsd
from rosld.shapes.message import shape_document
from tests.shapes.values import LIBRARIES, compiled, graph, schema_of, typed, validate

SPACE = Space("http://127.0.0.1:8080/")
pytestmark = pytest.mark.slow

URL = "http://127.0.0.1:8080/topics/a"

EVERYTHING = """
bool flag
int8 tiny
uint8 octet
int64 long
uint64 unsigned
float32 single
float64 double
string text
time stamp
duration span
geometry_msgs/Point point
geometry_msgs/Point[] points
geometry_msgs/Point[2] pair
float64[3] triple
int32[] numbers
string[] words
uint8[] bytes
uint8[5] five
bool[2] flags
string UNIT=mm
int8 MOST=7
"""


@cache
def everything() -> MessageSchema:
    return LIBRARIES[1].learn_message("test_msgs/msg/Everything", EVERYTHING)


def message(schema: MessageSchema, values: dict[str, object]) -> Message:
    return lowerer(schema).from_json(values, defaults=True)


FILLED = {"single": "INF", "double": "NaN", "text": "x", "points": [{}, {"x": 1}], "numbers": [1], "words": ["a", ""],
          "bytes": [1, 2], "point": {"x": "-INF"}, "flag": True}  # fmt: skip


def lifted(schema: MessageSchema, value: Message | None = None) -> list[Triple]:
    carried = LiftedMessage(
        "#message",
        lifter(schema),
        value or message(schema, FILLED if schema is everything() else {}),
        Envelope(1_700_000_000_000_000_000, 3),
    )
    return Document(URL, (), (carried,)).all_triples()


@cache
def shape_of(schema: MessageSchema) -> ShapesGraph:
    return compiled(graph(shape_document(schema, SPACE).triples))


def conforms(schema: MessageSchema, triples: list[Triple]) -> tuple[bool, str]:
    found, _, words = validate(graph(triples), shape_of(schema))
    return found, words


@pytest.mark.parametrize("version", [1, 2])
def test_what_lifting_writes_conforms(version: int) -> None:
    names = ["geometry_msgs/msg/Twist", "std_msgs/msg/Empty", "sensor_msgs/msg/CameraInfo"]
    for schema in (everything(), *(schema_of(name, version) for name in names)):
        assert conforms(schema, lifted(schema)) == (True, "Validation Report\nConforms: True\n")


def test_a_string_that_is_not_utf_8_conforms_in_ros_1() -> None:
    schema = schema_of("std_msgs/msg/String")
    triples = lifted(schema, schema.codec.build(schema.ref.name, {"data": "\udcff"}))
    assert xsd.base64Binary in [t.object.datatype for t in triples if isinstance(t.object, Literal)]
    assert conforms(schema, triples)[0]


def field(name: str) -> NamedNode:
    return NamedNode(SPACE.property_of("test_msgs/msg/Everything", name))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("flag", Literal("true")),
        ("tiny", typed("300", xsd.byte)),
        ("tiny", typed("7", xsd.integer)),
        ("octet", typed("-1", xsd.unsignedByte)),
        ("unsigned", typed("18446744073709551616", xsd.unsignedLong)),
        ("double", typed("1.0", xsd.decimal)),
        ("text", typed("1", xsd.integer)),
        ("text", NamedNode("http://h/")),
        ("point", Literal("x")),
        ("triple", typed("[1.0,2.0]", rdf.JSON)),
        ("triple", typed("[1.0,2.0,3.0,4.0]", rdf.JSON)),
        ("triple", Literal("[1.0,2.0,3.0]")),
        ("flags", typed("[]", rdf.JSON)),
        ("five", typed("AAAA", xsd.base64Binary)),
        ("pair", rdf.nil),
    ],
)
def test_a_wrong_value_does_not_conform(name: str, value: NamedNode | Literal) -> None:
    triples = [t for t in lifted(everything()) if t.predicate != field(name)]
    ok, words = conforms(everything(), [*triples, Triple(NamedNode(URL + "#message"), field(name), value)])
    assert not ok
    assert name in words


def test_a_missing_field_of_the_message_a_nested_one_or_an_element_does_not_conform() -> None:
    for name in ("flag", "words", "stamp", "points"):
        ok, words = conforms(everything(), [t for t in lifted(everything()) if t.predicate != field(name)])
        assert not ok
        assert name in words
    x = NamedNode(SPACE.property_of("geometry_msgs/msg/Point", "x"))
    for node in (".point", ".points.1"):
        whole = lifted(everything())
        broken = [t for t in whole if (t.subject, t.predicate) != (NamedNode(f"{URL}#message{node}"), x)]
        assert len(broken) == len(whole) - 1
        assert not conforms(everything(), broken)[0]


def test_a_second_value_and_an_unknown_field_do_not_conform() -> None:
    subject = NamedNode(URL + "#message")
    for extra in (Triple(subject, field("text"), Literal("more")), Triple(subject, field("none"), Literal("x"))):
        assert not conforms(everything(), [*lifted(everything()), extra])[0]


def test_constants_are_told_but_not_demanded() -> None:
    comments = [t.object for t in shape_document(everything(), SPACE).triples if t.predicate.value.endswith("#comment")]
    assert comments == [Literal("UNIT = mm"), Literal("MOST = 7")]
    assert conforms(everything(), lifted(everything(), message(everything(), FILLED | {"tiny": -5, "text": "cm"})))[0]


def test_the_shape_of_a_service_type_leads_to_those_of_its_halves() -> None:
    service = LIBRARIES[1].find(TypeRef("std_srvs/srv/SetBool"))
    assert isinstance(service, ServiceSchema)
    found = {t.predicate: t.object for t in shape_document(service, SPACE).triples}
    for predicate, half in ((ros.requestShape, "Request"), (ros.responseShape, "Response")):
        assert found[predicate] == NamedNode(SPACE.shape(f"std_srvs/srv/SetBool_{half}"))


LARGE = {
    "std_msgs/msg/String": ("data", "a" * 70_000),
    "std_msgs/msg/Float64MultiArray": ("data", [0] * 17_000),
    "geometry_msgs/msg/PoseArray": ("poses", [{}] * 1200),
}


@pytest.mark.parametrize("name", LARGE)
def test_what_is_too_large_to_be_written_conforms_elided(name: str) -> None:
    field_name, value = LARGE[name]
    schema = schema_of(name)
    triples = lifted(schema, message(schema, {field_name: value}))
    [elided] = {t.subject for t in triples if t.object == ros.Elided}
    assert elided == NamedNode(f"{URL}#message.{field_name}")
    assert conforms(schema, triples) == (True, "Validation Report\nConforms: True\n")
    for predicate in (rdf.type, ros.elidedLength, ros.bytes):
        assert not conforms(schema, [t for t in triples if (t.subject, t.predicate) != (elided, predicate)])[0]


def test_what_is_no_list_does_not_conform() -> None:
    node, cell, points = NamedNode(URL + "#message.points.0"), NamedNode("http://h/cell"), field("points")
    rest = [t for t in lifted(everything()) if t.predicate != points]
    first, head = Triple(cell, rdf.first, node), Triple(NamedNode(URL + "#message"), points, cell)
    assert conforms(everything(), [*rest, head, first, Triple(cell, rdf.rest, rdf.nil)])[0]
    for end in ([], [Triple(cell, rdf.rest, cell)], [Triple(cell, rdf.rest, rdf.nil), Triple(cell, rdf.rest, node)]):
        assert not conforms(everything(), [*rest, head, first, *end])[0]
    assert not conforms(everything(), [*rest, head, Triple(cell, rdf.rest, rdf.nil)])[0]
