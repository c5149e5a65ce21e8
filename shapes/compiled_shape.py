"""Compiled shapes: the constraints of one shape as tests, applied to a focus node and the triples around it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple, TypeAlias
from urllib.parse import unquote

from msgspec import Struct, field
from pyoxigraph import BlankNode, Literal, NamedNode

from rosld.ontology.body import Term
from rosld.ontology.violations import Violation, brief_value
from rosld.ontology.vocab import rdf, sh
from rosld.shapes.terms import View, distinct
from rosld.shapes.value import UNBOUNDED, Bounds

ValueTest: TypeAlias = Callable[[Term, View], bool]
Offenders: TypeAlias = Callable[[Term, Sequence[Term], View], Sequence[Term | None]]
Walk: TypeAlias = Callable[[Term, View, bool], Sequence[Term]]
"""Function from a node to the nodes at the end of a path, or (True) of the inverse path."""


class Constraint(Struct, frozen=True, eq=False):
    """A constraint: its parameter and value as written, the sentence about a violation, and its test.

    `test` checks each value node; `offenders` returns those of all value nodes of a focus node that break it, None
    for a missing one; `strangers` returns the values that a closed shape does not allow. `bounds` narrow the value
    nodes, `shapes` are those that the value references.
    """

    parameter: NamedNode
    value: Term
    words: str = ""
    test: ValueTest | None = None
    offenders: Offenders | None = None
    strangers: Callable[[Term, View], Iterable[tuple[NamedNode, Term]]] | None = None
    bounds: Bounds = UNBOUNDED
    shapes: tuple[Shape, ...] = ()

    @property
    def component(self) -> NamedNode:
        return component(self.parameter)


def component(parameter: NamedNode) -> NamedNode:
    """Return the constraint component of a parameter: `sh:MinInclusiveConstraintComponent` for `sh:minInclusive`."""
    name = parameter.value[len(sh.iri) :]
    return NamedNode(f"{sh.iri}{name[0].upper()}{name[1:]}ConstraintComponent")


class Extent(NamedTuple):
    """Extent of a shape: `size` counts the shapes in it, `depth` their levels."""

    size: int = 1
    depth: int = 1


ALONE = Extent()
"""The extent of a shape without nested shapes."""


class Shape(Struct, frozen=True, eq=False):
    """A compiled shape. A node shape has no `path`: its single value node is the focus node (SHACL 2.1.3).

    A path that is not a predicate is a `walk`. `paths` are the predicates that the shape uses at the focus node, None
    if a path is not a predicate. `own` bounds the value nodes, `within` the values along paths from the focus node;
    `is_bounds` is True if the shape has no other constraints.
    """

    node: NamedNode | BlankNode
    path: NamedNode | None = None
    walk: Walk | None = None
    constraints: tuple[Constraint, ...] = ()
    words: str | None = None
    severity: NamedNode | None = None
    is_property: bool = False
    paths: frozenset[NamedNode] | None = frozenset()
    own: Bounds = UNBOUNDED
    within: Mapping[tuple[NamedNode, ...], Bounds] = field(default_factory=dict)
    is_bounds: bool = True
    extent: Extent = ALONE

    def values(self, focus: Term, view: View) -> Sequence[Term]:
        """Return the value nodes of a focus node."""
        if self.path is not None:
            return view.objects(focus, self.path)
        return (focus,) if self.walk is None else distinct(self.walk(focus, view, False))

    def conforms(self, focus: Term, view: View) -> bool:
        """Whether there are no violations."""
        values = self.values(focus, view)
        for each in self.constraints:
            if each.test is not None:
                for value in values:
                    if not each.test(value, view):
                        return False
            elif each.offenders is not None and each.offenders(focus, values, view):
                return False
        return True

    def find_violations(self, focus: Term, view: View, above: str = "") -> Iterator[Violation]:
        """Yield each violation; `above` is the dotted path to the focus node."""
        if self.conforms(focus, view):
            return
        values = self.values(focus, view)
        path = above if self.path is None else join_path(above, self.path)
        for each in self.constraints:
            if each.offenders is not None:
                yield from (self._violation(focus, path, each, term) for term in each.offenders(focus, values, view))
        for value in values:
            for each in self.constraints:
                if each.test is None or each.test(value, view):
                    continue
                if each.parameter == sh.property:
                    yield from each.shapes[0].find_violations(value, view, path)
                elif each.strangers is not None:
                    for predicate, term in each.strangers(value, view):
                        yield self._violation(focus, join_path(path, predicate), each, term, predicate)
                else:
                    yield self._violation(focus, path, each, value)

    def _violation(
        self, focus: Term, path: str, constraint: Constraint, value: Term | None, predicate: NamedNode | None = None
    ) -> Violation:
        """Return a violation of one constraint, with the shape's own message if it has one (SHACL 2.1.5)."""
        return Violation(
            path,
            constraint.words,
            brief_term(value),
            component=constraint.component,
            shape=self.node if isinstance(self.node, NamedNode) else None,
            focus=focus if isinstance(focus, NamedNode | BlankNode) else None,
            predicate=predicate or self.path,
            term=value if isinstance(value, NamedNode | BlankNode | Literal) else None,
            severity=self.severity,
            quote=self.words,
        )


def join_path(above: str, predicate: NamedNode) -> str:
    """Return the dotted path extended by a step; `rdf:value` is the value itself and adds none."""
    if predicate == rdf.value:
        return above
    iri = predicate.value.rstrip("/#")
    name = unquote(iri[max(iri.rfind("#"), iri.rfind("/")) + 1 :])
    return f"{above}.{name}" if above else name


def brief_term(term: Term | None) -> str | None:
    """Return a short text of a term for people."""
    if isinstance(term, BlankNode):
        return None
    return brief_value(term.value if isinstance(term, NamedNode | Literal) else term)
