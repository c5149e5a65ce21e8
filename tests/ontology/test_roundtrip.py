"""Round trips: what is lifted, in any syntax that can carry it, lowers back to an equal message."""

from __future__ import annotations

import json
import re
from collections.abc import Callable

import pyoxigraph as ox
import pytest
import rdflib
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rosld.adapters.model import Encoding, Message, MessageSchema
from rosld.ontology.body import parse_body
from rosld.ontology.document import Envelope
from rosld.ontology.lift import TYPES, Lifter, lifter
from rosld.ontology.lower import find_message, lowerer, parse_json

Strategy = Callable[[MessageSchema, int], st.SearchStrategy[Message]]
Equal = Callable[[object, object], bool]
FindSchema = Callable[[int, str], MessageSchema]

DOCUMENT = "http://127.0.0.1:8080/topics/some/thing"
ENVELOPE = Envelope(1_700_000_000_123_000_000, 18446744073709551616, "http://127.0.0.1:8080/nodes/n")
NOT_XML = re.compile("[\x00-\x08\x0b\x0c\r\x0e-\x1f\ufffe\uffff]")
QUICK = settings(
    max_examples=4,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow, HealthCheck.data_too_large],
)


def turtle(lift: Lifter, message: Message) -> bytes:
    prefixes = "".join([f"@prefix {prefix}: <{iri}> .\n" for prefix, iri in lift.prefixes.items()])
    return f"@base <{DOCUMENT}> .\n{prefixes}{lift.turtle(message, DOCUMENT, '#message', envelope=ENVELOPE)}".encode()


def jsonld(lift: Lifter, message: Message) -> bytes:
    node = lift.jsonld(message, DOCUMENT, "#message", envelope=ENVELOPE)
    return f'{{"@context":{json.dumps(dict(lift.context))},{node[1:]}'.encode()


def nquads(lift: Lifter, message: Message) -> bytes:
    end = f" <{DOCUMENT}> .\n"
    return lift.ntriples(message, DOCUMENT, "#message", end=end, envelope=ENVELOPE).encode()


def ntriples(lift: Lifter, message: Message) -> bytes:
    return lift.ntriples(message, DOCUMENT, "#message", envelope=ENVELOPE).encode()


def rdfxml(lift: Lifter, message: Message) -> bytes | None:
    """By pyoxigraph; None where the message holds what XML 1.0 cannot."""
    triples = lift.triples(message, DOCUMENT, "#message", envelope=ENVELOPE)
    if any(NOT_XML.search(triple.object.value) for triple in triples if isinstance(triple.object, ox.Literal)):
        return None
    return ox.serialize(triples, format=ox.RdfFormat.RDF_XML)


SYNTAXES: dict[str, Callable[[Lifter, Message], bytes | None]] = {
    "text/turtle": turtle,
    "text/n3": turtle,
    "application/trig": turtle,
    "application/ld+json": jsonld,
    "application/n-triples": ntriples,
    "application/n-quads": nquads,
    "application/rdf+xml": rdfxml,
}


def canonical(triples: list[ox.Triple]) -> set[ox.Quad]:
    dataset = ox.Dataset([ox.Quad(*triple) for triple in triples])
    dataset.canonicalize(ox.CanonicalizationAlgorithm.UNSTABLE)
    return set(dataset)


def parsed(body: bytes, form: ox.RdfFormat) -> set[ox.Quad]:
    return canonical([quad.triple for quad in ox.parse(body, form, base_iri=DOCUMENT)])


@QUICK
@given(data=st.data())
def test_every_message_lowers_from_every_syntax_to_its_equal(
    stored_type: tuple[int, str], data: st.DataObject, find_schema: FindSchema, messages: Strategy, equal: Equal
) -> None:
    version, name = stored_type
    schema = find_schema(version, name)
    message = data.draw(messages(schema, version))
    lift, lower = lifter(schema), lowerer(schema)
    for media_type, write in SYNTAXES.items():
        text = write(lift, message)
        if text is not None:
            body = parse_body(text, media_type, DOCUMENT)
            root = find_message(body, DOCUMENT, TYPES + name)
            assert equal(message, lower.from_graph(body, root, DOCUMENT)), media_type
    lowered = lower.from_json(parse_json(lift.json(message, DOCUMENT)))
    assert equal(message, lowered)
    encoding = Encoding.ROS1 if version == 1 else Encoding.CDR
    assert schema.codec.encode(lowered, encoding) == schema.codec.encode(message, encoding) or has_nan(lift, message)


def has_nan(lift: Lifter, message: Message) -> bool:
    """Whether bytes may differ: there are many NaNs, and RDF has one."""
    return b'"NaN"' in lift.json(message, DOCUMENT)


@QUICK
@given(data=st.data())
def test_all_syntaxes_say_the_same_triples(
    stored_type: tuple[int, str], data: st.DataObject, find_schema: FindSchema, messages: Strategy
) -> None:
    version, name = stored_type
    schema = find_schema(version, name)
    message = data.draw(messages(schema, version))
    lift = lifter(schema)
    said = canonical(lift.triples(message, DOCUMENT, "#message", envelope=ENVELOPE))
    assert parsed(ntriples(lift, message), ox.RdfFormat.N_TRIPLES) == said
    assert parsed(turtle(lift, message), ox.RdfFormat.TURTLE) == said
    assert parsed(jsonld(lift, message), ox.RdfFormat.JSON_LD) == said


@pytest.mark.parametrize(
    ("version", "name"),
    [
        (1, "geometry_msgs/msg/Twist"),
        (1, "sensor_msgs/msg/JointState"),
        (1, "diagnostic_msgs/msg/DiagnosticArray"),
        (1, "std_msgs/msg/Empty"),
        (1, "tf2_msgs/msg/TFMessage"),
        (2, "sensor_msgs/msg/BatteryState"),
        (2, "rcl_interfaces/msg/ParameterEvent"),
    ],
)
@settings(QUICK, max_examples=15)
@given(data=st.data())
def test_rdflib_reads_the_same_triples(
    version: int, name: str, data: st.DataObject, find_schema: FindSchema, messages: Strategy
) -> None:
    schema = find_schema(version, name)
    message = data.draw(messages(schema, version))
    lift = lifter(schema)
    said = parsed(ntriples(lift, message), ox.RdfFormat.N_TRIPLES)
    assert by_rdflib(turtle(lift, message), "turtle") == said
    assert by_rdflib(jsonld(lift, message), "json-ld") == said


def by_rdflib(body: bytes, form: str) -> set[ox.Quad]:
    """The triples as rdflib reads them, with its own normalisation of literals switched off."""
    normalize, rdflib.NORMALIZE_LITERALS = rdflib.NORMALIZE_LITERALS, False
    try:
        graph = rdflib.Graph().parse(data=body.decode(), format=form, publicID=DOCUMENT)
        return canonical([ox.Triple(*map(term, triple)) for triple in graph])  # type: ignore[arg-type]
    finally:
        rdflib.NORMALIZE_LITERALS = normalize


def term(node: rdflib.term.Node) -> ox.NamedNode | ox.BlankNode | ox.Literal:
    if isinstance(node, rdflib.BNode):
        return ox.BlankNode(str(node))
    if isinstance(node, rdflib.Literal):
        return ox.Literal(str(node), datatype=None if node.datatype is None else ox.NamedNode(str(node.datatype)))
    return ox.NamedNode(str(node))
