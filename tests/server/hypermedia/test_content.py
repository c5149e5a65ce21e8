"""Content: what a body in RDF states the value of a property to be."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyoxigraph import Literal, NamedNode, RdfFormat, Triple, serialize

from rosld.adapters.model import Encoding, Message, MessageSchema, ServiceSchema, TypeRef
from rosld.adapters.model.library import TypeLibrary
from rosld.ontology.body import RdfBody, parse_body
from rosld.ontology.document import Document
from rosld.ontology.lift import LiftSettings
from rosld.ontology.lower import LoweringError, lowerer
from rosld.ontology.vocab import av, rdf, xsd
from rosld.server.hypermedia.catalogue import Getter, Property, Setter, TopicSource
from rosld.server.hypermedia.property_writer import lower_content
from rosld.server.hypermedia.type_inference import value_fields, value_kind
from rosld.server.hypermedia.value import MessageValue, lift_value
from rosld.server.hypermedia.value_body import content_from_rdf

P = "http://127.0.0.1:8080/resources/robot/thing"
IS_VALUE = Triple(NamedNode(P), rdf.value, NamedNode(f"{P}#value"))
C = "http://127.0.0.1:8080/resources/robot/"
LIFTING = LiftSettings()
TYPES = LIFTING.types
LIBRARY = TypeLibrary(ros_version=1)
PREFIXES = f"@prefix rdf: <{rdf.iri}> . @prefix xsd: <{xsd.iri}> . @prefix av: <{av.iri}> . @base <{P}> . "


def message_schema(name: str) -> MessageSchema:
    schema = LIBRARY.find(TypeRef(name))
    assert isinstance(schema, MessageSchema)
    return schema


def service(name: str, definition: str) -> ServiceSchema:
    return TypeLibrary(ros_version=1).learn_service(f"made_up/srv/{name}", definition)


GET_POINT = service("GetPoint", "---\nfloat64 x\nfloat64 y\nbool success\nstring message")
SET_POINT = service("SetPoint", "float64 x\nfloat64 y\n---\nbool success")
POINT = Property(
    "/robot/thing",
    value_kind(GET_POINT.response, value_fields(GET_POINT)),
    (Getter("/robot/get_thing", GET_POINT, value_fields(GET_POINT)),),
    (Setter("/robot/set_thing", SET_POINT),),
)
FLOAT = message_schema("std_msgs/msg/Float64")
NUMBER = Property(
    "/robot/thing",
    value_kind(FLOAT, FLOAT.type.fields),
    (TopicSource("/robot/thing", FLOAT),),
    (TopicSource("/robot/thing", FLOAT),),
)


def turtle(text: str) -> RdfBody:
    return parse_body((PREFIXES + text).encode(), "text/turtle", P)


def content(text: str, property: Property = NUMBER) -> object:
    return content_from_rdf(turtle(text), NamedNode(P), rdf.value, property, LIFTING)


def refused(text: str, property: Property = NUMBER) -> str:
    with pytest.raises(LoweringError) as caught:
        content(text, property)
    return str(caught.value)


def test_a_literal_keeps_its_datatype_and_other_statements_do_not_matter() -> None:
    literals = ('"off"', "5", "5.0", "5e0", "true", '"NaN"^^xsd:double', '"0.1"^^xsd:float', '"[1,2]"^^rdf:JSON')
    for literal in literals:
        found = content(f"<> rdf:value {literal} ; a rdf:Property . <http://example.org/> rdf:value 6, 7 .")
        assert isinstance(found, Literal)
        assert found in turtle(f"<> rdf:value {literal} .").objects(NamedNode(P), rdf.value)
    body = turtle(f"<{C}> av:power 'on' ; av:speed 3 . <> rdf:value 'not this' .")
    assert content_from_rdf(body, NamedNode(C), av.power, NUMBER, LIFTING) == Literal("on")


def test_there_must_be_one_value() -> None:
    assert content("<> rdf:value 5 . <> rdf:value 5 .") == Literal(5)
    assert "expected one value, and there are 2" in refused("<> rdf:value 5, 6 .")
    assert "missing: expected the value" in refused("<http://example.org/> rdf:value 5 .")
    assert P in refused("")


def test_a_node_of_another_type_names_those_that_may_be_sent() -> None:
    sentence = refused(f"<> rdf:value [ a <{TYPES}std_msgs/msg/Empty> ] .", POINT)
    assert "made_up/srv/GetPoint_Response" in sentence
    assert "made_up/srv/SetPoint_Request" in sentence
    assert "expected a node of type" in refused("<> rdf:value <#other> .", POINT)
    assert "expected a node of type" in refused("<> rdf:value [ ] .", POINT)


def test_what_does_not_fit_within_a_node_is_told_by_its_field() -> None:
    kind = f"{TYPES}made_up/srv/SetPoint_Request"
    with pytest.raises(LoweringError) as caught:
        content(f"<> rdf:value [ a <{kind}> ; <{kind}#x> 'far' ; <{kind}#z> 1 ] .", POINT)
    assert {each.path for each in caught.value.violations} == {"x", "y", "z"}


def test_a_node_that_holds_itself_is_refused() -> None:
    pose = message_schema("geometry_msgs/msg/Pose")
    own = Property("/robot/thing", value_kind(pose, pose.type.fields), (TopicSource("/robot/thing", pose),))
    kind = f"{TYPES}geometry_msgs/msg/Pose"
    assert refused(f"<> rdf:value <#value> . <#value> a <{kind}> ; <{kind}#position> <#value> .", own)


def carried(schema: MessageSchema, property: Property, message: Message) -> Message:
    """A message as it is read, sent back and lowered again."""
    document = Document(
        P, (IS_VALUE,), (lift_value(MessageValue(schema, message, schema.type.fields, P), "#value", LIFTING),)
    )
    data = serialize(document.all_triples(), format=RdfFormat.N_TRIPLES)
    assert data is not None
    body = parse_body(data, "application/n-triples", P)
    return lower_content(schema, content_from_rdf(body, NamedNode(P), rdf.value, property, LIFTING), LIFTING)


def alike(schema: MessageSchema, one: Message, other: Message) -> bool:
    return schema.codec.encode(one, Encoding.ROS1) == schema.codec.encode(other, Encoding.ROS1)


EVERY = TypeLibrary(ros_version=1).learn_message(
    "made_up/msg/Every", "float32 f\nfloat64 d\nint64 i\nuint64 u\nbool b\nstring s\nfloat32[] list\nuint8[] octets"
)


@settings(deadline=None)
@given(
    st.floats(width=32, allow_nan=False) | st.just(math.inf),
    st.floats(allow_nan=False),
    st.integers(-(2**63), 2**63 - 1),
    st.integers(0, 2**64 - 1),
    st.booleans(),
    st.text(st.characters(exclude_categories=["Cs"])) | st.just("a\udcffb"),
    st.lists(st.floats(width=32, allow_nan=False)),
    st.binary(),
)
def test_a_message_that_was_read_comes_back_bit_by_bit(
    f: float, d: float, i: int, u: int, b: bool, s: str, numbers: list[float], octets: bytes
) -> None:
    own = Property("/robot/thing", value_kind(EVERY, EVERY.type.fields), (TopicSource("/robot/thing", EVERY),))
    values = {"f": f, "d": d, "i": i, "u": u, "b": b, "s": s}
    arrays = {"list": np.array(numbers, np.float32), "octets": np.frombuffer(octets, np.uint8)}
    message = EVERY.codec.build(EVERY.ref.name, {**values, **arrays})
    assert alike(EVERY, carried(EVERY, own, message), message)


def test_an_elided_field_must_be_sent_whole() -> None:
    small = LiftSettings(inline_limit=4)
    own = Property("/robot/thing", value_kind(EVERY, EVERY.type.fields), (TopicSource("/robot/thing", EVERY),))
    message = lowerer(EVERY).from_json({"octets": [1] * 9}, defaults=True)
    document = Document(
        P, (IS_VALUE,), (lift_value(MessageValue(EVERY, message, EVERY.type.fields, P), "#value", small),)
    )
    data = serialize(document.all_triples(), format=RdfFormat.N_TRIPLES)
    assert data is not None
    with pytest.raises(LoweringError, match="left out"):
        content_from_rdf(parse_body(data, "application/n-triples", P), NamedNode(P), rdf.value, own, LIFTING)
