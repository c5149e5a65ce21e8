"""Parts of limits: the paths they constrain, the demands on a value, and texts among them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple, TypeAlias

from msgspec import Struct
from msgspec.structs import replace
from pyoxigraph import BlankNode, Literal, NamedNode

from rosld.adapters.model import Array, FieldType, MessageSchema, Nested, ParameterType, Primitive
from rosld.ontology.body import Term
from rosld.ontology.literals import DATATYPES, STRINGS
from rosld.ontology.triples import Statement, Value, text
from rosld.ontology.urls import Space
from rosld.ontology.vocab import sh, xsd
from rosld.shapes.accepted_values import PARAMETERS, AcceptedValues
from rosld.shapes.shapes_graph import Node, ShapesGraph
from rosld.shapes.terms import is_numeric
from rosld.shapes.value import Bounds
from rosld.shapes.writer import ShapesWriter

Kind: TypeAlias = Primitive | Nested | Array | ParameterType


class ValuePlace(Struct, frozen=True):
    """A place that a path leads to: a value of a kind, in a message of a schema where it is in one."""

    kind: Kind
    schema: MessageSchema | None = None

    @classmethod
    def message(cls, schema: MessageSchema, name: str | None = None) -> ValuePlace:
        """Return a message of a schema, or one of the types nested in it."""
        return cls(Nested(name or schema.ref.name), schema)

    @property
    def primitive(self) -> Primitive | None:
        """The type of a scalar; None for everything else."""
        return PARAMETERS.get(self.kind) if isinstance(self.kind, ParameterType) else _primitive(self.kind)

    @property
    def datatype(self) -> NamedNode | None:
        """The datatype that the server itself says a scalar with."""
        if self.kind is ParameterType.INTEGER:
            return xsd.integer
        return None if self.primitive is None else NamedNode(xsd.iri + DATATYPES[self.primitive.name])

    def follow(self, predicate: NamedNode, space: Space) -> ValuePlace | None:
        """Return the field that a predicate leads to; None where it is none of the type."""
        name = self.kind.name if isinstance(self.kind, Nested) else ""
        return self._field(lambda field: space.property_of(name, field) == predicate.value)

    def field(self, path: str) -> ValuePlace | None:
        """Return the field at a dotted path."""
        name, _, rest = path.partition(".")
        found = self._field(lambda field: field == name)
        return found.field(rest) if found is not None and rest else found

    def _field(self, is_it: Callable[[str], bool]) -> ValuePlace | None:
        if self.schema is None or not isinstance(self.kind, Nested):
            return None
        fields = (each for each in self.schema.types[self.kind.name].fields if is_it(each.name))
        return next((ValuePlace(each.type, self.schema) for each in fields), None)


class ResourcePlace(Struct, frozen=True):
    """A resource that a limit is about: the predicate of its value (`rdf:value`, `ros:latest`), and what that is."""

    predicate: NamedNode
    value: ValuePlace | None

    def follow(self, predicate: NamedNode, space: Space) -> ValuePlace | None:
        """Return the value, by its predicate."""
        return self.value if predicate == self.predicate else None


Place: TypeAlias = ValuePlace | ResourcePlace


def _primitive(kind: Kind) -> Primitive | None:
    return kind if isinstance(kind, Primitive) else None


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


class LimitPart(Struct, frozen=True):
    """Demand of a limit on a node or, with a `path`, on the value of a predicate.

    `bounds` are those of a scalar of a `kind` with a `datatype`, all of which must hold. `orders` are sibling numbers
    that it is compared with. All `parts` must hold, and `logic` combines others.
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
        """Return the demand of a limit on a resource on its single value."""
        if self.path is not None:
            return replace(self, path=None)
        logic = tuple((operator, tuple(each.of_value() for each in members)) for operator, members in self.logic)
        return replace(self, parts=tuple(each.of_value() for each in self.parts), logic=logic)


def limit_part(graph: ShapesGraph, node: Node, place: Place, space: Space) -> LimitPart:
    """Return the part of a limit at a place. Raises InexpressibleError."""
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
    """Position of a constraint: the focus node and the value."""

    focus: Place
    value: Place
    space: Space


def _step(place: Place, path: Term, space: Space) -> ValuePlace:
    """Return the field that a path leads to."""
    found = place.follow(path, space) if isinstance(path, NamedNode) else None
    if found is None or (found.primitive is None and not isinstance(found.kind, Nested)):
        raise InexpressibleError(f"{path} is no field, or that of an array")
    return found


def _constrained(part: LimitPart, graph: ShapesGraph, parameter: NamedNode, value: Term, at: _At) -> LimitPart:
    """Return the part with one constraint more."""
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
    """Return the field that a number is compared with."""
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
    """Return a constraint on a scalar that looks at its value."""
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
    """Return the statements about the shape of a part."""
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


class Demand(Struct, frozen=True):
    """What limits demand of a message or a value, beyond its type.

    `bounds` are those of single scalars, by dotted path ("" is the value itself). `value_parts` are limits that say
    more, by the same paths, and `type_parts` those on all messages of a type, by its name. `is_all` is False where
    limits hold that none of these can say. `largest` is the largest absolute value of all floats, which are finite;
    None where they may be any.
    """

    bounds: Sequence[tuple[str, Bounds]] = ()
    is_all: bool = True
    value_parts: Sequence[tuple[str, LimitPart]] = ()
    type_parts: Sequence[tuple[str, LimitPart]] = ()
    largest: float | None = None

    def __and__(self, other: Demand) -> Demand:
        """Combine two demands."""
        return Demand(
            (*self.bounds, *other.bounds),
            self.is_all and other.is_all,
            (*self.value_parts, *other.value_parts),
            (*self.type_parts, *other.type_parts),
            min((each for each in (self.largest, other.largest) if each is not None), default=None),
        )

    def of_bounds(self) -> Demand:
        """Return the part of the demand that bounds can express."""
        is_all = self.is_all and not self.value_parts and not self.type_parts
        return Demand(self.bounds, is_all, largest=self.largest)

    def of_ranges(self) -> Demand:
        """Return the part of the demand that ranges of numbers can express."""
        ranges = [(path, each) for path, each in self.bounds if each == each.range]
        is_all = self.of_bounds().is_all and len(ranges) == len(self.bounds)
        return Demand(ranges, is_all, largest=self.largest)

    def at(self, path: str) -> Demand:
        """Return the demand on the value at a path, written alone; `is_all` is False if there is more."""
        bounds = [("", each) for where, each in self.bounds if where == path]
        parts = [("", each) for where, each in self.value_parts if where == path]
        is_all = self.is_all and len(parts) == len(self.value_parts) and not self.type_parts
        return Demand(bounds, is_all, parts, largest=self.largest)


NO_DEMAND = Demand()


def limited_texts(demand: Demand, schema: MessageSchema, space: Space) -> frozenset[NamedNode]:
    """Return the properties of all fields of a message, and of those within, that are texts with limits."""
    paths = [path for path, _ in demand.bounds]
    paths += [path for path, part in demand.value_parts if path and bounds_text(part)]
    found = [_property_at(schema, path, space) for path in paths]
    parts = (part for _, part in (*demand.value_parts, *demand.type_parts))
    return frozenset(
        [*(each for each in found if each is not None), *(each for part in parts for each in _texts(part))]
    )


def is_limited_text(kind: Primitive, demand: Demand) -> bool:
    """Whether a scalar is text that limits are about."""
    return kind.name in STRINGS and (bool(demand.bounds) or any(bounds_text(part) for _, part in demand.value_parts))


def bounds_text(part: LimitPart) -> bool:
    """Whether a part is about text: its own value, or one within."""
    return _is_text(part) or any(map(bounds_text, _inner(part)))


def _is_text(part: LimitPart) -> bool:
    return part.kind is not None and part.kind.name in STRINGS and bool(part.bounds)


def _inner(part: LimitPart) -> Iterator[LimitPart]:
    yield from part.parts
    for _, members in part.logic:
        yield from members


def _texts(part: LimitPart, above: NamedNode | None = None) -> Iterator[NamedNode]:
    """Yield the properties in a part that lead to texts."""
    path = part.path or above
    if path is not None and _is_text(part):
        yield path
    for inner in _inner(part):
        yield from _texts(inner, path)


def _property_at(schema: MessageSchema, path: str, space: Space) -> NamedNode | None:
    """Return the property that a dotted path ends with, where that leads to text."""
    kind: FieldType = Nested(schema.ref.name)
    found = None
    for step in path.split("."):
        kind = kind.element if isinstance(kind, Array) else kind
        if not isinstance(kind, Nested):
            return None
        name = kind.name
        field = next((each for each in schema.types[name].fields if each.name == step), None)
        if field is None:
            return None
        found, kind = NamedNode(space.property_of(name, step)), field.type
    return found if isinstance(kind, Primitive) and kind.name in STRINGS else None
