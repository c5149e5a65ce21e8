"""SHACL node shapes that validate one node.

The verdict is that of pyshacl, against which it is tested: sh:Warning and sh:Info count as well. It differs in two
things, both stricter, as SHACL's own words are: NaN is within no bounds, and values that do not compare do not conform.
Nothing is fetched, and the time is bounded: shapes are SHACL Core (no SPARQL, no JavaScript, no rules), they do not
refer to themselves, and their patterns cannot take for ever.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice

from msgspec import Struct
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

    `paths` are the predicates of its simple property shapes (None if a path is not a predicate); `within` are its
    constraints on the single value of each path of predicates (`(twist:linear, vector3:x)`), as far as bounds can
    express them. `is_bounds`: `within` has all of its constraints. `sources` are the shapes that it consists of.
    """

    iri: str
    paths: frozenset[NamedNode] | None
    within: Mapping[tuple[NamedNode, ...], Bounds]
    is_bounds: bool
    sources: tuple[Shape, ...]

    def violations(self, focus: NamedNode | BlankNode, triples: Iterable[Triple]) -> tuple[Violation, ...]:
        """Return the violations of a node, as pyshacl would."""
        return self.violations_in(focus, TripleView(triples))

    def violations_in(self, focus: NamedNode | BlankNode, view: View) -> tuple[Violation, ...]:
        """Return the violations of a node in a view."""
        return tuple(islice(self._broken(focus, view), MAX_VIOLATIONS))

    def _broken(self, focus: NamedNode | BlankNode, view: View) -> Iterator[Violation]:
        for shape in self.sources:
            yield from shape.find_violations(focus, view)


def compile_shape(graph: ShapesGraph, iri: NamedNode | BlankNode) -> NodeShape:
    """Return the shape `iri` of a shapes graph, compiled.

    Raises ValueError, naming the shape and the fault, if it does not exist, is malformed, recursive, or nested too
    deeply, or if it needs more than SHACL Core.
    """
    return _node_shape(iri.value, (graph.shape(iri),))


def conjunction(shapes: Sequence[NodeShape]) -> NodeShape:
    """Return the conjunction of shapes."""
    return _node_shape(shapes[0].iri, tuple(source for shape in shapes for source in shape.sources))


def _node_shape(iri: str, sources: tuple[Shape, ...]) -> NodeShape:
    paths, within = [each.paths for each in sources], [each.within for each in sources]
    known = frozenset(path for each in paths for path in each or ())
    is_bounds = all(each.is_bounds for each in sources) and is_exact(*within)
    return NodeShape(iri, None if None in paths else known, merge_bounds(*within), is_bounds, sources)
