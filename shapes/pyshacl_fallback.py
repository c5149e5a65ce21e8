"""Shapes that are not compiled, run by pyshacl: all of SHACL Core, without running code or fetching anything."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence

import rdflib
from pyoxigraph import BlankNode, Literal, NamedNode, Triple
from rdflib.term import BNode, URIRef

from rosld.ontology.body import Term
from rosld.ontology.violations import Violation
from rosld.ontology.vocab import sh
from rosld.shapes.compiled_shape import brief_term, join_path
from rosld.shapes.terms import Node, View, normalize, normalize_graph

_MAX_KEPT = 64
_SHAPES, _DATA = "s", "d"
_TARGET = URIRef(sh.targetNode.value)
_NOWHERE = URIRef("urn:nowhere")


class PyshaclShape:
    """The shape `root`, with everything that it references in `triples`.

    Its patterns see texts of up to `max_length` characters. Raises ValueError for `shapes` that pyshacl cannot read.
    """

    def __init__(
        self,
        root: NamedNode | BlankNode,
        shapes: Sequence[Term],
        triples: Sequence[Triple],
        max_length: int = sys.maxsize,
    ) -> None:
        self._node = root
        self._root = normalize(root, _SHAPES)
        self._graph = normalize_graph(triples, _SHAPES)
        self._longest = max_length
        self._targeted: dict[Node, rdflib.Graph] = {}
        trial = self._with_targets([(normalize(shape, _SHAPES), _NOWHERE) for shape in shapes])
        report = _report(rdflib.Graph(), trial)
        if isinstance(report, str):
            raise ValueError(report)

    def find_violations(self, focus: Term, view: View, above: str = "") -> Iterator[Violation]:
        """Yield each violation that pyshacl finds; an error in pyshacl is a violation too."""
        triples = view.triples()
        for triple in triples:
            if isinstance(triple.object, Literal) and len(triple.object.value) > self._longest:
                yield Violation(above, f"holds a text of more than {self._longest} characters, too long for a pattern")
                return
        terms = {normalize(term, _DATA): term for triple in triples for term in (triple.subject, triple.object)}
        terms[normalize(focus, _DATA)] = focus
        report = _report(normalize_graph(triples, _DATA), self._shapes_for(normalize(focus, _DATA)))
        if isinstance(report, str):
            yield Violation(above, f"cannot be judged: {report}", shape=_iri(self._node))
            return
        results = report.objects(None, _sh("result"))
        found = (_violation(report, each, terms, above, self._graph) for each in results)
        yield from sorted(found, key=lambda one: one.path)

    def _shapes_for(self, focus: Node) -> rdflib.Graph:
        if focus not in self._targeted:
            if len(self._targeted) >= _MAX_KEPT:
                self._targeted.clear()
            self._targeted[focus] = self._with_targets([(self._root, focus)])
        return self._targeted[focus]

    def _with_targets(self, targets: Sequence[tuple[Node, Node]]) -> rdflib.Graph:
        graph = rdflib.Graph()
        graph += self._graph
        for shape, focus in targets:
            graph.add((shape, _TARGET, focus))
        return graph


def _report(data: rdflib.Graph, shapes: rdflib.Graph) -> rdflib.Graph | str:
    """Return the validation report, or the reason why there is none."""
    import pyshacl

    try:
        _, report, words = pyshacl.validate(data, shacl_graph=shapes, advanced=False, js=False, do_owl_imports=False)
    except Exception as error:  # any consequence of a malformed shape
        return f"{type(error).__name__}: {error}"
    return report if isinstance(report, rdflib.Graph) else str(words)


def _sh(name: str) -> URIRef:
    return URIRef(sh.iri + name)


def _iri(term: object) -> NamedNode | None:
    return term if isinstance(term, NamedNode) else NamedNode(str(term)) if isinstance(term, URIRef) else None


def _violation(
    report: rdflib.Graph, result: rdflib.term.Node, terms: dict[Node, Term], above: str, shapes: rdflib.Graph
) -> Violation:
    """Return a result of the report with the original terms of the data."""

    def said(name: str) -> Node | None:
        found = report.value(result, _sh(name))
        return found if isinstance(found, URIRef | BNode | rdflib.Literal) else None

    value, focus, path = said("value"), said("focusNode"), _iri(said("resultPath"))
    term = terms.get(value) if value is not None else None
    node = terms.get(focus) if focus is not None else None
    message = said("resultMessage")
    is_own = (said("sourceShape"), _sh("message"), None) in shapes  # not those of pyshacl
    return Violation(
        above if path is None else join_path(above, path),
        "does not conform" if is_own or message is None else str(message),
        brief_term(term),
        component=_iri(said("sourceConstraintComponent")),
        shape=_iri(said("sourceShape")),
        focus=node if isinstance(node, NamedNode | BlankNode) else None,
        predicate=path,
        term=term if isinstance(term, NamedNode | BlankNode | Literal) else None,
        severity=_iri(said("resultSeverity")),
        said=str(message) if is_own and message is not None else None,
    )
