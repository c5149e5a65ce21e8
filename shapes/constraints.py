"""SHACL node shapes that validate one node: compiled if they are simple, run by pyshacl otherwise.

The results are those of pyshacl with its defaults: sh:Warning and sh:Info count as well. There are two differences,
both stricter, as SHACL requires: NaN is within no bounds, and an error in pyshacl counts as a violation. Nothing is
fetched, and the time is bounded: shapes are SHACL Core (no SPARQL, no JavaScript, no rules), without recursion, and
their patterns take linear time.
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
    judges: tuple[ShapeValidator, ...]
    is_bounds: bool
    sources: tuple[Shape, ...] = ()

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
        for judge in self.judges:
            yield from judge.find_violations(focus, view)

    def __and__(self, other: NodeShape) -> NodeShape:
        """Return the conjunction of both shapes."""
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

    Raises ValueError, naming the shape and the fault, if it does not exist, is malformed, recursive, or nested too
    deeply, or if it needs more than SHACL Core.
    """
    shape = graph.shape(iri)
    judge: ShapeValidator = shape if shape.is_simple else graph.pyshacl_shape(iri)
    return NodeShape(iri.value, shape.paths, shape.within, (judge,), shape.is_bounds, (shape,))


def conjunction(shapes: Sequence[NodeShape]) -> NodeShape:
    """Return the conjunction of shapes."""
    return reduce(lambda one, other: one & other, shapes)
