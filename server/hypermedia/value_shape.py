"""The shape of a property's value: its ROS type, what limits demand of it, and what it measures. Pure."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from pyoxigraph import Literal

from rosld.adapters.model import Array, Descriptor, MessageSchema, Nested, Primitive
from rosld.server.hypermedia.catalogue import MessageKind, ScalarKind, ValueKind
from rosld.shapes.bounds import narrow
from rosld.shapes.parameter import declared_shape
from rosld.shapes.value import UNBOUNDED, Bounds, Measure, MessageShape, OpenShape, ScalarShape, ValueShape

if TYPE_CHECKING:
    from rosld.shapes.limits import Limits


def value_shape(kind: ValueKind, limits: Limits, url: str, measure: Measure) -> ValueShape:
    """What the value of the property at `url` is, and must be when it is written."""
    bounds = limits.bounds_of_resource(url)
    match kind:
        case ScalarKind(primitive=primitive, choices=choices):
            return ScalarShape(primitive, narrow(bounds, Bounds(choices=tuple(map(Literal, choices)))), measure)
        case MessageKind():
            names = tuple(field.name for field in kind.fields)
            return MessageShape(kind.schema, names, limits.bounds_of_message(kind.schema))
        case _:
            return OpenShape(bounds, measure)


def with_descriptor(shape: ValueShape, descriptor: Descriptor) -> ValueShape:
    """The shape of a value that is a parameter's, with what the node declares of that."""
    if isinstance(shape, MessageShape):
        return shape
    declared = declared_shape(descriptor, shape.measure)
    bounds = narrow(shape.bounds, declared.bounds)
    return replace(declared if isinstance(shape, OpenShape) else shape, bounds=bounds)


def has_scalar(kind: ValueKind, path: str) -> bool:
    """Whether a value may have a scalar at a dotted path; where its type is not known it may have any."""
    match kind:
        case ScalarKind():
            return "." not in path
        case MessageKind(schema=schema, fields=fields):
            return path.partition(".")[0] in {one.name for one in fields} and _primitive(schema, path) is not None
    return True


def field_shape(shape: ValueShape, path: str, bounds: Bounds, measure: Measure) -> ValueShape:
    """What one field of a value is (`pose.position.x`); open where the type has no such scalar.

    `bounds` are those of the field's own resource; its type's hold as well.
    """
    if isinstance(shape, ScalarShape) and "." not in path:  # a message of one scalar is that scalar
        return replace(shape, bounds=narrow(bounds, shape.bounds), measure=measure)
    kind = _primitive(shape.schema, path) if isinstance(shape, MessageShape) else None
    if kind is None or not isinstance(shape, MessageShape):
        return OpenShape(bounds, measure)
    return ScalarShape(kind, narrow(bounds, shape.bounds.get(path, UNBOUNDED)), measure)


def _primitive(schema: MessageSchema, path: str) -> Primitive | None:
    """The primitive at a dotted path; numbers are places in an array."""
    kind: object = Nested(schema.ref.name)
    for step in path.split("."):
        if isinstance(kind, Array):
            if not step.isdecimal():
                return None
            kind = kind.element
            continue
        if not isinstance(kind, Nested):
            return None
        kind = next((field.type for field in schema.types[kind.name].fields if field.name == step), None)
    return kind if isinstance(kind, Primitive) else None
