"""Limits as parts of a shape of what may be written, where SHACL Core can say them of what is written.

A limit judges a message as the server itself would say it, whatever a body said. So of the constraints only those are
carried over that look at values and not at how they are written: ranges, choices, the order of two fields
(`sh:lessThan`), texts, and all logic of these. What is always so of the type (`sh:datatype`, `sh:minCount 1`) is left
out. A limit with any other constraint is not carried over at all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

from pyoxigraph import BlankNode, Literal, NamedNode

from rosld.adapters.model import Nested, Primitive
from rosld.ontology.body import Term
from rosld.ontology.literals import STRINGS
from rosld.ontology.triples import Statement, Value, text
from rosld.ontology.urls import Space
from rosld.ontology.vocab import sh
from rosld.shapes.accepted_values import AcceptedValues
from rosld.shapes.limit_paths import Place, ValuePlace
from rosld.shapes.shapes_graph import Node, ShapesGraph
from rosld.shapes.terms import is_numeric
from rosld.shapes.value import Bounds
from rosld.shapes.writer import ShapesWriter

_SILENT = frozenset(
    {
        *(sh.path, sh.severity, sh.name, sh.description, sh.order, sh.group, sh.defaultValue, sh.message),
        *(sh.deactivated, sh.targetNode, sh.targetClass),
    }
)
"""What demands nothing."""
_LITERALS = (sh.Literal, sh.IRIOrLiteral, sh.BlankNodeOrLiteral)
_NODES = (sh.IRI, sh.IRIOrLiteral, sh.BlankNodeOrIRI)


class InexpressibleError(ValueError):
    """A limit that no shape of what is written can say."""


@dataclass(frozen=True, slots=True)
class LimitPart:
    """What a limit demands of a node or, with a `path`, of the value of a predicate.

    `bounds` are those of a scalar of a `kind` that is told with a `datatype`, each to hold by itself. `orders` are the
    numbers beside it that it is compared with. All `parts` hold, and of `logic` what it says.
    """

    path: NamedNode | None = None
    kind: Primitive | None = None
    datatype: NamedNode | None = None
    bounds: tuple[Bounds, ...] = ()
    orders: tuple[tuple[NamedNode, NamedNode], ...] = ()
    parts: tuple[LimitPart, ...] = ()
    logic: tuple[tuple[NamedNode, tuple[LimitPart, ...]], ...] = ()
    words: str | None = None

    @property
    def is_empty(self) -> bool:
        """Whether nothing is demanded."""
        return not (self.bounds or self.orders or self.logic) and all(each.is_empty for each in self.parts)

    def of_value(self) -> LimitPart:
        """What the limit on a resource demands of its one value, which is the only thing that it is about."""
        if self.path is not None:
            return replace(self, path=None)
        logic = tuple((operator, tuple(each.of_value() for each in members)) for operator, members in self.logic)
        return replace(self, parts=tuple(each.of_value() for each in self.parts), logic=logic)


def limit_part(graph: ShapesGraph, node: Node, place: Place, space: Space) -> LimitPart:
    """What a limit demands at a place. Raises InexpressibleError."""
    said = graph.statements(node)
    if any(isinstance(each, Literal) and each.value in ("true", "1") for each in said.get(sh.deactivated, ())):
        return LimitPart()
    path = next(iter(said.get(sh.path, ())), None)
    at = place if path is None else _step(place, path, space)
    part = LimitPart(words=graph.shape(node).words)
    if isinstance(path, NamedNode):
        part = replace(part, path=path)
    if isinstance(at, ValuePlace):
        part = replace(part, kind=at.primitive, datatype=at.datatype)
    for parameter, values in said.items():
        if parameter.value.startswith(sh.iri) and parameter not in _SILENT:
            for value in values:
                part = _constrained(part, graph, parameter, value, _At(place, at, space))
    return part


class _At(NamedTuple):
    """Where a constraint is: the focus node, the value that is looked at."""

    focus: Place
    value: Place
    space: Space


def _step(place: Place, path: Term, space: Space) -> ValuePlace:
    """The field that a path leads to."""
    found = place.follow(path, space) if isinstance(path, NamedNode) else None
    if found is None or (found.primitive is None and not isinstance(found.kind, Nested)):
        raise InexpressibleError(f"{path} is no field, or that of an array")
    return found


def _constrained(part: LimitPart, graph: ShapesGraph, parameter: NamedNode, value: Term, at: _At) -> LimitPart:
    """The part with one constraint more."""
    if parameter in (sh.lessThan, sh.lessThanOrEquals):
        return replace(part, orders=(*part.orders, (parameter, _number_beside(at, value))))
    if parameter in (sh.property, sh.node):
        return replace(part, parts=(*part.parts, limit_part(graph, _shape(value), at.value, at.space)))
    if parameter in (sh.not_, sh.and_, sh.or_, sh.xone):
        shapes = [value] if parameter == sh.not_ else graph.members(value)
        members = tuple(limit_part(graph, _shape(each), at.value, at.space) for each in shapes)
        return replace(part, logic=(*part.logic, (parameter, members)))
    if _is_always_so(parameter, value, at):
        return part
    return replace(part, bounds=(*part.bounds, _bounds(graph, parameter, value, at.value)))


def _shape(value: Term) -> Node:
    if not isinstance(value, NamedNode | BlankNode):
        raise InexpressibleError("it is no shape")
    return value


def _number_beside(at: _At, predicate: Term) -> NamedNode:
    """The field that a number is compared with."""
    other = at.focus.follow(predicate, at.space) if isinstance(predicate, NamedNode) else None
    if other is None or not (_is_number(at.value) and _is_number(other)) or not isinstance(predicate, NamedNode):
        raise InexpressibleError("only numbers of one message are compared")
    return predicate


def _is_number(place: Place) -> bool:
    kind = place.primitive if isinstance(place, ValuePlace) else None
    return kind is not None and kind.name != "bool" and kind.name not in STRINGS


def _is_always_so(parameter: NamedNode, value: Term, at: _At) -> bool:
    """Whether every value of the type fulfils a constraint."""
    place = at.value
    if not isinstance(place, ValuePlace):
        return False
    match parameter:
        case sh.datatype:
            return value == place.datatype
        case sh.nodeKind:
            return value in (_NODES if place.primitive is None else _LITERALS)
        case sh.class_:
            return isinstance(place.kind, Nested) and value == NamedNode(at.space.class_of(place.kind.name))
        case sh.minCount:
            return isinstance(value, Literal) and value.value in ("0", "1")
        case sh.maxCount:
            return isinstance(value, Literal) and value.value != "0"
    return False


def _bounds(graph: ShapesGraph, parameter: NamedNode, value: Term, place: Place) -> Bounds:
    """A constraint on a scalar that looks at its value."""
    kind = place.primitive if isinstance(place, ValuePlace) else None
    if kind is None:
        raise InexpressibleError("it is about no scalar")
    if parameter in (sh.in_, sh.hasValue):
        members = graph.members(value) if parameter == sh.in_ else [value]
        choices = tuple(each for each in members if isinstance(each, Literal))
        if choices:
            return Bounds(choices=choices)
    elif isinstance(value, Literal) and parameter in _RANGES and _is_number(place) and is_numeric(value.datatype):
        return _RANGES[parameter](value)
    elif isinstance(value, Literal) and parameter in _TEXTS and kind.name in STRINGS:
        return _TEXTS[parameter](value.value)
    raise InexpressibleError(f"{parameter} looks at how a value is written")


_RANGES: Mapping[NamedNode, Callable[[Literal], Bounds]] = {
    sh.minInclusive: lambda value: Bounds(minimum=value),
    sh.maxInclusive: lambda value: Bounds(maximum=value),
    sh.minExclusive: lambda value: Bounds(exclusive_minimum=value),
    sh.maxExclusive: lambda value: Bounds(exclusive_maximum=value),
}
_TEXTS: Mapping[NamedNode, Callable[[str], Bounds]] = {
    sh.pattern: lambda value: Bounds(pattern=value),
    sh.minLength: lambda value: Bounds(min_length=int(value)),
    sh.maxLength: lambda value: Bounds(max_length=int(value)),
}


def write_limit(writer: ShapesWriter, values: AcceptedValues, part: LimitPart) -> BlankNode:
    """Write the shape of a part."""
    return writer.blank(*limit_statements(writer, values, part))


def limit_statements(writer: ShapesWriter, values: AcceptedValues, part: LimitPart) -> Iterator[Statement]:
    """What is said of the shape of a part."""
    yield sh.path, part.path
    yield sh.message, text(part.words)
    demands: list[Value] = []
    if part.kind is not None:
        for bounds in part.bounds:
            demands += [writer.blank(*each) for each in values.bounds(part.kind, bounds, part.datatype)]
    for each in demands:
        yield sh.node, each
    yield from part.orders
    for inner in part.parts:
        yield (sh.node if inner.path is None else sh.property), write_limit(writer, values, inner)
    for operator, members in part.logic:
        shapes = [write_limit(writer, values, each) for each in members]
        yield operator, (shapes[0] if operator == sh.not_ else writer.list_of(shapes))
