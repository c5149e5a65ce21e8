"""Lowering accepts exactly the bodies that conform to the shape of writes according to pySHACL, for random bodies."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import pytest
import rdflib
from hypothesis import given, settings
from hypothesis import strategies as st
from pyoxigraph import BlankNode, NamedNode, Triple
from pyshacl.shapes_graph import ShapesGraph

from rosld.adapters.model import MessageSchema
from rosld.ontology.body import index_triples
from rosld.ontology.lift import LiftSettings, lifter
from rosld.ontology.lower import lowerer
from rosld.ontology.urls import Space
from rosld.ontology.violations import LoweringError
from rosld.ontology.vocab import rdf, ros
from rosld.shapes.accepted import accepted_message_document
from rosld.shapes.command_numbers import largest_number, require_finite_message
from rosld.shapes.limit_parts import Demand
from tests.shapes.values import LIBRARIES, LITERALS, compiled, graph, validate

pytestmark = pytest.mark.slow

SPACE = Space("http://127.0.0.1:8080/")
URL = SPACE.topic("/every")
EVERY = """
bool flag
int8 tiny
uint8 octet
int32 whole
uint64 large
float32 single
float64 double
string text
time stamp
duration span
geometry_msgs/Point point
geometry_msgs/Point[] points
geometry_msgs/PoseStamped[2] poses
float64[3] triple
float32[] singles
int16[] numbers
uint64[] larges
string[] words
uint8[] bytes
uint8[5] five
bool[] flags
"""
BOUNDED = "string<=4 text\nstring<=3[<=2] words\nuint8[<=4] bytes\nint64[<=2] numbers\ngeometry_msgs/Point[<=1] points"


@cache
def schema_of(fields: str, ros_version: int) -> MessageSchema:
    return LIBRARIES[ros_version].learn_message(f"test_msgs/msg/T{abs(hash(fields))}", fields)


@cache
def shapes_of(schema: MessageSchema, *, is_command: bool = False) -> ShapesGraph:
    demand = Demand(largest=largest_number(schema) if is_command else None)
    document = accepted_message_document(f"{URL}?shape", schema, SPACE, "What may be written", demand)
    return compiled(graph(document.triples))


def refusal(schema: MessageSchema, triples: Sequence[Triple], *, is_command: bool = False) -> str:
    """Return why lowering, or the check of commands, rejects a body; None if it is accepted."""
    try:
        message = lowerer(schema).from_body(index_triples(triples), URL)
        if is_command:
            require_finite_message(schema, message, "")
    except LoweringError as error:
        return str(error)
    return ""


def violations(schema: MessageSchema, triples: Sequence[Triple]) -> str:
    """Return the violations of the shape by a body."""
    try:
        conforms, _, words = validate(graph(triples), shapes_of(schema))
    except ValueError as error:  # it follows an infinite list
        if "recursive rdf:rest" not in str(error):
            raise
        return str(error)
    return "" if conforms else words


# Candidates for a field

KINDS = [(1, kind) for kind in ("bool", "int8", "uint64", "float32", "float64", "string", "float64[3]", "uint64[]",
         "string[]", "uint8[]", "uint8[5]", "bool[2]")]  # fmt: skip
KINDS += [(2, kind) for kind in ("string<=4", "string<=3[<=2]", "uint8[<=4]", "int64[<=2]")]
COMMANDS = [(1, "float64"), (1, "float64[]"), (2, "float32[<=3]")]


@pytest.mark.parametrize(
    ("ros_version", "kind", "is_command"),
    [*((*each, False) for each in KINDS), *((*each, True) for each in COMMANDS)],
)
def test_a_literal_conforms_where_lowering_takes_it_and_nowhere_else(
    ros_version: int, kind: str, is_command: bool
) -> None:
    schema = schema_of(f"{kind} value", ros_version)
    predicate = NamedNode(SPACE.property_of(schema.ref.name, "value"))
    nodes = {NamedNode(f"http://h/{at}"): each for at, each in enumerate((*LITERALS, NamedNode("http://h/x"), rdf.nil))}
    said = {
        node: [Triple(node, rdf.type, NamedNode(SPACE.class_of(schema.ref.name))), Triple(node, predicate, value)]
        for node, value in nodes.items()
    }
    shapes = shapes_of(schema, is_command=is_command)
    _, report, _ = validate(graph([each for triples in said.values() for each in triples]), shapes)
    assert isinstance(report, rdflib.Graph)
    broken = {str(node) for node in report.objects(None, rdflib.SH.focusNode)}
    by_shape = {str(value) for node, value in nodes.items() if node.value not in broken}
    by_server = {str(value) for node, value in nodes.items() if not refusal(schema, said[node], is_command=is_command)}
    assert by_shape == by_server
    assert by_server
    assert len(by_server) < len(nodes)


# Bodies


FILLED = {1: {"points": [{}, {"x": 1}], "singles": [0.1], "larges": [2**60], "words": ["", "a\"\n"], "double": "INF"},
          2: {"text": "ab", "words": ["", "ab"], "bytes": [1], "numbers": [-1, 2**60], "points": [{}]}}  # fmt: skip


CHANGES = ("literal", "list", "drop", "more", "strange", "managed", "node", "stamp")
literals = st.sampled_from(LITERALS)


@st.composite
def bodies(draw: st.DrawFn, schema: MessageSchema, ros_version: int) -> list[Triple]:
    """Return a message as lifted, with a change or two."""
    message = lowerer(schema).from_json(FILLED[ros_version], defaults=True)
    triples = list(lifter(schema, LiftSettings(inline_limit=1 << 62)).triples(message, URL, "#message"))
    for change in draw(st.lists(st.sampled_from(CHANGES), max_size=2)):
        at = draw(st.integers(0, len(triples) - 1))
        subject, predicate, object = triples[at]
        if change == "drop":
            del triples[at]
        elif change == "literal":
            triples[at] = Triple(subject, predicate, draw(literals))
        elif change == "more":
            triples.append(Triple(subject, predicate, draw(literals)))
        elif change == "strange":
            triples.append(Triple(subject, NamedNode("http://example.org/strange"), object))
        elif change == "managed":
            managed = draw(st.sampled_from([ros.received, ros.sequence, ros.rate, ros.sentBy]))
            triples.append(Triple(subject, managed, draw(literals)))
        elif change == "node":
            triples[at] = Triple(subject, predicate, draw(st.sampled_from([rdf.nil, BlankNode("none"), subject])))
        elif change == "stamp":
            triples.append(Triple(subject, ros.dateTime, draw(literals)))
        else:
            cells = [BlankNode(f"cell{number}") for number in range(draw(st.integers(0, 4)))]
            ends: list[BlankNode | NamedNode] = [*cells, rdf.nil]
            triples[at] = Triple(subject, predicate, ends[0])
            for cell, rest in zip(cells, ends[1:], strict=True):
                triples += [Triple(cell, rdf.first, draw(literals)), Triple(cell, rdf.rest, rest)]
    return triples


@settings(max_examples=10)
@given(bodies(schema_of(EVERY, 1), 1))
def test_a_message_conforms_where_lowering_takes_it_and_nowhere_else(triples: list[Triple]) -> None:
    refused, broken = refusal(schema_of(EVERY, 1), triples), violations(schema_of(EVERY, 1), triples)
    assert bool(refused) == bool(broken), f"{refused}\n{broken}"


@settings(max_examples=20)
@given(bodies(schema_of(BOUNDED, 2), 2))
def test_bounds_of_strings_and_arrays_are_held_too(triples: list[Triple]) -> None:
    refused, broken = refusal(schema_of(BOUNDED, 2), triples), violations(schema_of(BOUNDED, 2), triples)
    assert bool(refused) == bool(broken), f"{refused}\n{broken}"
