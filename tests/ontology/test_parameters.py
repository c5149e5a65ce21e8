"""Parameters to RDF and to plain JSON, and back the same."""

from __future__ import annotations

import math
from datetime import datetime, timedelta, timezone

import orjson
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from rosld.adapters.model import ParameterValue
from rosld.ontology.body import parse_body, parse_json
from rosld.ontology.parameters import (
    lower_json,
    lower_parameter,
    parameter_document,
    parameter_json,
)
from rosld.ontology.serialize import serialize
from rosld.ontology.syntax import Syntax
from rosld.ontology.urls import Space
from rosld.ontology.violations import LoweringError
from rosld.ontology.vocab import PREFIXES

SPACE = Space("http://127.0.0.1:8080/")
NAME = "/robot/wheel"
URL = SPACE.parameter(NAME)

TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=6) | st.sampled_from(
    ["", ".", "..", "a/b", "~", "@value", "@type", "%2F", "\x00", "#", "ü"]
)
ZONES = st.sampled_from([None, timezone.utc, timezone(timedelta(hours=-7, minutes=-30))])
SCALARS: st.SearchStrategy[ParameterValue] = (
    st.booleans()
    | st.integers()
    | st.floats()
    | TEXTS
    | st.binary(max_size=5)
    | st.datetimes(timezones=ZONES, allow_imaginary=False)
)
VALUES: st.SearchStrategy[ParameterValue] = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXTS, inner, max_size=3),
    max_leaves=8,
)


def same(one: ParameterValue, other: ParameterValue) -> bool:
    """Whether values are equal including types and signs: 1 is not 1.0, -0.0 is not 0.0, NaN is NaN."""
    if type(one) is not type(other):
        return False
    if isinstance(one, float) and isinstance(other, float):
        return (math.isnan(one) and math.isnan(other)) or (
            one == other and math.copysign(1, one) == math.copysign(1, other)
        )
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    return one == other


@pytest.mark.parametrize("syntax", [Syntax.TURTLE, Syntax.JSON_LD, Syntax.N_TRIPLES])
@given(VALUES)
@example({"": {}, ".": {"..": []}})
@example([{"@value": "1", "@type": "xsd:integer"}])
@example(-0.0)
@example([2**53 + 1, -(2**70)])
def test_a_value_comes_back_from_rdf(syntax: Syntax, value: ParameterValue) -> None:
    document = parameter_document(NAME, value, SPACE)
    body = parse_body(serialize(document, syntax), syntax.media_type, URL)
    assert same(lower_parameter(body, URL), value)


@given(VALUES)
@example({"@value": 1, "@type": "@json"})
def test_a_value_comes_back_from_plain_json(value: ParameterValue) -> None:
    assert same(lower_json(parse_json(parameter_json(value))), value)


def test_plain_json_is_plain_where_it_can_be() -> None:
    value: ParameterValue = {"gains": [1.5, 2, True, "x"], "limits": {"max": math.inf}, "data": b"\x00"}
    assert orjson.loads(parameter_json(value)) == {
        "gains": [1.5, 2, True, "x"],
        "limits": {"max": {"@value": "INF", "@type": "xsd:double"}},
        "data": {"@value": "AA==", "@type": "xsd:base64Binary"},
    }


def lowered(turtle: str) -> ParameterValue:
    prefixes = "".join(f"@prefix {prefix}: <{iri}> ." for prefix, iri in PREFIXES.items())
    return lower_parameter(parse_body(f"{prefixes} {turtle}".encode(), "text/turtle", URL), URL)


@pytest.mark.parametrize(
    ("turtle", "value"),
    [
        ("<> ros:value 1 .", 1),
        ("<> ros:value 1.5 .", 1.5),
        ("<> ros:value 1e0 .", 1.0),
        ('<> ros:value "7"^^xsd:byte .', 7),
        ('<> ros:value "1"^^xsd:boolean .', True),
        ("<http://elsewhere/> a ros:Parameter ; ros:value 3 .", 3),
        ("<http://elsewhere/> ros:value 3 .", 3),
        (
            '<> ros:value "2026-01-31T12:00:00.5Z"^^xsd:dateTime .',
            datetime(2026, 1, 31, 12, microsecond=500000, tzinfo=timezone.utc),
        ),
        ("<> a ldp:BasicContainer .", {}),
        ("<wheel/> ldp:contains <wheel/radius> . <wheel/radius> ros:value 0.25 .", {"radius": 0.25}),
    ],
)
def test_what_a_person_would_write_is_understood(turtle: str, value: ParameterValue) -> None:
    assert same(lowered(turtle), value)


@pytest.mark.parametrize(
    ("turtle", "words"),
    [
        ("", "expected one parameter"),
        ("<> ros:name 'x' .", "expected an ros:value"),
        ("<> ros:value 1, 2 .", "expected one ros:value, not 2"),
        ("<> ros:value <x> .", "expected a literal"),
        ("<> ros:value 'x'@en .", "omit the language tag"),
        ('<> ros:value "x"^^xsd:integer .', "valid xsd:integer"),
        ('<> ros:value "300"^^xsd:byte .', "valid xsd:byte"),
        ('<> ros:value "A"^^xsd:base64Binary .', "xsd:base64Binary"),
        ('<> ros:value "2026-13-01T00:00:00"^^xsd:dateTime .', "xsd:dateTime"),
        ('<> ros:value "2026-01-01T00:00:00.0000001Z"^^xsd:dateTime .', "microsecond"),
        ('<> ros:value "x"^^<http://h/dt> .', "no parameter has the datatype"),
        ('<> ros:value "[1,"^^rdf:JSON .', "this rdf:JSON cannot be read"),
        ('<> ros:value "{}"^^rdf:JSON .', "a dict is written as a container"),
        ('<> ros:value "[null]"^^rdf:JSON .', "cannot be null"),
        ("<> ros:value 1 ; ldp:contains <wheel/a> .", "not both"),
        ("<> ldp:contains <http://elsewhere/a> .", "lie directly in"),
        ("<> ldp:contains <wheel/a/b> .", "lie directly in"),
        ("<> ldp:contains <wheel/a> .", "expected an ros:value"),
        ("<> ldp:contains <> .", "lie directly in"),
    ],
)
def test_what_does_not_fit_is_named(turtle: str, words: str) -> None:
    with pytest.raises(LoweringError, match=words):
        lowered(turtle)


def test_the_path_of_a_misfit_is_told() -> None:
    with pytest.raises(LoweringError) as caught:
        lowered("<> ldp:contains <wheel/a> . <wheel/a> ros:value <x> .")
    assert caught.value.violations[0].path == "a"
    with pytest.raises(LoweringError) as caught:
        lower_json({"a": [1, {"b": None}]})
    assert caught.value.violations[0].path == "a.1.b"


@pytest.mark.parametrize("value", [None, {"@value": 1, "@type": "xsd:double"}, {"@value": "x", "@type": "xsd:double"}])
def test_json_that_is_no_parameter_is_refused(value: object) -> None:
    with pytest.raises(LoweringError):
        lower_json(value)


def test_what_is_nested_too_deep_is_refused() -> None:
    deep: ParameterValue = 1
    for _ in range(100):
        deep = [deep]
    with pytest.raises(ValueError, match="deeper"):
        parameter_json(deep)
    with pytest.raises(LoweringError, match="deeper"):
        lower_json(deep)
