"""Parts of limits: their paths, their constraints on a value, and the texts among them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TypeAlias

from msgspec import Struct
from msgspec.structs import replace
from pyoxigraph import BlankNode, Literal, NamedNode

from rosld.adapters.model import STRINGS, Array, MessageSchema, Nested, ParameterType, Primitive
from rosld.ontology.body import Term
from rosld.ontology.fields import fields_along, type_at
from rosld.ontology.literals import DATATYPES
from rosld.ontology.triples import Statement, Value, text
from rosld.ontology.urls import Space
from rosld.ontology.vocab import sh, xsd
from rosld.shapes.accepted_values import PARAMETERS, AcceptedValues
from rosld.shapes.compiled_shape import Constraint, Shape
from rosld.shapes.terms import is_numeric
from rosld.shapes.value import Bounds
from rosld.shapes.writer import ShapesWriter

Kind: TypeAlias = Primitive | Nested | Array | ParameterType


class ValuePlace(Struct, frozen=True):
    """The target of a path: a value of a kind, with the schema of the message that contains it, if any."""

    kind: Kind
    schema: MessageSchema | None = None

    @classmethod
    def message(cls, schema: MessageSchema, name: str | None = None) -> ValuePlace:
        """Return a message of a schema, or one of the types nested in it."""
        return cls(Nested(name or schema.ref.name), schema)

    @classmethod
    def of_field(cls, schema: MessageSchema, path: str | None) -> ValuePlace | None:
        """Return the field at a dotted path, or for None the message."""
        try:
            return cls(Nested(schema.ref.name) if path is None else type_at(schema, path), schema)
        except ValueError:
            return None

    @property
    def primitive(self) -> Primitive | None:
        """The type of a scalar; None for other values."""
        return PARAMETERS.get(self.kind) if isinstance(self.kind, ParameterType) else _primitive(self.kind)

    @property
    def datatype(self) -> NamedNode | None:
        """The datatype with which the server writes a scalar."""
        if self.kind is ParameterType.INTEGER:
            return xsd.integer
        return None if self.primitive is None else NamedNode(xsd.iri + DATATYPES[self.primitive.name])

    def follow(self, predicate: NamedNode, space: Space) -> ValuePlace | None:
        """Return the field of a predicate; None if the type has no such field."""
        if self.schema is None or not isinstance(self.kind, Nested):
            return None
        name, fields = self.kind.name, self.schema.types[self.kind.name].fields
        found = (each.type for each in fields if space.property_of(name, each.name) == predicate.value)
        return next((ValuePlace(each, self.schema) for each in found), None)


class ResourcePlace(Struct, frozen=True):
    """A resource with a limit: the predicate of its value (`rdf:value`, `ros:latest`), and the place of that value."""

    predicate: NamedNode
    value: ValuePlace | None

    def follow(self, predicate: NamedNode, space: Space) -> ValuePlace | None:
        """Return the place of the value if this is its predicate."""
        return self.value if predicate == self.predicate else None


Place: TypeAlias = ValuePlace | ResourcePlace


def _primitive(kind: Kind) -> Primitive | None:
    return kind if isinstance(kind, Primitive) else None


_LITERALS = (sh.Literal, sh.IRIOrLiteral, sh.BlankNodeOrLiteral)
_NODES = (sh.IRI, sh.IRIOrLiteral, sh.BlankNodeOrIRI)


class InexpressibleError(ValueError):
    """A limit that no shape of accepted RDF can express."""


class LimitPart(Struct, frozen=True):
    """Constraints of a limit on a node or, with a `path`, on the value of a predicate.

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
        """Whether there are no constraints."""
        return not (self.bounds or self.orders or self.logic) and all(each.is_empty for each in self.parts)

    def of_value(self) -> LimitPart:
        """Return the constraints of a limit on a resource that apply to its single value."""
        if self.path is not None:
            return replace(self, path=None)
        logic = tuple((operator, tuple(each.of_value() for each in members)) for operator, members in self.logic)
        return replace(self, parts=tuple(each.of_value() for each in self.parts), logic=logic)


def limit_part(shape: Shape, place: Place, space: Space) -> LimitPart:
    """Return the part of a limit at a place. Raises InexpressibleError."""
    if not shape.constraints:
        return LimitPart()
    at = _step(place, shape.path, space) if shape.is_property else place
    bounds, orders, parts, logic = [], [], [], []
    for each in shape.constraints:
        match each.parameter:
            case sh.lessThan | sh.lessThanOrEquals:
                orders.append((each.parameter, _number_beside(place, at, each.value, space)))
            case sh.property | sh.node:
                parts.append(limit_part(each.shapes[0], at, space))
            case sh.not_ | sh.and_ | sh.or_ | sh.xone:
                logic.append((each.parameter, tuple(limit_part(inner, at, space) for inner in each.shapes)))
            case _ if not _is_always_so(each, at, space):
                bounds.append(_bounds(each, at))
    kind, datatype = (at.primitive, at.datatype) if isinstance(at, ValuePlace) else (None, None)
    return LimitPart(shape.path, kind, datatype, tuple(bounds), tuple(orders), tuple(parts), tuple(logic), shape.words)


def _step(place: Place, path: NamedNode | None, space: Space) -> ValuePlace:
    """Return the place that a path leads to."""
    found = None if path is None else place.follow(path, space)
    if found is None or (found.primitive is None and not isinstance(found.kind, Nested)):
        raise InexpressibleError(f"{path} is not a field, or is that of an array")
    return found


def _number_beside(place: Place, at: Place, predicate: Term, space: Space) -> NamedNode:
    """Return the field with which a number is compared."""
    other = place.follow(predicate, space) if isinstance(predicate, NamedNode) else None
    if other is None or not (_is_number(at) and _is_number(other)) or not isinstance(predicate, NamedNode):
        raise InexpressibleError("only numbers of the same message can be compared")
    return predicate


def _is_number(place: Place) -> bool:
    kind = place.primitive if isinstance(place, ValuePlace) else None
    return kind is not None and kind.name != "bool" and kind.name not in STRINGS


def _is_always_so(constraint: Constraint, place: Place, space: Space) -> bool:
    """Whether every value of the type meets a constraint."""
    value = constraint.value
    if not isinstance(place, ValuePlace):
        return False
    match constraint.parameter:
        case sh.datatype:
            return value == place.datatype
        case sh.nodeKind:
            return value in (_NODES if place.primitive is None else _LITERALS)
        case sh.class_:
            return isinstance(place.kind, Nested) and value == NamedNode(space.class_of(place.kind.name))
        case sh.minCount:
            return isinstance(value, Literal) and value.value in ("0", "1")
        case sh.maxCount:
            return isinstance(value, Literal) and value.value != "0"
    return False


def _bounds(constraint: Constraint, place: Place) -> Bounds:
    """Return a constraint of a scalar as bounds."""
    kind = place.primitive if isinstance(place, ValuePlace) else None
    if kind is None:
        raise InexpressibleError("it does not concern a scalar")
    bounds, value = constraint.bounds, constraint.value
    if bounds == bounds.range:
        is_of_value = _is_number(place) and isinstance(value, Literal) and is_numeric(value.datatype)
    else:
        is_of_value = bool(bounds.choices) or kind.name in STRINGS
    if not bounds or not is_of_value:
        raise InexpressibleError(f"{constraint.parameter} concerns the lexical form of a value")
    return bounds


def write_limit(writer: ShapesWriter, values: AcceptedValues, part: LimitPart) -> BlankNode:
    """Write the shape of a part."""
    return writer.blank(*limit_statements(writer, values, part))


def limit_statements(writer: ShapesWriter, values: AcceptedValues, part: LimitPart) -> Iterator[Statement]:
    """Yield the statements about the shape of a part."""
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
    """Constraints of limits on a message or a value, beyond its type.

    `bounds` are those of single scalars, by dotted path ("" is the value itself). `value_parts` are limits that need
    more than bounds, by the same paths, and `type_parts` those on all messages of a type, by its name. `is_all` is
    False if there are limits that none of these can express. `largest` is the largest absolute value of all floats,
    which are finite; None if floats are unrestricted.
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
        """Return the demand on the value at a path, if written alone; `is_all` is False if there is more."""
        bounds = [("", each) for where, each in self.bounds if where == path]
        parts = [("", each) for where, each in self.value_parts if where == path]
        is_all = self.is_all and len(parts) == len(self.value_parts) and not self.type_parts
        return Demand(bounds, is_all, parts, largest=self.largest)


NO_DEMAND = Demand()


def limited_texts(demand: Demand, schema: MessageSchema, space: Space) -> frozenset[NamedNode]:
    """Return the properties of all fields of a message, including nested ones, that are texts with limits."""
    paths = [path for path, _ in demand.bounds]
    paths += [path for path, part in demand.value_parts if path and bounds_text(part)]
    found = [_property_at(schema, path, space) for path in paths]
    parts = (part for _, part in (*demand.value_parts, *demand.type_parts))
    return frozenset(
        [*(each for each in found if each is not None), *(each for part in parts for each in _texts(part))]
    )


def is_limited_text(kind: Primitive, demand: Demand) -> bool:
    """Whether a scalar is a text that has limits."""
    return kind.name in STRINGS and (bool(demand.bounds) or any(bounds_text(part) for _, part in demand.value_parts))


def bounds_text(part: LimitPart) -> bool:
    """Whether a part is about a text: its own value, or one within."""
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
    """Return the last property of a dotted path, if that leads to a text."""
    for name, field in fields_along(schema, path)[-1:]:
        if isinstance(field.type, Primitive) and field.type.name in STRINGS:
            return NamedNode(space.property_of(name, field.name))
    return None
