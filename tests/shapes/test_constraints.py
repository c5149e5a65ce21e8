"""Node shapes, compiled and judged by pyshacl: one verdict, and nothing malformed gets as far as judging."""

from __future__ import annotations

import time
from collections.abc import Sequence

import pyshacl
import pytest
import rdflib
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from pyoxigraph import BlankNode, Literal, NamedNode, RdfFormat, Triple, parse, serialize

from rosld.ontology.vocab import sh, xsd
from rosld.shapes.constraints import NodeShape, node_shape

SHAPE = NamedNode("http://h/mapping#shape")
FOCUS = NamedNode("http://h/resources/engine/")
PREFIXES = """
@prefix sh: <http://www.w3.org/ns/shacl#> . @prefix xsd: <http://www.w3.org/2001/XMLSchema#> .
@prefix rdf: <http://www.w3.org/1999/02/22-rdf-syntax-ns#> . @prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
@prefix : <http://h/mapping#> . @prefix ex: <http://h/v#> .
"""


def triples(turtle: str) -> list[Triple]:
    return [quad.triple for quad in parse(PREFIXES + turtle, RdfFormat.TURTLE, base_iri="http://h/")]


def compiled(turtle: str) -> NodeShape:
    return node_shape(triples(turtle), SHAPE)


def graph(given: Sequence[Triple]) -> rdflib.Graph:
    text = serialize(list(dict.fromkeys(given)), format=RdfFormat.N_TRIPLES)
    assert text is not None
    return rdflib.Graph().parse(text, format="nt")


Results = set[tuple[str | None, ...]]


def by_pyshacl(shapes: Sequence[Triple], data: Sequence[Triple]) -> tuple[bool, Results]:
    """The verdict of pyshacl with its defaults, by way of N-Triples: conforms, and focus, path and component of each."""
    targeted = [*shapes, Triple(SHAPE, sh.targetNode, FOCUS)]
    conforms, report, words = pyshacl.validate(graph(data), shacl_graph=graph(targeted))
    assert isinstance(report, rdflib.Graph), words
    names = ("focusNode", "resultPath", "sourceConstraintComponent")
    found: Results = set()
    for result in report.objects(None, rdflib.SH.result):
        said = [report.value(result, rdflib.SH[name]) for name in names]
        found.add(tuple(str(each) if isinstance(each, rdflib.URIRef) else None for each in said))
    return bool(conforms), found


def by_rosld(shape: NodeShape, data: Sequence[Triple]) -> tuple[bool, Results]:
    violations = shape.violations(FOCUS, data)
    found: Results = set()
    for each in violations:
        focus = each.focus if isinstance(each.focus, NamedNode) else None
        terms = (focus, each.predicate, each.component)
        found.add(tuple(None if term is None else term.value for term in terms))
    return not violations, found


# Random shapes, random data


def typed(datatype: str, texts: Sequence[str]) -> st.SearchStrategy[Literal]:
    return st.sampled_from(texts).map(lambda text: Literal(text, datatype=NamedNode(xsd.iri + datatype)))


NUMBERS = ["0", "1", "01", "-1", "+1", "5", "1000", "300", "-0"]
FLOATS = ["0", "0.0", "-0.0", "1", "1.0", "1e0", "0.1", "5.5", "1e3", "INF", "-INF", "1000.0000001"]
literals = st.one_of(
    typed("integer", NUMBERS),
    typed("int", NUMBERS),
    typed("byte", ["0", "1", "01", "-1", "5"]),
    typed("unsignedByte", ["0", "1", "255"]),
    typed("unsignedLong", ["0", "1", "18446744073709551615"]),
    typed("long", [*NUMBERS, "99999999999999999999"]),
    typed("double", FLOATS),
    typed("float", FLOATS),
    typed("decimal", ["0", "0.0", "1.0", "0.1", "5.5", "1000", "-1.50"]),
    typed("boolean", ["true", "false", "1", "0"]),
    typed("dateTime", ["2026-01-01T00:00:00Z", "2026-01-01T01:00:00+01:00", "2026-01-01T00:00:00", "2027-01-01T00:00:00Z"]),
    typed("date", ["2026-01-01", "2026-06-01"]),
    typed("base64Binary", ["", "AA==", "AAAA"]),
    typed("string", ["", "on", "off", "1", "On", "0.0", "x\ny", "ü"]),
    st.sampled_from(["on", "off"]).map(lambda text: Literal(text, language="en")),
    st.just(Literal("on", language="de")),
    st.sampled_from(["[]", "[1,2]"]).map(lambda text: Literal(text, datatype=NamedNode("http://h/json"))),
)
ill_typed = st.one_of(typed("double", ["abc", ""]), typed("int", ["3000000000", "1.0"]), typed("byte", ["300"]), typed("unsignedByte", ["-1"]),
                      typed("dateTime", ["now"]), typed("boolean", ["TRUE", "yes"]))  # fmt: skip
NODES = [FOCUS, *(NamedNode(f"http://h/n{number}") for number in range(2)), BlankNode("b")]
PREDICATES = [NamedNode(f"http://h/v#{name}") for name in "pq"]
TYPE = NamedNode("http://www.w3.org/1999/02/22-rdf-syntax-ns#type")
BELOW = NamedNode("http://www.w3.org/2000/01/rdf-schema#subClassOf")
CLASSES = [NamedNode("http://h/v#A"), NamedNode("http://h/v#B")]
values = st.one_of(literals, literals, ill_typed, st.sampled_from(NODES))
data_graphs = st.lists(
    st.one_of(
        st.builds(Triple, st.just(FOCUS), st.sampled_from(PREDICATES), values),
        st.builds(Triple, st.just(FOCUS), st.sampled_from(PREDICATES), values),
        st.builds(Triple, st.sampled_from(NODES), st.sampled_from(PREDICATES), values),
        st.builds(Triple, st.sampled_from(NODES), st.just(TYPE), st.sampled_from(CLASSES)),
        st.builds(Triple, st.sampled_from(CLASSES), st.just(BELOW), st.sampled_from(CLASSES)),
    ),
    max_size=8,
)


def n3(term: object) -> str:
    return str(term)


def statement(name: str, value: st.SearchStrategy[object]) -> st.SearchStrategy[str]:
    return value.map(lambda each: f"sh:{name} {each}")


def listed(of: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    return st.lists(of, min_size=1, max_size=3).map(lambda each: f"( {' '.join(each)} )")


terms = st.one_of(literals, st.sampled_from(NODES[:3])).map(n3)
PLAIN = (
    *(statement(f"{end}{kind}clusive", literals) for end in ("min", "max") for kind in ("In", "Ex")),
    statement("hasValue", terms),
    statement("in", listed(terms)),
    statement("minLength", st.integers(0, 4)),
    statement("maxLength", st.integers(0, 4)),
    statement("pattern", st.sampled_from(['"o"', '"^on$"', '"^[0-9.]+$"', '"O" ; sh:flags "i"', '"http"', '"^y" ; sh:flags "m"'])),
    statement("datatype", st.sampled_from("integer int byte long double float decimal boolean string dateTime date".split())
              .map(lambda name: f"xsd:{name}")),
    statement("datatype", st.sampled_from(["rdf:langString", "rdfs:Literal", "<http://h/json>"])),
    statement("nodeKind", st.sampled_from("IRI Literal BlankNode BlankNodeOrIRI BlankNodeOrLiteral IRIOrLiteral".split())
              .map(lambda name: f"sh:{name}")),
    statement("class", st.sampled_from(["ex:A", "ex:B"])),
    st.sampled_from(["sh:severity sh:Warning", "sh:severity sh:Info", 'sh:message "no"', "sh:deactivated false"]),
)  # fmt: skip
_ONCE = ("in", "minLength", "maxLength", "datatype", "nodeKind", "severity", "deactivated", "minCount", "maxCount", "pattern",
         "closed", "uniqueLang", "languageIn")  # fmt: skip


def bodies(*parts: st.SearchStrategy[str], least: int = 0) -> st.SearchStrategy[str]:
    """Statements, of each of those that may be there once only one."""
    return st.lists(st.one_of(*parts), min_size=least, max_size=3, unique_by=lambda text: (
        name if (name := text.split()[0].removeprefix("sh:")) in _ONCE else text
    )).map(" ; ".join)  # fmt: skip


def wrapped(body: str) -> str:
    return f"[ {body} ]" if body else "[ a sh:NodeShape ]"


def with_path(path: st.SearchStrategy[str], body: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    return st.builds(lambda to, rest: f"[ sh:path {to} {';' if rest else ''} {rest} ]", path, body)


COUNTS = (statement("minCount", st.integers(0, 2)), statement("maxCount", st.integers(0, 2)))
simple_paths = st.sampled_from(["ex:p", "ex:q"])


def inner(parts: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    property_shapes = with_path(simple_paths, st.one_of(bodies(*PLAIN, *COUNTS), parts))
    node_shapes = st.one_of(bodies(*PLAIN), parts).map(wrapped)
    either = st.one_of(property_shapes, node_shapes)
    logic = (statement(name, listed(either)) for name in ("and", "or", "xone"))
    nested = (statement("property", property_shapes), statement("node", node_shapes), statement("not", either), *logic)
    return bodies(*PLAIN, *nested, *nested, least=1)


shape_bodies = st.recursive(bodies(*PLAIN), inner, max_leaves=4)


@settings(max_examples=300, deadline=None, suppress_health_check=list(HealthCheck))
@given(shape_bodies, data_graphs)
@example("sh:property [ sh:path ex:p ; sh:maxInclusive 0 ]", triples("<resources/engine/> ex:p '0.0'^^xsd:double ."))
def test_a_compiled_verdict_is_that_of_pyshacl(body: str, data: list[Triple]) -> None:
    shapes = triples(f":shape a sh:NodeShape {';' if body else ''} {body} .")
    shape = node_shape(shapes, SHAPE)
    assert by_rosld(shape, data) == by_pyshacl(shapes, data)
