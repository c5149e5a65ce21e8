"""Entailments of data and ontologies by OWL 2 RL, and contradictions in them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import combinations
from pathlib import Path

from pyoxigraph import RdfFormat, Triple, serialize
from rdflib import OWL, RDF, RDFS, XSD, Graph, Literal, URIRef
from rdflib.collection import Collection
from rdflib.term import Node
from reasonable import PyReasoner

from rosld.ontology.modules import MODULES, module_triples

VOCABULARIES = Path(__file__).parent / "vocabularies"
# An object property in W3C's ontology of Thing Descriptions, whose values are strings by W3C's context and shapes.
_NAMES_OF_SCHEMES = URIRef("https://www.w3.org/2019/wot/td#hasSecurityConfiguration")
_DERIVED = {
    XSD.integer: {
        *(XSD.long, XSD.int, XSD.short, XSD.byte, XSD.nonNegativeInteger, XSD.positiveInteger, XSD.unsignedLong),
        *(XSD.unsignedInt, XSD.unsignedShort, XSD.unsignedByte),
    },
    XSD.decimal: {XSD.integer},
}


def ontologies() -> Graph:
    """Return every module of the ontology, and the vocabularies of others that they are aligned with."""
    graph = of_triples(triple for name in MODULES for triple in module_triples(name))
    for path in sorted(VOCABULARIES.glob("*.ttl")):
        graph.parse(path)
    return graph


def of_triples(triples: Iterable[Triple]) -> Graph:
    """Return the triples as a graph of rdflib."""
    return Graph().parse(data=serialize(triples, format=RdfFormat.N_TRIPLES), format="nt")


def closure(graph: Graph) -> Graph:
    """Return all entailments by the rules of OWL 2 RL."""
    reasoner, found = PyReasoner(), Graph()
    reasoner.from_graph(graph)
    for triple in reasoner.reason():
        found.add(triple)
    return found


def contradictions(graph: Graph) -> list[str]:
    """Return the contradictions in a closed graph, including those that the reasoner does not check."""
    judges = (_nothing, _disjoint, _equal_and_different, _several, _of_other_kinds)
    return [each for judge in judges for each in judge(graph)]


def _nothing(graph: Graph) -> Iterator[str]:
    yield from (f"{each} is an owl:Nothing" for each in graph.subjects(RDF.type, OWL.Nothing))


def _disjoint(graph: Graph) -> Iterator[str]:
    """Yield cax-dw and cax-adc: instances of two disjoint classes."""
    pairs = set(graph.subject_objects(OWL.disjointWith))
    for each in graph.subjects(RDF.type, OWL.AllDisjointClasses):
        pairs |= set(combinations(_members(graph, each, OWL.members), 2))
    for one, other in pairs:
        for each in set(graph.subjects(RDF.type, one)) & set(graph.subjects(RDF.type, other)):
            yield f"{each} is both {one} and {other}"


def _equal_and_different(graph: Graph) -> Iterator[str]:
    """Yield eq-diff1 to eq-diff3: resources that are both equal and different."""
    for one, other in _different(graph):
        if (one, OWL.sameAs, other) in graph or (other, OWL.sameAs, one) in graph:
            yield f"{one} is {other}, from which it differs"


def _different(graph: Graph) -> set[tuple[Node, Node]]:
    pairs = set(graph.subject_objects(OWL.differentFrom))
    for each in graph.subjects(RDF.type, OWL.AllDifferent):
        pairs |= set(combinations(_members(graph, each, OWL.distinctMembers), 2))
    return pairs


def _several(graph: Graph) -> Iterator[str]:
    """Yield prp-fp: several values of a functional property that are known to differ."""
    different = _different(graph)
    for term in graph.subjects(RDF.type, OWL.FunctionalProperty):
        for subject in set(graph.subjects(term, None)):
            values = set(graph.objects(subject, term))
            literals = {each.toPython() for each in values if isinstance(each, Literal)}
            if len(literals) > 1 or any({one, other} <= values for one, other in different):
                yield f"{subject} has {len(values)} values of {term}: {sorted(map(str, values))}"


def _of_other_kinds(graph: Graph) -> Iterator[str]:
    """Yield dt-not-type, and values of the wrong kind: a node for a literal, or a literal for a node."""
    for term in set(graph.subjects(RDF.type, OWL.DatatypeProperty)):
        ranges = [each for each in graph.objects(term, RDFS.range) if str(each).startswith(str(XSD))]
        for subject, value in graph.subject_objects(term):
            if not isinstance(value, Literal):
                yield f"{subject} {term} {value}: no literal"
            elif any(not _is_of(value, each) for each in ranges):
                yield f"{subject} {term} {value.n3()}: not of {ranges}"
    for term in set(graph.subjects(RDF.type, OWL.ObjectProperty)) - {_NAMES_OF_SCHEMES}:
        yield from (f"{s} {term} {o}: a literal" for s, o in graph.subject_objects(term) if isinstance(o, Literal))


def _is_of(value: Literal, datatype: Node) -> bool:
    own = value.datatype or XSD.string
    return own == datatype or own in _below(datatype)


def _below(datatype: Node) -> set[URIRef]:
    direct = _DERIVED.get(datatype, set())  # type: ignore[call-overload]
    return direct.union(*(_below(each) for each in direct))


def _members(graph: Graph, subject: Node, predicate: URIRef) -> list[Node]:
    first = graph.value(subject, predicate)
    return [] if first is None else list(Collection(graph, first))
