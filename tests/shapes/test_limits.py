"""Limits: writes are bounded by type and by resource, as with pyshacl, and NaN never conforms."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
import rdflib
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pyoxigraph import Literal, NamedNode, Triple

from rosld.adapters.model import Message, MessageSchema
from rosld.ontology.coercion import RANGES
from rosld.ontology.lift import LiftSettings, lifter
from rosld.ontology.lower import lowerer
from rosld.ontology.urls import TYPES, Space
from rosld.ontology.vocab import sh, xsd
from rosld.shapes.limits import Limits, read_limits
from rosld.shapes.value import Bounds
from tests.shapes.values import LIBRARIES, compiled, schema_of, typed, validate
from tests.shapes.values import graph as by_rdflib

SPACE = Space("http://127.0.0.1:8080/")
URL = SPACE.topic("/cmd_vel")
PREFIXES = f"""
@prefix sh: <http://www.w3.org/ns/shacl#> . @prefix xsd: <http://www.w3.org/2001/XMLSchema#> .
@prefix rdf: <http://www.w3.org/1999/02/22-rdf-syntax-ns#> . @prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
@prefix g: <{TYPES}geometry_msgs/msg/> . @prefix twist: <{TYPES}geometry_msgs/msg/Twist#> .
@prefix vector: <{TYPES}geometry_msgs/msg/Vector3#> . @prefix t: <{TYPES}test_msgs/msg/> .
@prefix all: <{TYPES}test_msgs/msg/All#> . @prefix point: <{TYPES}geometry_msgs/msg/Point#> .
"""
ALL = """
bool flag
int8 tiny
uint64 unsigned
float32 single
float64 double
string text
duration span
geometry_msgs/Point point
geometry_msgs/Point[] points
float64[3] triple
string[] words
uint8[] bytes
"""


LIBRARIES[1].learn_message("test_msgs/msg/All", ALL)
TWIST = schema_of("geometry_msgs/msg/Twist")


def graph(turtle: str) -> tuple[Triple, ...]:
    return read_limits((PREFIXES + turtle).encode(), SPACE.base)


def limits(*turtle: str) -> Limits:
    return Limits.from_graphs([graph(each) for each in turtle], SPACE)


def message(schema: MessageSchema, values: Mapping[str, object]) -> Message:
    """Return a message with `values` by dotted path and defaults elsewhere."""
    nested: dict[str, object] = {}
    for path, value in values.items():
        *parts, last = path.split(".")
        inner = nested
        for part in parts:
            inner = inner.setdefault(part, {})  # type: ignore[assignment]
        inner[last] = value
    return lowerer(schema).from_json(nested, defaults=True)


def twist(**values: object) -> Message:
    return message(TWIST, {key.replace("_", "."): value for key, value in values.items()})


def broken(given: Limits, schema: MessageSchema, value: Message) -> list[tuple[str, str]]:
    check = given.message(schema)
    assert check is not None
    return [(each.path, each.message) for each in check(value, URL, "#message")]


SPEED = "<#fast> a sh:NodeShape ; sh:targetClass g:Vector3 ; sh:property [ sh:path vector:x ; %s ] ."
NESTED = """<#fast> a sh:NodeShape ; sh:targetClass g:Twist ; sh:property [ sh:path twist:linear ;
  sh:property [ sh:path vector:x ; sh:minInclusive 0 ; sh:maxInclusive 1000 ] ] ."""


# By type


def test_a_violation_tells_the_dotted_path_the_bound_and_all_that_a_report_needs() -> None:
    given = limits(NESTED)
    assert given.message(schema_of("std_msgs/msg/String")) is None
    assert broken(given, TWIST, twist(linear_x=1000.0, linear_y=5000.0)) == []
    check = given.message(TWIST)
    assert check is not None
    (one,) = check(twist(linear_x=1000.5), URL, "#message")
    assert (one.path, one.message, one.value) == ("linear.x", "must be at most 1000", "1000.5")
    assert one.component == NamedNode(sh.iri + "MaxInclusiveConstraintComponent")
    assert one.focus == NamedNode(URL + "#message.linear")
    assert one.predicate == NamedNode(f"{TYPES}geometry_msgs/msg/Vector3#x")
    assert one.term == Literal("1000.5", datatype=xsd.double)


def test_a_limit_holds_for_each_message_of_an_array() -> None:
    given = limits("<#p> sh:targetClass g:Point ; sh:property [ sh:path point:y ; sh:minInclusive 0 ] .")
    points = [{"y": 1.0}, {"y": -1.0}, {}]
    assert given.bounds_of_message(schema_of("test_msgs/msg/All")).keys() == {"point.y", "points.y"}
    value = message(schema_of("test_msgs/msg/All"), {"points": points, "point.y": -2.0})
    assert broken(given, schema_of("test_msgs/msg/All"), value) == [
        ("point.y", "must be at least 0"),
        ("points.1.y", "must be at least 0"),
    ]


def test_a_float32_is_judged_by_its_own_digits() -> None:
    given = limits("<#s> sh:targetClass t:All ; sh:property [ sh:path all:single ; sh:maxInclusive 1e-1 ] .")
    schema = schema_of("test_msgs/msg/All")
    assert not broken(given, schema, message(schema, {"single": float(np.float32(0.1))}))
    assert broken(given, schema, message(schema, {"single": float(np.float32(0.11))}))


STRING = f"""<#s> sh:targetClass <{TYPES}std_msgs/msg/String> ;
  sh:property [ sh:path <{TYPES}std_msgs/msg/String#data> ; %s ] ."""


def test_a_text_that_is_not_utf_8_is_judged_as_it_is_lifted() -> None:
    schema = schema_of("std_msgs/msg/String")
    given = limits(STRING % 'sh:in ( "on" "off" )')
    assert broken(given, schema, schema.codec.build(schema.ref.name, {"data": "\udcff"})) == [
        ("data", 'must be one of "on", "off"')
    ]
    assert broken(given, schema, message(schema, {"data": "off"})) == []


def test_large_values_are_judged_whole() -> None:
    schema = schema_of("std_msgs/msg/String")
    given = limits(STRING % "sh:maxLength 100000 ; sh:datatype xsd:string")
    assert broken(given, schema, message(schema, {"data": "a" * 100_000})) == []
    assert len(broken(given, schema, message(schema, {"data": "a" * 100_001}))) == 1


def test_a_limit_on_a_field_that_the_type_has_not_lets_nothing_pass() -> None:
    given = limits("<#typo> sh:targetClass g:Twist ; sh:property [ sh:path twist:linaer ; sh:maxCount 0 ] .")
    ((_, words),) = broken(given, TWIST, twist())
    assert "'linaer'" in words
    assert "--shapes" in words


# By resource


def test_bounds_of_a_message_are_by_dotted_path_and_merged() -> None:
    given = limits(NESTED, SPEED % "sh:maxInclusive 2000 ; sh:minInclusive -1")
    assert given.bounds_of_message(TWIST) == {
        "linear.x": Bounds(minimum=typed("0", xsd.integer), maximum=typed("1000", xsd.integer)),
        "angular.x": Bounds(minimum=typed("-1", xsd.integer), maximum=typed("2000", xsd.integer)),
    }
    assert given.bounds_of_message(schema_of("std_msgs/msg/String")) == {}


# Invalid limits


@pytest.mark.parametrize(
    ("turtle", "words"),
    [
        ("<#l> a sh:NodeShape ; sh:property [ sh:path rdf:value ; sh:maxInclusive 1 ] .", "limits nothing"),
        ("<#l> sh:targetSubjectsOf rdf:value ; sh:nodeKind sh:IRI .", "targetSubjectsOf"),
        ("<#l> sh:targetObjectsOf rdf:value ; sh:maxInclusive 1 .", "targetObjectsOf"),
        ("<#l> sh:target [ a sh:SPARQLTarget ] ; sh:maxInclusive 1 ; sh:targetNode <resources/a> .", "only SHACL Core"),
        ("<#l> sh:targetNode <http://elsewhere/resources/a> ; sh:nodeKind sh:IRI .", "relative IRI"),
        ("<#l> sh:targetNode <data/a> ; sh:nodeKind sh:IRI .", "not a resource, topic, service, parameter or node"),
        ("<#l> sh:targetNode <topics/a#message> ; sh:nodeKind sh:IRI .", "not a resource, topic"),
        ('<#l> sh:targetNode "resources/a" ; sh:nodeKind sh:IRI .', "not a resource, topic"),
        ("<#l> sh:targetClass <http://elsewhere/Twist> ; sh:nodeKind sh:IRI .", "not a message type"),
        (f"<#l> sh:targetClass <{TYPES}Twist> ; sh:nodeKind sh:IRI .", "not a message type"),
        ("<#l> sh:targetClass g:Twist ; sh:property [ sh:path vector:x ; sh:maxInclusive 1 ] .", "a field of that"),
        ("<#l> a sh:NodeShape, rdfs:Class ; sh:property [ sh:path vector:x ; sh:maxInclusive 1 ] .", "a message type"),
        ("<#l> sh:targetNode <topics/a> ; sh:property [ sh:maxInclusive 1 ] .", "without a sh:path"),
        ("<#l> sh:targetNode <topics/a> ; sh:property [ sh:path rdf:value ; sh:maxInlcusive 1 ] .", "sh:maxInlcusive"),
        ("<#l> sh:targetNode <topics/a> ; sh:node <#m> .", "not described in this graph"),
    ],
)  # fmt: skip
def test_limits_that_could_not_be_held_are_refused_with_a_sentence(turtle: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        limits(turtle)


# Comparison with pyshacl


FIELDS = {
    "flag": ("sh:hasValue true", "sh:in ( true )", "sh:datatype xsd:boolean"),
    "tiny": ("sh:minInclusive -5", "sh:maxExclusive 7.5", "sh:in ( 1 2 3 )", 'sh:in ( "3"^^xsd:byte 5 )'),
    "unsigned": ("sh:maxInclusive 18446744073709551614", "sh:minExclusive 1e0"),
    "single": ("sh:maxInclusive 0.1", "sh:minInclusive 1e-1", 'sh:hasValue "0.5"^^xsd:float', "sh:datatype xsd:float"),
    "double": ("sh:minInclusive 0 ; sh:maxInclusive 1000", "sh:maxExclusive 0.1", 'sh:in ( "0.1"^^xsd:double 1.0 )'),
    "text": ('sh:in ( "on" "off" )', 'sh:pattern "^o"', "sh:minLength 2 ; sh:maxLength 3", "sh:datatype xsd:string"),
    "point": ("sh:node [ sh:property [ sh:path point:x ; sh:maxInclusive 1 ] ]", "sh:class g:Point",
              "sh:class g:Vector3", "sh:property [ sh:path point:y ; sh:minInclusive 0 ]", "sh:nodeKind sh:IRI"),
    "points": ("sh:nodeKind sh:BlankNodeOrIRI", "sh:hasValue rdf:nil", "sh:not [ sh:class g:Point ]"),
    "triple": ("sh:datatype rdf:JSON", 'sh:pattern "1"'),
    "words": ('sh:pattern "on"', "sh:maxLength 8"),
    "bytes": ("sh:maxLength 4", "sh:datatype xsd:base64Binary"),
}  # fmt: skip
numbers = st.one_of(
    st.sampled_from([0.0, -0.0, 0.1, 0.5, 1.0, 7.5, 1000.0, "INF", "-INF"]),
    st.floats(allow_nan=False, allow_infinity=False),
)
OCTETS = {"@value": "/w==", "@type": xsd.base64Binary.value}
texts = st.sampled_from(["", "on", "off", "toolong", OCTETS, "ü", 'o"n\n'])
messages = st.fixed_dictionaries(
    {},
    optional={
        "flag": st.booleans(),
        "tiny": st.one_of(st.integers(-6, 8), st.integers(*RANGES["int8"])),
        "unsigned": st.one_of(st.integers(0, 3), st.integers(*RANGES["uint64"])),
        "single": st.one_of(st.sampled_from([0.0, 0.1, 0.5, 1e10]), st.floats(-1e30, 1e30)).map(
            lambda each: float(np.float32(each))
        ),
        "double": numbers,
        "text": texts,
        "point.x": numbers,
        "point.y": numbers,
        "points": st.lists(numbers.map(lambda x: {"x": x}), max_size=2),
        "triple": st.lists(numbers, min_size=3, max_size=3),
        "words": st.lists(texts, max_size=3),
        "bytes": st.lists(st.integers(0, 255), max_size=5),
    },
)  # fmt: skip
property_shapes = st.sampled_from(sorted(FIELDS)).flatmap(
    lambda name: st.builds(
        lambda body, extra: f"sh:property [ sh:path all:{name} ; {body} {extra} ]",
        st.sampled_from(FIELDS[name]),
        st.sampled_from(["", "; sh:minCount 1", "; sh:maxCount 1", "; sh:maxCount 0"]),
    )
)
EXTRA = (
    "<#p> sh:targetClass g:Point ; sh:property [ sh:path point:x ; sh:minInclusive 0 ] .",
    """<#q> sh:targetClass t:All ;
      sh:property [ sh:path ( all:points [ sh:zeroOrMorePath rdf:rest ] rdf:first ) ; sh:maxCount 1 ] .""",
    "<#q> sh:targetClass t:All ; sh:property [ sh:path all:double ; sh:lessThan all:single ] .",
    "",
)


@pytest.mark.slow
@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(messages, st.lists(property_shapes, min_size=1, max_size=3), st.sampled_from(EXTRA))
def test_a_verdict_on_a_message_is_that_of_pyshacl(values: dict[str, object], parts: list[str], extra: str) -> None:
    schema = schema_of("test_msgs/msg/All")
    shapes = graph(f"<#l> a sh:NodeShape ; sh:targetClass t:All ; {' ; '.join(parts)} .\n{extra}")
    value = message(schema, values)
    check = Limits.from_graphs([shapes], SPACE).message(schema)
    assert check is not None
    found = {(each.focus, each.predicate, each.component) for each in check(value, URL, "#message")}
    lifted = lifter(schema, LiftSettings(inline_limit=1 << 62)).triples(value, URL, "#message")
    _, report, _ = validate(by_rdflib(lifted), compiled(by_rdflib(shapes)))
    expected = {
        tuple(
            NamedNode(said) if isinstance(said := report.value(result, rdflib.SH[name]), rdflib.URIRef) else None
            for name in ("focusNode", "resultPath", "sourceConstraintComponent")
        )
        for result in report.objects(None, rdflib.SH.result)
    }
    assert found == expected
