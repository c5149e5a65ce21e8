"""Parsed shapes graphs: each shape compiled once, and every error reported before any validation."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, TypeAlias

from msgspec import Struct, field
from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from rosld.ontology.body import Term
from rosld.ontology.vocab import rdf, sh, xsd
from rosld.shapes import components
from rosld.shapes.compiled_shape import Extent, SetConstraint, Shape, ValueConstraint
from rosld.shapes.components import SafePattern, compile_pattern
from rosld.shapes.parameter_checks import (
    ABOUT,
    BEYOND_CORE,
    BOUNDS,
    COMPILED,
    LEFT_TO_PYSHACL,
    PAIRS,
    REPEATABLE,
    TARGETS,
    ParameterFault,
    checked_cardinal,
    checked_iri,
    checked_term,
    checked_text,
    checked_truth,
    prefixed,
)
from rosld.shapes.value import UNBOUNDED, Bounds, is_exact, merge_bounds, narrow

if TYPE_CHECKING:
    from rosld.shapes.pyshacl_fallback import PyshaclShape

Node: TypeAlias = NamedNode | BlankNode

MAX_DEPTH = 10
"""The levels of shapes within shapes."""
MAX_SHAPES = 1000
"""The shapes that one shape may hold, counted each time they are referred to."""

_LONGEST_PATH = 50


class _Draft(Struct):
    """A shape in the making."""

    of_value: list[ValueConstraint] = field(default_factory=list)
    of_set: list[SetConstraint] = field(default_factory=list)
    properties: list[Shape] = field(default_factory=list)
    parts: list[Shape] = field(default_factory=list)
    own: Bounds = UNBOUNDED
    within: list[Mapping[tuple[NamedNode, ...], Bounds]] = field(default_factory=list)

    def demand(self, bounds: Bounds) -> None:
        """Narrow what the value nodes may be."""
        self.own = narrow(self.own, bounds)

    def include(self, shape: Shape) -> None:
        """Take over what a shape that must hold demands of the same value nodes."""
        if not shape.is_property:
            self.demand(shape.own)
        self.within.append(shape.within)


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
        self._longest: dict[Node, int] = {}

    def targets(self) -> Iterator[tuple[Node, NamedNode, Term]]:
        """Yield each target declaration: the shape, the kind of target (`sh:targetNode`), the target (SHACL 2.1.3)."""
        for node, said in self._said.items():
            if isinstance(node, NamedNode | BlankNode):
                for kind in sorted(said.keys() & TARGETS, key=str):
                    yield from ((node, kind, target) for target in said[kind])

    def roots(self) -> Iterator[Node]:
        """Yield the shapes that no other shape refers to."""
        inner = {
            each
            for said in self._said.values()
            for predicate, objects in said.items()
            if predicate not in (rdf.type, *TARGETS)
            for each in objects
        }
        for node, said in self._said.items():
            typed = {sh.NodeShape, sh.PropertyShape} & set(said.get(rdf.type, ()))
            if (typed or said.keys() & (COMPILED | LEFT_TO_PYSHACL | TARGETS)) and node not in inner:
                assert isinstance(node, NamedNode | BlankNode)
                yield node

    def statements(self, node: Node) -> Mapping[NamedNode, Sequence[Term]]:
        """Return the statements about a node, by predicate."""
        return self._said.get(node, {})

    def members(self, head: Term) -> Sequence[Term]:
        """Return the members of a list."""
        return self._list(head)

    def name(self, node: Term) -> str:
        """Return a shape as an error calls it."""
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
        """Return a shape as pyshacl judges it, with all that it refers to and nothing else."""
        from rosld.shapes.pyshacl_fallback import PyshaclShape  # rdflib, as in `terms`

        shapes: dict[Term, None] = {}
        triples = list(self._closure(node, shapes))
        longest = min((self._longest.get(each, sys.maxsize) for each in shapes if isinstance(each, Node)), default=0)
        try:
            return PyshaclShape(node, list(shapes), triples, longest)
        except ValueError as error:
            raise ValueError(f"{self.name(node)} cannot be read: {error}") from error

    def _deep(self) -> ValueError:
        return ValueError(f"{self.name(self._open[0])} has shapes nested deeper than {MAX_DEPTH} levels")

    def _closure(self, node: Term, shapes: dict[Term, None]) -> Iterator[Triple]:
        """Yield the triples of a shape and of those it refers to, without their targets."""
        if node in shapes:
            return
        shapes[node] = None
        assert isinstance(node, NamedNode | BlankNode)
        for predicate, objects in self._said[node].items():
            if not predicate.value.startswith(sh.iri) and predicate != rdf.type:
                continue
            for each in objects:
                if predicate in TARGETS or (predicate == rdf.type and each not in (sh.NodeShape, sh.PropertyShape)):
                    continue
                yield Triple(node, predicate, each)
                if predicate in (sh.property, sh.node, sh.not_, NamedNode(sh.iri + "qualifiedValueShape")):
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
        draft = _Draft()
        for parameter in sorted(said.keys() & (COMPILED | LEFT_TO_PYSHACL), key=str):
            for value in said[parameter]:
                self._parameter(node, draft, parameter, value, is_property)
        off = self._is_deactivated(node, said)
        children = draft.parts
        extents = [each.extent for each in children]
        extent = Extent(1 + sum(each.size for each in extents), 1 + max((each.depth for each in extents), default=0))
        if extent.depth > MAX_DEPTH:
            raise self._deep()
        if extent.size > MAX_SHAPES:
            raise ValueError(f"{self.name(node)} holds more than {MAX_SHAPES} shapes, counted as often as referred to")
        if off:
            return Shape(node, path, is_property=is_property)
        inner = merge_bounds(*draft.within)
        if is_property:
            lead = () if path is None else (path,)
            own = {lead: draft.own} if draft.own else {}
            inner = {} if path is None else own | {(*lead, *way): bounds for way, bounds in inner.items()}
        return Shape(
            node,
            path,
            tuple(draft.of_value),
            tuple(draft.of_set),
            tuple(draft.properties),
            words=self._words(node, said),
            severity=self._severity(node, said),
            is_property=is_property,
            is_simple=simple_path and not said.keys() & LEFT_TO_PYSHACL and all(each.is_simple for each in children),
            paths=self._paths(said, path, is_property, children),
            own=draft.own,
            within=inner,
            is_bounds=self._is_bounds(said, path, is_property, draft),
            extent=extent,
        )

    def _is_bounds(
        self, said: Mapping[NamedNode, list[Term]], path: NamedNode | None, is_property: bool, draft: _Draft
    ) -> bool:
        """Whether a shape demands nothing but its bounds and those of the properties in it."""
        told = said.keys() & (COMPILED | LEFT_TO_PYSHACL) - {sh.property}
        return (
            (not is_property or path is not None)
            and told <= (BOUNDS if is_property else frozenset[NamedNode]())
            and all(len(said[each]) == 1 for each in told)
            and all(isinstance(each, Literal) for chosen in said.get(sh.in_, ()) for each in self._list(chosen))
            and all(each.is_bounds for each in draft.parts)
            and is_exact(*draft.within)
        )

    def _paths(
        self, said: Mapping[NamedNode, list[Term]], path: NamedNode | None, is_property: bool, children: list[Shape]
    ) -> frozenset[NamedNode] | None:
        """Return the predicates that a shape looks at from the focus node; None where there are more than these."""
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
        """Refuse unknown terms, which may have been meant as constraints."""
        for predicate in said:
            if not predicate.value.startswith(sh.iri) or predicate in COMPILED | LEFT_TO_PYSHACL | TARGETS | ABOUT:
                if len(said[predicate]) > 1 and predicate.value.startswith(sh.iri) and predicate not in REPEATABLE:
                    raise self._wrong(node, predicate, "is there more than once")
                continue
            if predicate in BEYOND_CORE:
                raise ValueError(f"{self.name(node)} uses {prefixed(predicate)}: only SHACL Core is judged here")
            raise ValueError(
                f"{self.name(node)} says {prefixed(predicate)}, which is no term of SHACL Core for a shape"
            )

    def _path(self, node: Node, said: Mapping[NamedNode, list[Term]]) -> tuple[NamedNode | None, bool, bool]:
        """The path where it is a predicate, whether there is one at all, whether it is compiled."""
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

    def _parameter(self, node: Node, draft: _Draft, parameter: NamedNode, value: Term, is_property: bool) -> None:
        """Take one parameter of a constraint into the draft."""
        try:
            self._constraint(node, draft, parameter, value, is_property)
        except ParameterFault as fault:
            raise self._wrong(node, parameter, str(fault)) from fault

    def _constraint(self, node: Node, draft: _Draft, parameter: NamedNode, value: Term, is_property: bool) -> None:
        match parameter:
            case sh.class_:
                draft.of_value.append(components.class_(checked_iri(value)))
            case sh.datatype:
                draft.of_value.append(components.datatype(checked_iri(value)))
            case sh.nodeKind:
                if value not in components.NODE_KINDS:
                    raise ParameterFault(f"is {value}, which is no kind of node: sh:IRI, sh:Literal, sh:BlankNode, ...")
                draft.of_value.append(components.node_kind(checked_iri(value)))
            case sh.minCount | sh.maxCount:
                self._count(draft, parameter, value, is_property)
            case sh.minInclusive | sh.maxInclusive | sh.minExclusive | sh.maxExclusive:
                self._range(draft, parameter, value)
            case sh.minLength | sh.maxLength:
                length = checked_cardinal(value)
                draft.of_value.append(components.length(parameter, length))
                is_least = parameter == sh.minLength
                draft.demand(Bounds(min_length=length) if is_least else Bounds(max_length=length))
            case sh.pattern:
                self._pattern(node, draft, value)
            case sh.flags:
                checked_text(value)
            case sh.in_:
                members = self._list(value)
                draft.of_value.append(components.in_([checked_term(each) for each in members]))
                draft.demand(Bounds(choices=tuple(each for each in members if isinstance(each, Literal))))
            case sh.hasValue:
                draft.of_set.append(components.has_value(checked_term(value)))
                draft.demand(Bounds(choices=(value,)) if isinstance(value, Literal) else UNBOUNDED)
            case _ if parameter in LEFT_TO_PYSHACL:
                self._check_left_to_pyshacl(draft, parameter, value)
            case _:
                self._shapes_of(draft, parameter, value)

    def _check_left_to_pyshacl(self, draft: _Draft, parameter: NamedNode, value: Term) -> None:
        """Check the values of terms that pyshacl evaluates, which would fail on wrong ones later."""
        match prefixed(parameter):
            case "sh:qualifiedValueShape":
                self._part(draft, value)
            case "sh:qualifiedMinCount" | "sh:qualifiedMaxCount":
                checked_cardinal(value)
            case "sh:languageIn":
                for each in self._list(value):
                    checked_text(each)
            case "sh:ignoredProperties":
                for each in self._list(value):
                    checked_iri(each)
            case "sh:closed" | "sh:uniqueLang" | "sh:qualifiedValueShapesDisjoint":
                checked_truth(value)
            case _:
                checked_iri(value)

    def _shapes_of(self, draft: _Draft, parameter: NamedNode, value: Term) -> None:
        """The parameters whose values are shapes."""
        match parameter:
            case sh.property:
                shape = self._part(draft, value)
                if not shape.is_property:
                    raise ParameterFault("leads to a shape without a sh:path")
                draft.properties.append(shape)
                draft.include(shape)
            case sh.node:
                shape = self._part(draft, value)
                if shape.is_property:
                    raise ParameterFault("leads to a property shape: it must be a node shape")
                draft.of_value.append(components.node(shape))
                draft.include(shape)
            case sh.not_:
                draft.of_value.append(components.not_(self._part(draft, value)))
            case sh.and_ | sh.or_ | sh.xone:
                shapes = [self._part(draft, each) for each in self._list(value)]
                if not shapes:
                    raise ParameterFault("is an empty list")
                logic = {sh.and_: components.and_, sh.or_: components.or_, sh.xone: components.xone}
                draft.of_value.append(logic[parameter](shapes))
                for shape in shapes if parameter == sh.and_ else ():
                    draft.include(shape)

    def _part(self, draft: _Draft, value: Term) -> Shape:
        if not isinstance(value, NamedNode | BlankNode):
            raise ParameterFault(f"is {value}, which is no shape")
        shape = self.shape(value)
        draft.parts.append(shape)
        return shape

    def _count(self, draft: _Draft, parameter: NamedNode, value: Term, is_property: bool) -> None:
        if not is_property:
            raise ParameterFault("is for property shapes only: this shape has no sh:path")
        if not isinstance(value, Literal) or value.datatype != xsd.integer:
            raise ParameterFault(f"is {value}, where an xsd:integer is needed")
        count = checked_cardinal(value)
        is_least = parameter == sh.minCount
        draft.of_set.append(components.min_count(count) if is_least else components.max_count(count))

    def _range(self, draft: _Draft, parameter: NamedNode, value: Term) -> None:
        if not isinstance(value, Literal):
            raise ParameterFault(f"is {value}, where a literal is needed")
        if value.language is None and value.datatype != xsd.string:
            checked_term(value)
        try:
            draft.of_value.append(components.value_range(parameter, value))
        except ValueError as error:
            raise ParameterFault(str(error)) from error
        match parameter:
            case sh.minInclusive:
                draft.demand(Bounds(minimum=value))
            case sh.maxInclusive:
                draft.demand(Bounds(maximum=value))
            case sh.minExclusive:
                draft.demand(Bounds(exclusive_minimum=value))
            case _:
                draft.demand(Bounds(exclusive_maximum=value))

    def _pattern(self, node: Node, draft: _Draft, value: Term) -> None:
        flags = "".join(checked_text(each) for each in self._said[node].get(sh.flags, ()))
        found = self._compile_regex(value, flags)
        self._longest[node] = min(found.max_length, self._longest.get(node, sys.maxsize))
        draft.of_value.append(components.pattern_(found))
        if not flags:
            draft.demand(Bounds(pattern=found.text))

    def _compile_regex(self, value: Term, flags: str) -> SafePattern:
        try:
            return compile_pattern(checked_text(value), flags)
        except ParameterFault:
            raise
        except ValueError as error:
            raise ParameterFault(f"cannot be used: {error}") from error

    # What is said about a shape

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
        """Return the shape's own message: in English or in no language, if it can be."""
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
        return ValueError(f"{self.name(node)}: {prefixed(parameter)} {words}")
