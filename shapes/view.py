"""Views: a data graph as shapes look at it, one node and predicate at a time."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Protocol

from pyoxigraph import NamedNode, Triple

from rosld.ontology.body import Subject, Term
from rosld.shapes.terms import distinct


class View(Protocol):
    """What a shape can see."""

    def objects(self, node: Term, predicate: NamedNode) -> Sequence[Term]:
        """The value nodes of a predicate (SHACL 2.3.1), each once."""
        ...

    def triples(self) -> Sequence[Triple]:
        """All of the graph."""
        ...


class TripleView:
    """The view of triples."""

    def __init__(self, triples: Iterable[Triple]) -> None:
        self._triples = tuple(triples)
        self._objects: dict[tuple[Subject, NamedNode], list[Term]] = {}
        for triple in self._triples:
            self._objects.setdefault((triple.subject, triple.predicate), []).append(triple.object)

    def objects(self, node: Term, predicate: NamedNode) -> Sequence[Term]:
        """The value nodes of a predicate."""
        return () if not (found := self._objects.get((node, predicate))) else distinct(found)  # type: ignore[arg-type]

    def triples(self) -> Sequence[Triple]:
        """The triples."""
        return self._triples
