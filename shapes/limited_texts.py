"""Text that limits are about: it is written as text, since no shape could look at the characters of octets."""

from __future__ import annotations

from collections.abc import Iterator

from pyoxigraph import NamedNode

from rosld.adapters.model import Array, FieldType, MessageSchema, Nested, Primitive
from rosld.ontology.literals import STRINGS
from rosld.ontology.urls import Space
from rosld.shapes.demand import Demand
from rosld.shapes.limit_parts import LimitPart


def limited_texts(demand: Demand, schema: MessageSchema, space: Space) -> frozenset[NamedNode]:
    """The properties of all fields of a message, and of those within, that are texts with limits."""
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
    """The properties in a part that lead to texts."""
    path = part.path or above
    if path is not None and _is_text(part):
        yield path
    for inner in _inner(part):
        yield from _texts(inner, path)


def _property_at(schema: MessageSchema, path: str, space: Space) -> NamedNode | None:
    """The property that a dotted path ends with, where that leads to text."""
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
