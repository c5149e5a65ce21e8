"""Shapes graphs of this server's documents (LDP 4.2.1.6), and the validation of mappings and cockpits by them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from importlib import import_module
from importlib.resources import files
from typing import Any, NamedTuple

from pyoxigraph import BlankNode, Literal, NamedNode, RdfFormat, Triple, parse

from rosld.ontology.body import Term
from rosld.ontology.document import Document
from rosld.ontology.node_shape import NodeShape
from rosld.ontology.vocab import rdf, sh, xsd
from rosld.shapes.shapes_graph import ShapesGraph
from rosld.shapes.terms import TripleView

_MODULES = (
    *("describe_activities", "describe_bags", "describe_body", "describe_faults", "describe_graph", "describe_holds"),
    *("describe_services", "describe_topics", "describe_types", "describe_views", "observations"),
)
"""Modules of the ontology with tables of descriptions."""
MAX_PANELS = 60
"""Maximum number of panels of a cockpit, as in `cockpit.ttl`."""


@cache
def shapes_file(name: str, url: str) -> Document:
    """Return the shapes graph in `NAME.ttl` next to this file, as the document at `url`."""
    text = (files("rosld.shapes") / f"{name}.ttl").read_text("utf-8")
    if name == "documents":
        text = "\n".join((text, *(shape.turtle() for shape in described_shapes().values())))
    return Document(url, tuple(quad.triple for quad in parse(text, RdfFormat.TURTLE, base_iri=url)))


def described_shapes() -> Mapping[str, NodeShape[Any]]:
    """Return the tables of descriptions by the names of their shapes; outlines precede them."""
    modules = (import_module(f"rosld.ontology.{name}") for name in _MODULES)
    return {shape.name: shape for module in modules for shape in vars(module).values() if isinstance(shape, NodeShape)}


_BASE = "https://w3id.org/rosld/shapes/"
_MAX_DIGITS = 20
_OTHER = NamedNode("about:other")


class ValidationResult(NamedTuple):
    """One result of a validation.

    The focus node (of a literal its text) and the predicate (None for the node itself), the shape's message, the
    invalid value (None if it is missing), and the constraint.
    """

    focus: NamedNode | BlankNode | str
    predicate: NamedNode | None
    message: str
    value: str | None
    component: NamedNode | None


@cache
def _shapes(name: str) -> ShapesGraph:
    return ShapesGraph(shapes_file(name, f"{_BASE}{name}").triples)


def validate(triples: Iterable[Triple], name: str) -> Iterator[ValidationResult]:
    """Yield the violations of the shapes graph `NAME.ttl` in triples (without triple terms)."""
    graph, triples = _shapes(name), [Triple(each.subject, each.predicate, _cheap(each.object)) for each in triples]
    view = TripleView(triples)
    targets = {
        (node, focus): None for node, kind, target in graph.targets() for focus in _focus_nodes(kind, target, triples)
    }
    for node, focus in targets:
        for each in graph.shape(node).find_violations(focus, view):
            value = each.term if isinstance(each.term, NamedNode | Literal) and each.term != focus else None
            yield ValidationResult(
                each.focus or _text(focus),
                each.predicate,
                each.quote or each.message,
                None if value is None else value.value,
                each.component,
            )


def _text(focus: Term) -> str:
    return focus.value if isinstance(focus, Literal) else str(focus)


def _focus_nodes(kind: NamedNode, target: Term, triples: Iterable[Triple]) -> Iterator[Term]:
    """Yield the focus nodes of a target (SHACL 2.1.3); subclasses are ignored."""
    for triple in triples:
        if kind == sh.targetClass:
            if triple.predicate == rdf.type and triple.object == target:
                yield triple.subject
        elif triple.predicate == target:
            yield triple.object if kind == sh.targetObjectsOf else triple.subject


def _cheap(term: Term) -> Term:
    """Return a term, with a placeholder for datatypes whose values rdflib may be slow to parse."""
    if not isinstance(term, Literal) or term.language is not None or term.datatype == xsd.string:
        return term
    return (
        term
        if term.datatype == xsd.integer and len(term.value) <= _MAX_DIGITS
        else Literal(term.value, datatype=_OTHER)
    )
