"""SHACL node shapes that validate one node: compiled where they are simple, run by pyshacl where they are not.

The verdict is pyshacl's, with its defaults: sh:Warning and sh:Info count as well. It differs in two things, both
stricter, as SHACL's own words are: NaN is within no bounds, and what pyshacl fails to judge does not conform. Nothing
is fetched, and the time is bounded: shapes are SHACL Core (no SPARQL, no JavaScript, no rules), they do not refer to
themselves, and their patterns cannot take for ever.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import reduce
from itertools import islice

from msgspec import Struct
from msgspec.structs import replace
from pyoxigraph import BlankNode, NamedNode, Triple

from rosld.ontology.violations import Violation
from rosld.shapes.compiled_shape import Shape, ShapeValidator
from rosld.shapes.shapes_graph import ShapesGraph
from rosld.shapes.terms import TripleView, View
from rosld.shapes.value import Bounds, is_exact, merge_bounds

MAX_VIOLATIONS = 20
"""The violations that are told; there may be more."""


class NodeShape(Struct, frozen=True, eq=False):
    """One shape of a shapes graph. `violations` tells how a focus node and the triples around it break it.

    `paths` are the predicates that its simple property shapes look at (None where a path is not a predicate);
    `bounds` what it demands of the one value of each, as far as bounds can say it, `within` the same by the predicates
    on the way (`(twist:linear, vector3:x)`). `is_bounds`: it demands nothing but what `within` says. `sources` are the
    shapes that it was made from.
    """

    iri: str
    paths: frozenset[NamedNode] | None
    within: Mapping[tuple[NamedNode, ...], Bounds]
    judges: tuple[ShapeValidator, ...]
    is_bounds: bool
    sources: tuple[Shape, ...] = ()

    @property
    def bounds(self) -> Mapping[NamedNode, Bounds]:
        """The bounds on the single value of each predicate."""
        return {path[0]: bounds for path, bounds in self.within.items() if len(path) == 1}

    def violations(self, focus: NamedNode | BlankNode, triples: Iterable[Triple]) -> tuple[Violation, ...]:
        """Return the violations of a node; equal to pyshacl's verdict."""
        return self.violations_in(focus, TripleView(triples))

    def violations_in(self, focus: NamedNode | BlankNode, view: View) -> tuple[Violation, ...]:
        """The same, through a view."""
        return tuple(islice(self._broken(focus, view), MAX_VIOLATIONS))

    def _broken(self, focus: NamedNode | BlankNode, view: View) -> Iterator[Violation]:
        for judge in self.judges:
            yield from judge.find_violations(focus, view)

    def __and__(self, other: NodeShape) -> NodeShape:
        """The shape that demands what both do."""
        return replace(
            self,
            paths=None if self.paths is None or other.paths is None else self.paths | other.paths,
            within=merge_bounds(self.within, other.within),
            judges=self.judges + other.judges,
            is_bounds=self.is_bounds and other.is_bounds and is_exact(self.within, other.within),
            sources=self.sources + other.sources,
        )


def compile_shape(graph: ShapesGraph, iri: NamedNode | BlankNode) -> NodeShape:
    """Return the shape `iri` of a shapes graph, compiled.

    Raises ValueError, naming the shape and what is wrong with it, for one that is not there, is malformed, refers to
    itself, is nested too deep or would need more than SHACL Core.
    """
    shape = graph.shape(iri)
    judge: ShapeValidator = shape if shape.is_simple else graph.pyshacl_shape(iri)
    return NodeShape(iri.value, shape.paths, shape.within, (judge,), shape.is_bounds, (shape,))


def conjunction(shapes: Sequence[NodeShape]) -> NodeShape:
    """The shape that demands what all of them do."""
    return reduce(lambda one, other: one & other, shapes)
