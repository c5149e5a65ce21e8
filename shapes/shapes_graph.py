"""Parsed shapes graphs: each shape compiled once, and every error reported before any validation; and node shapes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial, reduce
from itertools import count, islice
from typing import TypeAlias

from msgspec import Struct
from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from rosld.ontology.body import Term
from rosld.ontology.violations import Violation
from rosld.ontology.vocab import rdf, sh
from rosld.shapes.compiled_shape import Constraint, Extent, Shape, Walk
from rosld.shapes.components import CONSTRAINTS, PAIRS, ParameterFault, ShapeSource, checked_truth, term
from rosld.shapes.terms import TripleView, View
from rosld.shapes.value import UNBOUNDED, Bounds, is_exact, merge_bounds, narrow

Node: TypeAlias = NamedNode | BlankNode

MAX_DEPTH = 10
"""Maximum depth of nested shapes."""
MAX_SHAPES = 1000
"""Maximum number of shapes within one shape, counted per reference."""

_LONGEST_PATH = 50
_ALTERNATIVE, _ZERO_OR_ONE = term("alternativePath"), term("zeroOrOnePath")
_PATHS = (sh.inversePath, sh.zeroOrMorePath, term("oneOrMorePath"), _ALTERNATIVE, _ZERO_OR_ONE)


def _terms(names: str) -> frozenset[NamedNode]:
    return frozenset(map(term, names.split()))


_TARGETS = _terms("targetNode targetClass targetSubjectsOf targetObjectsOf")
_ABOUT = _terms(
    "path message severity deactivated name description order group defaultValue flags ignoredProperties "
    "qualifiedValueShapesDisjoint"
)
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
        self._statements: dict[Term, dict[NamedNode, list[Term]]] = {}
        for triple in triples:
            objects = self._statements.setdefault(triple.subject, {}).setdefault(triple.predicate, [])
            if triple.object not in objects:
                objects.append(triple.object)
        self._shapes: dict[Node, Shape] = {}
        self._open: list[Node] = []

    def targets(self) -> Iterator[tuple[Node, NamedNode, Term]]:
        """Yield each target declaration: the shape, the kind of target (`sh:targetNode`), the target (SHACL 2.1.3)."""
        for node, own in self._statements.items():
            if isinstance(node, NamedNode | BlankNode):
                for kind in sorted(own.keys() & _TARGETS, key=str):
                    yield from ((node, kind, target) for target in own[kind])

    def roots(self) -> Iterator[Node]:
        """Yield the shapes that no other shape references."""
        inner = {
            each
            for own in self._statements.values()
            for predicate, objects in own.items()
            if predicate not in (rdf.type, *_TARGETS)
            for each in objects
        }
        for node, statements in self._statements.items():
            typed = {sh.NodeShape, sh.PropertyShape} & set(statements.get(rdf.type, ()))
            if (typed or statements.keys() & (CONSTRAINTS.keys() | _TARGETS)) and node not in inner:
                assert isinstance(node, NamedNode | BlankNode)
                yield node

    def statements(self, node: Node) -> Mapping[NamedNode, Sequence[Term]]:
        """Return the statements about a node, by predicate."""
        return self._statements.get(node, {})

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
        if node not in self._statements:
            raise ValueError(f"{self.name(node)} is referenced, but not described in this graph")
        if node in self._open:
            raise ValueError(f"{self.name(node)} refers to itself, which SHACL leaves undefined (3.4.3)")
        if len(self._open) >= MAX_DEPTH:
            raise self._deep()
        self._open.append(node)
        try:
            shape = self._shapes[node] = self._compile(node, self._statements[node])
        finally:
            self._open.pop()
        return shape

    def _deep(self) -> ValueError:
        return ValueError(f"{self.name(self._open[0])} has shapes nested deeper than {MAX_DEPTH} levels")

    # One shape

    def _compile(self, node: Node, statements: Mapping[NamedNode, list[Term]]) -> Shape:
        self._check_terms(node, statements)
        path, walk = self._path(node, statements)
        is_property = sh.path in statements
        constraints = self._constraints(node, statements)
        children = [shape for each in constraints for shape in each.shapes]
        extents = [each.extent for each in children]
        extent = Extent(1 + sum(each.size for each in extents), 1 + max((each.depth for each in extents), default=0))
        if extent.depth > MAX_DEPTH:
            raise self._deep()
        if extent.size > MAX_SHAPES:
            raise ValueError(f"{self.name(node)} holds more than {MAX_SHAPES} shapes, counted as often as referred to")
        if self._is_deactivated(node, statements):
            return Shape(node, path, walk, is_property=is_property)
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
            walk,
            tuple(constraints),
            words=self._words(node, statements),
            severity=self._severity(node, statements),
            is_property=is_property,
            paths=self._paths(statements, path, is_property, children),
            own=own,
            within=inner,
            is_bounds=self._is_bounds(statements, path, is_property, children, holding),
            extent=extent,
        )

    def _is_bounds(
        self,
        own: Mapping[NamedNode, list[Term]],
        path: NamedNode | None,
        is_property: bool,
        children: Sequence[Shape],
        holding: Sequence[Shape],
    ) -> bool:
        """Whether a shape has no constraints except its bounds and those of its property shapes."""
        constraints = own.keys() & (CONSTRAINTS.keys() | {sh.flags}) - {sh.property}
        return (
            (not is_property or path is not None)
            and constraints <= (_BOUNDS if is_property else frozenset[NamedNode]())
            and all(len(own[each]) == 1 for each in constraints)
            and all(isinstance(each, Literal) for chosen in own.get(sh.in_, ()) for each in self._list(chosen))
            and all(each.is_bounds for each in children)
            and is_exact(*(each.within for each in holding))
        )

    def _paths(
        self, own: Mapping[NamedNode, list[Term]], path: NamedNode | None, is_property: bool, children: Sequence[Shape]
    ) -> frozenset[NamedNode] | None:
        """Return the predicates that a shape uses at the focus node; None if it uses other paths."""
        pairs = frozenset(
            each for pair in own.keys() & PAIRS for each in own[pair] if isinstance(each, NamedNode)
        )  # fmt: skip
        if is_property:
            return None if path is None else pairs | {path}
        found = pairs
        for child in children:
            if child.paths is None:
                return None
            found |= child.paths
        return found

    def _check_terms(self, node: Node, own: Mapping[NamedNode, list[Term]]) -> None:
        """Raise ValueError for unknown terms, which may be intended as constraints."""
        for predicate in own:
            if not predicate.value.startswith(sh.iri) or predicate in _KNOWN:
                if len(own[predicate]) > 1 and predicate.value.startswith(sh.iri) and predicate not in _REPEATABLE:
                    raise self._wrong(node, predicate, "occurs more than once")
                continue
            if predicate in _BEYOND_CORE:
                raise ValueError(f"{self.name(node)} uses {_prefixed(predicate)}: only SHACL Core is supported")
            raise ValueError(
                f"{self.name(node)} has {_prefixed(predicate)}, which is not a term of SHACL Core for a shape"
            )

    def _path(self, node: Node, own: Mapping[NamedNode, list[Term]]) -> tuple[NamedNode | None, Walk | None]:
        """Return the path: a predicate or a property path."""
        kinds, paths = own.get(rdf.type, ()), own.get(sh.path, [])
        if sh.NodeShape in kinds and (paths or sh.PropertyShape in kinds):
            raise ValueError(f"{self.name(node)} is a sh:NodeShape but has a sh:path: make it a sh:PropertyShape")
        if not paths:
            if sh.PropertyShape in kinds:
                raise ValueError(f"{self.name(node)} is a sh:PropertyShape without a sh:path")
            return None, None
        (path,) = paths
        if isinstance(path, NamedNode):
            return path, None
        try:
            return None, self._walk(path, count())
        except ParameterFault as fault:
            raise self._wrong(node, sh.path, str(fault)) from fault

    def _walk(self, path: Term, steps: Iterator[int]) -> Walk:
        """Return the function that follows a property path (SHACL 2.3.1); `steps` counts its parts."""
        if next(steps) > _LONGEST_PATH:
            raise ParameterFault("is too long, or leads to itself")
        if isinstance(path, NamedNode):
            return lambda node, view, is_inverse: view.subjects(path, node) if is_inverse else view.objects(node, path)
        own = self._statements.get(path, {}) if isinstance(path, BlankNode) else {}
        kinds = own.keys() & {rdf.first, *_PATHS}
        if len(kinds) != 1:
            raise ParameterFault("is neither an IRI nor a property path (SHACL 2.3.1)")
        (kind,) = kinds
        if kind == rdf.first:
            return _sequence([self._walk(each, steps) for each in self._list(path)])
        (inner,) = own[kind][:1]
        if kind == _ALTERNATIVE:
            walks = [self._walk(each, steps) for each in self._list(inner)]
            return lambda node, view, is_inverse: [end for walk in walks for end in walk(node, view, is_inverse)]
        walk = self._walk(inner, steps)
        if kind == sh.inversePath:
            return lambda node, view, is_inverse: walk(node, view, not is_inverse)
        if kind == _ZERO_OR_ONE:
            return lambda node, view, is_inverse: [node, *walk(node, view, is_inverse)]
        return _closure(walk, is_reflexive=kind == sh.zeroOrMorePath)

    def _siblings(self, node: Node, shape: Term) -> list[Shape]:
        """Return the other qualified shapes of the property shapes beside a property shape (SHACL 4.7.3)."""
        parents = [each[sh.property] for each in self._statements.values() if node in each.get(sh.property, ())]
        inner = [
            self._statements.get(each, {}).get(term("qualifiedValueShape"), ()) for found in parents for each in found
        ]
        return [self._part(each) for found in inner for each in found if each != shape]

    def _constraints(self, node: Node, own: Mapping[NamedNode, list[Term]]) -> list[Constraint]:
        source, found = ShapeSource(own, self._part, self._list, partial(self._siblings, node)), []
        for parameter in sorted(own.keys() & CONSTRAINTS.keys(), key=str):
            for value in own[parameter]:
                try:
                    found.append(CONSTRAINTS[parameter](parameter, value, source))
                except ParameterFault as fault:
                    raise self._wrong(node, parameter, str(fault)) from fault
        return found

    def _part(self, value: Term) -> Shape:
        if not isinstance(value, NamedNode | BlankNode):
            raise ParameterFault(f"is {value}, which is not a shape")
        return self.shape(value)

    # Statements about a shape

    def _is_deactivated(self, node: Node, own: Mapping[NamedNode, list[Term]]) -> bool:
        try:
            return any(map(checked_truth, own.get(sh.deactivated, ())))
        except ParameterFault as fault:
            raise self._wrong(node, sh.deactivated, str(fault)) from fault

    def _severity(self, node: Node, own: Mapping[NamedNode, list[Term]]) -> NamedNode | None:
        for value in own.get(sh.severity, ()):
            if not isinstance(value, NamedNode):
                raise self._wrong(node, sh.severity, f"is {value}, where an IRI is needed")
            return value
        return None

    def _words(self, node: Node, own: Mapping[NamedNode, list[Term]]) -> str | None:
        """Return the shape's own message, preferably in English or without a language."""
        messages = [value for value in own.get(sh.message, ()) if isinstance(value, Literal)]
        if len(messages) < len(own.get(sh.message, ())):
            raise self._wrong(node, sh.message, "is not a string")
        preferred = sorted(messages, key=lambda each: (not (each.language or "en").startswith("en"), each.value))
        return preferred[0].value if preferred else None

    def _list(self, head: Term) -> list[Term]:
        members: list[Term] = []
        seen: set[Term] = set()
        while head != rdf.nil:
            own = self._statements.get(head, {})
            first, rest = own.get(rdf.first, []), own.get(rdf.rest, [])
            if len(first) != 1 or len(rest) != 1 or head in seen:
                raise ParameterFault("is not a well-formed list: write its members in round brackets")
            seen.add(head)
            members.append(first[0])
            head = rest[0]
        return members

    def _wrong(self, node: Term, parameter: NamedNode, words: str) -> ValueError:
        return ValueError(f"{self.name(node)}: {_prefixed(parameter)} {words}")


def _sequence(walks: Sequence[Walk]) -> Walk:
    def walk_all(node: Term, view: View, is_inverse: bool) -> Sequence[Term]:
        ends: Sequence[Term] = [node]
        for walk in reversed(walks) if is_inverse else walks:
            ends = list(dict.fromkeys(end for start in ends for end in walk(start, view, is_inverse)))
        return ends

    return walk_all


def _closure(walk: Walk, *, is_reflexive: bool) -> Walk:
    def walk_on(node: Term, view: View, is_inverse: bool) -> Sequence[Term]:
        ends: dict[Term, None] = {node: None} if is_reflexive else {}
        waiting = [*walk(node, view, is_inverse)]
        while waiting:
            end = waiting.pop()
            if end not in ends:
                ends[end] = None
                waiting += walk(end, view, is_inverse)
        return list(ends)

    return walk_on


def _prefixed(term: NamedNode) -> str:
    """Return a term of SHACL in its usual notation, such as `sh:path`."""
    return f"sh:{term.value[len(sh.iri) :]}"


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
