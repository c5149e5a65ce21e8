"""SHACL node shapes as they judge one node: compiled where they are simple, judged by pyshacl where they are not."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from rosld.ontology.violations import Violation
from rosld.shapes.value import Bounds


@dataclass(frozen=True, slots=True)
class NodeShape:
    """One node shape of a shapes graph. `violations` tells how a focus node and the triples around it break it.

    `paths` are the predicates that its simple property shapes look at (None where a path is not a predicate);
    `bounds` what it demands of the one value of each, as far as bounds can say it.
    """

    iri: str
    paths: frozenset[NamedNode] | None
    bounds: Mapping[NamedNode, Bounds]

    def violations(self, focus: NamedNode | BlankNode, triples: Iterable[Triple]) -> tuple[Violation, ...]:
        """What the node breaks, nothing where it conforms; equal to pyshacl's verdict."""
        raise NotImplementedError


Term = NamedNode | BlankNode | Literal | Triple
