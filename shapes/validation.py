"""Validation of mappings and cockpits by their shapes graphs."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from typing import NamedTuple

import pyshacl
import rdflib
from pyoxigraph import BlankNode, Literal, NamedNode, Triple
from rdflib.namespace import SH

from rosld.ontology.vocab import rdfs, xsd
from rosld.shapes.documents import shapes_file

_BASE = "https://w3id.org/rosld/shapes/"
_MAX_DIGITS = 20
_OTHER = rdflib.URIRef("about:other")


class ValidationResult(NamedTuple):
    """One result of a validation.

    The node it is about (of a literal its text) and the predicate (None: the node itself), what the shape says of it,
    the value that is wrong (None where one is missing), and the constraint.
    """

    focus: NamedNode | BlankNode | str
    predicate: NamedNode | None
    message: str
    value: str | None
    component: NamedNode


@cache
def _shapes(name: str) -> rdflib.Graph:
    return _graph(shapes_file(name, f"{_BASE}{name}").triples, exact=True)


def validate(triples: Iterable[Triple], name: str) -> list[ValidationResult]:
    """Return the violations of the shapes graph `NAME.ttl` in triples (none of them with a triple term)."""
    conforms, report, _ = pyshacl.validate(_graph(triples), shacl_graph=_shapes(name))
    if conforms:
        return []
    assert isinstance(report, rdflib.Graph)
    top = report.objects(report.value(predicate=rdflib.RDF.type, object=SH.ValidationReport), SH.result)
    return [_misfit(report, result) for result in top]


def _misfit(report: rdflib.Graph, result: rdflib.term.Node) -> ValidationResult:
    focus = report.value(result, SH.focusNode)
    path = report.value(result, SH.resultPath)
    value = report.value(result, SH.value)
    return ValidationResult(
        NamedNode(focus) if isinstance(focus, rdflib.URIRef)
        else BlankNode(focus) if isinstance(focus, rdflib.BNode)
        else str(focus),
        NamedNode(path) if isinstance(path, rdflib.URIRef) else None,
        str(report.value(result, SH.resultMessage)),
        None if value is None or value == focus or isinstance(value, rdflib.BNode) else str(value),
        NamedNode(str(report.value(result, SH.sourceConstraintComponent))),
    )  # fmt: skip


def _graph(triples: Iterable[Triple], *, exact: bool = False) -> rdflib.Graph:
    """Return the triples for pyshacl. Unless `exact`, it sees as much of a stranger's document as the shape asks about:

    subclasses, which it would follow however long their chains, are left out, and a datatype but xsd:string, or that of
    a short integer, is only told to be another: rdflib would read the value, which costs what a stranger likes it to.
    """
    graph = rdflib.Graph()
    for subject, predicate, object in triples:
        if predicate == rdfs.subClassOf and not exact:
            continue
        graph.add((_term(subject, exact), rdflib.URIRef(predicate.value), _term(object, exact)))
    return graph


def _term(term: NamedNode | BlankNode | Literal | Triple, exact: bool) -> rdflib.term.Node:
    if isinstance(term, NamedNode):
        return rdflib.URIRef(term.value)
    if isinstance(term, BlankNode):
        return rdflib.BNode(term.value)
    if isinstance(term, Triple):
        raise ValueError(f"SHACL 1.0 does not know the triple term {term}")
    if term.language is not None:
        return rdflib.Literal(term.value, lang=term.language)
    is_cheap = term.datatype == xsd.string or (term.datatype == xsd.integer and len(term.value) <= _MAX_DIGITS)
    datatype = rdflib.URIRef(term.datatype.value) if exact or is_cheap else _OTHER
    return rdflib.Literal(term.value, datatype=datatype)
