"""Shapes of message types, judged by pyshacl: what lifting writes conforms, what is broken does not."""

from __future__ import annotations

from functools import cache

import numpy as np
import pyshacl
import pytest
import rdflib
from pyoxigraph import Literal, NamedNode, RdfFormat, Triple, parse

from rosld.adapters.model import Array, Message, MessageSchema, Nested, Primitive, ServiceSchema, TypeRef
from rosld.adapters.model.library import TypeLibrary
from rosld.ontology.document import Document, Envelope, LiftedMessage
from rosld.ontology.lift import lifter
from rosld.ontology.literals import DTYPES, STRINGS
from rosld.ontology.serialize import Syntax, serialize
from rosld.ontology.urls import Space
from rosld.ontology.vocab import rdf, ros, xsd
from rosld.shapes.message import shape_document

SPACE = Space("http://127.0.0.1:8080/")
URL = "http://127.0.0.1:8080/topics/a"
LIBRARIES = {version: TypeLibrary(ros_version=version) for version in (1, 2)}

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
def schema_of(name: str, version: int = 1) -> MessageSchema:
    schema = LIBRARIES[version].find(TypeRef(name))
    assert isinstance(schema, MessageSchema)
    return schema


@cache
def everything() -> MessageSchema:
    return LIBRARIES[1].learn_message("test_msgs/msg/Everything", EVERYTHING)


def message(schema: MessageSchema, name: str | None = None, **values: object) -> Message:
    """A message with something in every field, or with these values."""
    kind = schema.types[name or schema.ref.name]
    found = {field.attribute: _value(schema, field.type) for field in kind.fields}
    return schema.codec.build(kind.name, {**found, **values})


def _value(schema: MessageSchema, kind: Primitive | Nested | Array) -> object:
    if isinstance(kind, Nested):
        return message(schema, kind.name)
    if isinstance(kind, Array):
        size = 2 if kind.length is None else kind.length
        if isinstance(kind.element, Nested) or kind.element.name in STRINGS:
            return [_value(schema, kind.element) for _ in range(size)]
        return np.ones(size, DTYPES[kind.element.name])
    if kind.name in STRINGS:
        return "text"
    return True if kind.name == "bool" else float("inf") if kind.name.startswith("float") else 7


def lifted(schema: MessageSchema, value: Message | None = None) -> list[Triple]:
    carried = LiftedMessage(
        "#message", lifter(schema), value or message(schema), Envelope(1_700_000_000_000_000_000, 3)
    )
    return Document(URL, (), (carried,)).all_triples()


def graph(triples: list[Triple]) -> rdflib.Graph:
    normalize, rdflib.NORMALIZE_LITERALS = rdflib.NORMALIZE_LITERALS, False
    try:
        return rdflib.Graph().parse(serialize(Document(URL, tuple(triples)), Syntax.N_TRIPLES), format="nt")
    finally:
        rdflib.NORMALIZE_LITERALS = normalize


def conforms(schema: MessageSchema, triples: list[Triple]) -> tuple[bool, str]:
    found, _, words = pyshacl.validate(graph(triples), shacl_graph=graph(shape_document(schema, SPACE).triples))
    return bool(found), str(words)


@pytest.mark.parametrize(
    "name",
    [
        "geometry_msgs/msg/Twist",
        "sensor_msgs/msg/Imu",
        "nav_msgs/msg/Path",
        "std_msgs/msg/Empty",
        "std_msgs/msg/Header",
        "sensor_msgs/msg/CameraInfo",
        "std_msgs/msg/Float64MultiArray",
    ],
)
@pytest.mark.parametrize("version", [1, 2])
def test_what_lifting_writes_conforms(name: str, version: int) -> None:
    schema = schema_of(name, version)
    assert conforms(schema, lifted(schema)) == (True, "Validation Report\nConforms: True\n")


def test_every_kind_of_field_conforms() -> None:
    assert conforms(everything(), lifted(everything())) == (True, "Validation Report\nConforms: True\n")


def test_a_string_that_is_not_utf_8_conforms_in_ros_1() -> None:
    schema = schema_of("std_msgs/msg/String")
    triples = lifted(schema, schema.codec.build(schema.ref.name, {"data": "\udcff"}))
    assert xsd.base64Binary in [t.object.datatype for t in triples if isinstance(t.object, Literal)]
    assert conforms(schema, triples)[0]


def field(name: str) -> NamedNode:
    return NamedNode(SPACE.property_of("test_msgs/msg/Everything", name))


def typed(text: str, datatype: NamedNode) -> Literal:
    return Literal(text, datatype=datatype)


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


@pytest.mark.parametrize("name", [field.name for field in everything().type.fields])
def test_a_missing_field_does_not_conform(name: str) -> None:
    ok, words = conforms(everything(), [t for t in lifted(everything()) if t.predicate != field(name)])
    assert not ok
    assert name in words


def test_a_missing_field_of_a_nested_message_and_of_an_element_does_not_conform() -> None:
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
    assert conforms(everything(), lifted(everything(), message(everything(), tiny=-5, text="cm")))[0]


def test_the_shape_of_a_service_type_leads_to_those_of_its_halves() -> None:
    service = LIBRARIES[1].find(TypeRef("std_srvs/srv/SetBool"))
    assert isinstance(service, ServiceSchema)
    found = {t.predicate: t.object for t in shape_document(service, SPACE).triples}
    for predicate, half in ((ros.requestShape, "Request"), (ros.responseShape, "Response")):
        assert found[predicate] == NamedNode(SPACE.shape(f"std_srvs/srv/SetBool_{half}"))


IMAGE = {"height": 480, "width": 640, "encoding": "rgb8", "step": 1920, "data": np.zeros(480 * 1920, np.uint8)}
LARGE = {
    "an image of 640 by 480": ("sensor_msgs/msg/Image", IMAGE, "data"),
    "a string": ("std_msgs/msg/String", {"data": "a" * 70_000}, "data"),
    "an array of numbers": ("std_msgs/msg/Float64MultiArray", {"data": np.zeros(9000)}, "data"),
    "an array of messages": ("geometry_msgs/msg/PoseArray", {}, "poses"),
}


@pytest.mark.parametrize("what", LARGE)
@pytest.mark.parametrize("version", [1, 2])
def test_what_is_too_large_to_be_written_conforms_elided(what: str, version: int) -> None:
    name, values, field_name = LARGE[what]
    schema = schema_of(name, version)
    if name == "geometry_msgs/msg/PoseArray":
        values = {"poses": [message(schema, "geometry_msgs/msg/Pose")] * 1200}
    triples = lifted(schema, message(schema, **values))
    elided = {t.subject for t in triples if t.object == ros.Elided}
    assert elided == {NamedNode(f"{URL}#message.{field_name}")}
    assert conforms(schema, triples) == (True, "Validation Report\nConforms: True\n")
    for predicate in (rdf.type, ros.elidedLength, ros.bytes):
        broken = [t for t in triples if (t.subject, t.predicate) != (next(iter(elided)), predicate)]
        assert not conforms(schema, broken)[0]


def test_what_is_no_list_does_not_conform() -> None:
    node, cell, points = NamedNode(URL + "#message.points.0"), NamedNode("http://h/cell"), field("points")
    rest = [t for t in lifted(everything()) if t.predicate != points]
    first, head = Triple(cell, rdf.first, node), Triple(NamedNode(URL + "#message"), points, cell)
    assert conforms(everything(), [*rest, head, first, Triple(cell, rdf.rest, rdf.nil)])[0]
    for end in ([], [Triple(cell, rdf.rest, cell)], [Triple(cell, rdf.rest, rdf.nil), Triple(cell, rdf.rest, node)]):
        assert not conforms(everything(), [*rest, head, first, *end])[0]
    assert not conforms(everything(), [*rest, head, Triple(cell, rdf.rest, rdf.nil)])[0]


@pytest.mark.parametrize("syntax", [Syntax.TURTLE, Syntax.JSON_LD, Syntax.RDF_XML])
def test_a_shape_is_the_same_in_every_syntax(syntax: Syntax) -> None:
    document = shape_document(everything(), SPACE)
    formats = {Syntax.TURTLE: RdfFormat.TURTLE, Syntax.JSON_LD: RdfFormat.JSON_LD, Syntax.RDF_XML: RdfFormat.RDF_XML}
    assert len(list(parse(serialize(document, syntax), format=formats[syntax]))) == len(set(document.triples))


def test_blank_nodes_of_two_shapes_never_meet_in_one_graph() -> None:
    triples = shape_document(schema_of("nav_msgs/msg/Path"), SPACE).triples
    assert len(set(triples)) == len(triples)
