"""Parsed shapes graphs: each shape compiled once, and every error reported before any validation."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from functools import reduce
from typing import TYPE_CHECKING, TypeAlias

from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from rosld.ontology.body import Term
from rosld.ontology.vocab import rdf, sh
from rosld.shapes.compiled_shape import Constraint, Extent, Shape
from rosld.shapes.components import CONSTRAINTS, PAIRS, ParameterFault, ShapeSource, checked_truth, term
from rosld.shapes.value import UNBOUNDED, is_exact, merge_bounds, narrow

if TYPE_CHECKING:
    from rosld.shapes.pyshacl_fallback import PyshaclShape

Node: TypeAlias = NamedNode | BlankNode

MAX_DEPTH = 10
"""Maximum depth of nested shapes."""
MAX_SHAPES = 1000
"""Maximum number of shapes within one shape, counted per reference."""

_LONGEST_PATH = 50


def _terms(names: str) -> frozenset[NamedNode]:
    return frozenset(map(term, names.split()))


_TARGETS = _terms("targetNode targetClass targetSubjectsOf targetObjectsOf")
_ABOUT = _terms("flags path message severity deactivated name description order group defaultValue")
_KNOWN = CONSTRAINTS.keys() | _TARGETS | _ABOUT
_REPEATABLE = (
    PAIRS
    | _TARGETS
    | _terms(
        "class minInclusive maxInclusive minExclusive maxExclusive pattern and or not xone node property hasValue "
        "qualifiedValueShape message name description"
    )
)
"""Parameters that a shape may have more than once."""
_BEYOND_CORE = _terms("sparql js rule expression target values entailment shapesGraph")
_BOUNDS = _terms("minInclusive maxInclusive minExclusive maxExclusive minLength maxLength pattern in")
"""Parameters that only restrict a single value."""


class ShapesGraph:
    """The triples of a shapes graph, and its shapes. Every method raises ValueError, naming the shape and the fault."""

    def __init__(self, triples: Sequence[Triple]) -> None:
        self._said: dict[Term, dict[NamedNode, list[Term]]] = {}
        for triple in triples:
            objects = self._said.setdefault(triple.subject, {}).setdefault(triple.predicate, [])
            if triple.object not in objects:
                objects.append(triple.object)
        self._shapes: dict[Node, Shape] = {}
        self._open: list[Node] = []

    def targets(self) -> Iterator[tuple[Node, NamedNode, Term]]:
        """Yield each target declaration: the shape, the kind of target (`sh:targetNode`), the target (SHACL 2.1.3)."""
        for node, said in self._said.items():
            if isinstance(node, NamedNode | BlankNode):
                for kind in sorted(said.keys() & _TARGETS, key=str):
                    yield from ((node, kind, target) for target in said[kind])

    def roots(self) -> Iterator[Node]:
        """Yield the shapes that no other shape references."""
        inner = {
            each
            for said in self._said.values()
            for predicate, objects in said.items()
            if predicate not in (rdf.type, *_TARGETS)
            for each in objects
        }
        for node, said in self._said.items():
            typed = {sh.NodeShape, sh.PropertyShape} & set(said.get(rdf.type, ()))
            if (typed or said.keys() & (CONSTRAINTS.keys() | _TARGETS)) and node not in inner:
                assert isinstance(node, NamedNode | BlankNode)
                yield node

    def statements(self, node: Node) -> Mapping[NamedNode, Sequence[Term]]:
        """Return the statements about a node, by predicate."""
        return self._said.get(node, {})

    def members(self, head: Term) -> Sequence[Term]:
        """Return the members of a list."""
        return self._list(head)

    def name(self, node: Term) -> str:
        """Return the name of a shape in error messages."""
        if isinstance(node, NamedNode):
            return f"the shape <{node.value}>"
        within = next((each for each in reversed(self._open) if isinstance(each, NamedNode)), None)
        return "a shape without a name" + ("" if within is None else f" in <{within.value}>")

    def shape(self, node: Node) -> Shape:
        """Return a shape, compiled."""
        known = self._shapes.get(node)
        if known is not None:
            return known
        if node not in self._said:
            raise ValueError(f"{self.name(node)} is referred to, but nothing is said of it in this graph")
        if node in self._open:
            raise ValueError(f"{self.name(node)} refers to itself, which SHACL leaves undefined (3.4.3)")
        if len(self._open) >= MAX_DEPTH:
            raise self._deep()
        self._open.append(node)
        try:
            shape = self._shapes[node] = self._compile(node, self._said[node])
        finally:
            self._open.pop()
        return shape

    def pyshacl_shape(self, node: Node) -> PyshaclShape:
        """Return a shape for pyshacl, with exactly the triples that it references."""
        from rosld.shapes.pyshacl_fallback import PyshaclShape  # rdflib, as in `terms`

        shapes: dict[Term, None] = {}
        triples = list(self._closure(node, shapes))
        try:
            return PyshaclShape(node, list(shapes), triples, self.shape(node).max_length)
        except ValueError as error:
            raise ValueError(f"{self.name(node)} cannot be read: {error}") from error

    def _deep(self) -> ValueError:
        return ValueError(f"{self.name(self._open[0])} has shapes nested deeper than {MAX_DEPTH} levels")

    def _closure(self, node: Term, shapes: dict[Term, None]) -> Iterator[Triple]:
        """Yield the triples of a shape and of those it references, without their targets."""
        if node in shapes:
            return
        shapes[node] = None
        assert isinstance(node, NamedNode | BlankNode)
        for predicate, objects in self._said[node].items():
            if not predicate.value.startswith(sh.iri) and predicate != rdf.type:
                continue
            for each in objects:
                if predicate in _TARGETS or (predicate == rdf.type and each not in (sh.NodeShape, sh.PropertyShape)):
                    continue
                yield Triple(node, predicate, each)
                if predicate in (sh.property, sh.node, sh.not_, term("qualifiedValueShape")):
                    yield from self._closure(each, shapes)
                elif predicate in (sh.and_, sh.or_, sh.xone):
                    yield from self._inner(each)
                    for member in self._list(each):
                        yield from self._closure(member, shapes)
                elif isinstance(each, BlankNode):
                    yield from self._inner(each)

    def _inner(self, node: Term) -> Iterator[Triple]:
        """Yield the triples of lists and paths."""
        waiting, seen = [node], {node}
        while waiting:
            subject = waiting.pop()
            if not isinstance(subject, NamedNode | BlankNode):
                continue
            for predicate, objects in self._said.get(subject, {}).items():
                for each in objects:
                    yield Triple(subject, predicate, each)
                    # The members of a list of shapes are followed as shapes.
                    if isinstance(each, BlankNode) and each not in seen and sh.path not in self._said.get(each, {}):
                        seen.add(each)
                        waiting.append(each)

    # One shape

    def _compile(self, node: Node, said: Mapping[NamedNode, list[Term]]) -> Shape:
        self._check_terms(node, said)
        path, is_property, simple_path = self._path(node, said)
        constraints = self._constraints(node, said)
        children = [shape for each in constraints for shape in each.shapes]
        extents = [each.extent for each in children]
        extent = Extent(1 + sum(each.size for each in extents), 1 + max((each.depth for each in extents), default=0))
        if extent.depth > MAX_DEPTH:
            raise self._deep()
        if extent.size > MAX_SHAPES:
            raise ValueError(f"{self.name(node)} holds more than {MAX_SHAPES} shapes, counted as often as referred to")
        if self._is_deactivated(node, said):
            return Shape(node, path, is_property=is_property)
        holding = [
            shape for each in constraints if each.parameter in (sh.property, sh.node, sh.and_) for shape in each.shapes
        ]
        bounds = [each.bounds for each in constraints]
        own = reduce(narrow, [*bounds, *(each.own for each in holding if not each.is_property)], UNBOUNDED)
        inner = merge_bounds(*(each.within for each in holding))
        if is_property:
            lead = () if path is None else (path,)
            mine = {lead: own} if own else {}
            inner = {} if path is None else mine | {(*lead, *way): bounds for way, bounds in inner.items()}
        return Shape(
            node,
            path,
            tuple(constraints),
            words=self._words(node, said),
            severity=self._severity(node, said),
            is_property=is_property,
            is_simple=simple_path
            and all(each.test or each.test_all for each in constraints)
            and all(each.is_simple for each in children),
            paths=self._paths(said, path, is_property, children),
            own=own,
            within=inner,
            is_bounds=self._is_bounds(said, path, is_property, children, holding),
            extent=extent,
            max_length=min(
                [sys.maxsize, *(each.max_length for each in constraints), *(each.max_length for each in children)]
            ),
        )

    def _is_bounds(
        self,
        said: Mapping[NamedNode, list[Term]],
        path: NamedNode | None,
        is_property: bool,
        children: Sequence[Shape],
        holding: Sequence[Shape],
    ) -> bool:
        """Whether a shape has no constraints except its bounds and those of its property shapes."""
        told = said.keys() & (CONSTRAINTS.keys() | {sh.flags}) - {sh.property}
        return (
            (not is_property or path is not None)
            and told <= (_BOUNDS if is_property else frozenset[NamedNode]())
            and all(len(said[each]) == 1 for each in told)
            and all(isinstance(each, Literal) for chosen in said.get(sh.in_, ()) for each in self._list(chosen))
            and all(each.is_bounds for each in children)
            and is_exact(*(each.within for each in holding))
        )

    def _paths(
        self, said: Mapping[NamedNode, list[Term]], path: NamedNode | None, is_property: bool, children: Sequence[Shape]
    ) -> frozenset[NamedNode] | None:
        """Return the predicates that a shape uses at the focus node; None if it uses other paths."""
        pairs = frozenset(
            each for pair in said.keys() & PAIRS for each in said[pair] if isinstance(each, NamedNode)
        )  # fmt: skip
        if is_property:
            return None if path is None else pairs | {path}
        found = pairs
        for child in children:
            if child.paths is None:
                return None
            found |= child.paths
        return found

    def _check_terms(self, node: Node, said: Mapping[NamedNode, list[Term]]) -> None:
        """Raise ValueError for unknown terms, which may be intended as constraints."""
        for predicate in said:
            if not predicate.value.startswith(sh.iri) or predicate in _KNOWN:
                if len(said[predicate]) > 1 and predicate.value.startswith(sh.iri) and predicate not in _REPEATABLE:
                    raise self._wrong(node, predicate, "is there more than once")
                continue
            if predicate in _BEYOND_CORE:
                raise ValueError(f"{self.name(node)} uses {_prefixed(predicate)}: only SHACL Core is judged here")
            raise ValueError(
                f"{self.name(node)} says {_prefixed(predicate)}, which is no term of SHACL Core for a shape"
            )

    def _path(self, node: Node, said: Mapping[NamedNode, list[Term]]) -> tuple[NamedNode | None, bool, bool]:
        """Return the path if it is a predicate, whether there is one at all, and whether it is compiled."""
        kinds, paths = said.get(rdf.type, ()), said.get(sh.path, [])
        if sh.NodeShape in kinds and (paths or sh.PropertyShape in kinds):
            raise ValueError(f"{self.name(node)} is a sh:NodeShape, and so can be no property shape: it has a sh:path")
        if not paths:
            if sh.PropertyShape in kinds:
                raise ValueError(f"{self.name(node)} is a sh:PropertyShape without a sh:path")
            return None, False, True
        (path,) = paths
        if isinstance(path, NamedNode):
            return path, True, True
        if not isinstance(path, BlankNode) or path not in self._said:
            raise self._wrong(node, sh.path, "is neither an IRI nor a property path (SHACL 2.3.1)")
        if sum(1 for _ in self._inner(path)) > _LONGEST_PATH:
            raise self._wrong(node, sh.path, "is too long")
        return None, True, False

    def _constraints(self, node: Node, said: Mapping[NamedNode, list[Term]]) -> list[Constraint]:
        source, found = ShapeSource(said, self._part, self._list), []
        for parameter in sorted(said.keys() & CONSTRAINTS.keys(), key=str):
            for value in said[parameter]:
                try:
                    found.append(CONSTRAINTS[parameter](parameter, value, source))
                except ParameterFault as fault:
                    raise self._wrong(node, parameter, str(fault)) from fault
        return found

    def _part(self, value: Term) -> Shape:
        if not isinstance(value, NamedNode | BlankNode):
            raise ParameterFault(f"is {value}, which is no shape")
        return self.shape(value)

    # Statements about a shape

    def _is_deactivated(self, node: Node, said: Mapping[NamedNode, list[Term]]) -> bool:
        try:
            return any(map(checked_truth, said.get(sh.deactivated, ())))
        except ParameterFault as fault:
            raise self._wrong(node, sh.deactivated, str(fault)) from fault

    def _severity(self, node: Node, said: Mapping[NamedNode, list[Term]]) -> NamedNode | None:
        for value in said.get(sh.severity, ()):
            if not isinstance(value, NamedNode):
                raise self._wrong(node, sh.severity, f"is {value}, where an IRI is needed")
            return value
        return None

    def _words(self, node: Node, said: Mapping[NamedNode, list[Term]]) -> str | None:
        """Return the shape's own message, preferably in English or without a language."""
        messages = [value for value in said.get(sh.message, ()) if isinstance(value, Literal)]
        if len(messages) < len(said.get(sh.message, ())):
            raise self._wrong(node, sh.message, "is no text")
        preferred = sorted(messages, key=lambda each: (not (each.language or "en").startswith("en"), each.value))
        return preferred[0].value if preferred else None

    def _list(self, head: Term) -> list[Term]:
        members: list[Term] = []
        seen: set[Term] = set()
        while head != rdf.nil:
            said = self._said.get(head, {})
            first, rest = said.get(rdf.first, []), said.get(rdf.rest, [])
            if len(first) != 1 or len(rest) != 1 or head in seen:
                raise ParameterFault("is no well-formed list: write its members in round brackets")
            seen.add(head)
            members.append(first[0])
            head = rest[0]
        return members

    def _wrong(self, node: Term, parameter: NamedNode, words: str) -> ValueError:
        return ValueError(f"{self.name(node)}: {_prefixed(parameter)} {words}")


def _prefixed(term: NamedNode) -> str:
    """Return a term of SHACL in its usual notation, such as `sh:path`."""
    return f"sh:{term.value[len(sh.iri) :]}"
