"""SHACL node shapes that validate one node.

The verdict is that of pyshacl, against which it is tested: sh:Warning and sh:Info count as well. It differs in two
things, both stricter, as SHACL's own words are: NaN is within no bounds, and values that do not compare do not conform.
Nothing is fetched, and the time is bounded: shapes are SHACL Core (no SPARQL, no JavaScript, no rules), they do not
refer to themselves, and their patterns cannot take for ever.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import reduce
from itertools import islice

from msgspec import Struct
from msgspec.structs import replace
from pyoxigraph import BlankNode, NamedNode, Triple

from rosld.ontology.violations import Violation
from rosld.shapes.compiled_shape import Shape
from rosld.shapes.shapes_graph import ShapesGraph
from rosld.shapes.terms import TripleView, View
from rosld.shapes.value import Bounds, is_exact, merge_bounds

MAX_VIOLATIONS = 20
"""Maximum number of violations that are reported."""


class NodeShape(Struct, frozen=True, eq=False):
    """One shape of a shapes graph. `violations` validates a focus node and the triples around it.

    `paths` are the predicates of its simple property shapes (None if a path is not a predicate); `bounds` are its
    constraints on the single value of each, as far as bounds can express them, `within` the same by paths of predicates
    (`(twist:linear, vector3:x)`). `is_bounds`: `within` has all of its constraints. `sources` are the shapes that it
    consists of.
    """

    iri: str
    paths: frozenset[NamedNode] | None
    within: Mapping[tuple[NamedNode, ...], Bounds]
    is_bounds: bool
    sources: tuple[Shape, ...]

    @property
    def bounds(self) -> Mapping[NamedNode, Bounds]:
        """The bounds on the single value of each predicate."""
        return {path[0]: bounds for path, bounds in self.within.items() if len(path) == 1}

    def violations(self, focus: NamedNode | BlankNode, triples: Iterable[Triple]) -> tuple[Violation, ...]:
        """Return the violations of a node, as pyshacl would."""
        return self.violations_in(focus, TripleView(triples))

    def violations_in(self, focus: NamedNode | BlankNode, view: View) -> tuple[Violation, ...]:
        """Return the violations of a node in a view."""
        return tuple(islice(self._broken(focus, view), MAX_VIOLATIONS))

    def _broken(self, focus: NamedNode | BlankNode, view: View) -> Iterator[Violation]:
        for shape in self.sources:
            yield from shape.find_violations(focus, view)

    def __and__(self, other: NodeShape) -> NodeShape:
        """Return the conjunction of both shapes."""
        return replace(
            self,
            paths=None if self.paths is None or other.paths is None else self.paths | other.paths,
            within=merge_bounds(self.within, other.within),
            is_bounds=self.is_bounds and other.is_bounds and is_exact(self.within, other.within),
            sources=self.sources + other.sources,
        )


def compile_shape(graph: ShapesGraph, iri: NamedNode | BlankNode) -> NodeShape:
    """Return the shape `iri` of a shapes graph, compiled.

    Raises ValueError, naming the shape and the fault, if it does not exist, is malformed, recursive, or nested too
    deeply, or if it needs more than SHACL Core.
    """
    shape = graph.shape(iri)
    return NodeShape(iri.value, shape.paths, shape.within, shape.is_bounds, (shape,))


def conjunction(shapes: Sequence[NodeShape]) -> NodeShape:
    """Return the conjunction of shapes."""
    return reduce(lambda one, other: one & other, shapes)
