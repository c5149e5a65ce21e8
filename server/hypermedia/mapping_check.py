"""Shapes of property values by type and limits, and the parts of mappings that are missing or unavailable. Pure.

A missing part is no error, as the robot may provide it later; a misspelt name is the common exception.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator
from difflib import get_close_matches
from typing import TYPE_CHECKING

from msgspec.structs import replace

from rosld.adapters.model import Descriptor, MessageSchema, Primitive
from rosld.ontology.fields import type_at
from rosld.ontology.units import UNKNOWN, Quantity, quantity_at
from rosld.server.hypermedia.mapping import ComplexResource, MappedAction, MappedProperty
from rosld.shapes.parameter import declared_shape
from rosld.shapes.value import UNBOUNDED, Bounds, MessageShape, OpenShape, ScalarShape, ValueShape, narrow

if TYPE_CHECKING:
    from rosld.server.hypermedia.resource_tree import ResourceTree
    from rosld.shapes.limits import Limits


def limited_shape(shape: ValueShape, limits: Limits, url: str, quantity: Quantity) -> ValueShape:
    """Return the shape of the value of the property at `url` within its limits, for reads and writes.

    `quantity` is what the mapping states; without it, that of the type counts.
    """
    if isinstance(shape, MessageShape):
        return dataclasses.replace(shape, bounds=limits.bounds_of_message(shape.schema))
    return replace(
        shape, bounds=narrow(limits.bounds_of_resource(url), shape.bounds), quantity=_either(quantity, shape.quantity)
    )


def with_descriptor(shape: ValueShape, descriptor: Descriptor) -> ValueShape:
    """Return the shape of a parameter's value with the constraints that the node declares."""
    if isinstance(shape, MessageShape):
        return shape
    declared = declared_shape(descriptor, shape.quantity)
    bounds = narrow(shape.bounds, declared.bounds)
    return replace(declared if isinstance(shape, OpenShape) else shape, bounds=bounds)


def has_scalar(shape: ValueShape, path: str) -> bool:
    """Whether a value may have a scalar at a dotted path; a value of unknown type may have any."""
    match shape:
        case ScalarShape():
            return "." not in path
        case MessageShape(schema, fields):
            return path.partition(".")[0] in {one.name for one in fields} and _primitive(schema, path) is not None
    return True


def field_shape(shape: ValueShape, path: str, bounds: Bounds, quantity: Quantity) -> ValueShape:
    """Return the shape of one field of a value (`pose.position.x`), open if the type has no such scalar.

    `bounds` are those of the field's own resource, in addition to those of its type.
    """
    if isinstance(shape, ScalarShape) and "." not in path:  # a message of one scalar is that scalar
        return replace(shape, bounds=narrow(bounds, shape.bounds), quantity=_either(quantity, shape.quantity))
    kind = _primitive(shape.schema, path) if isinstance(shape, MessageShape) else None
    if kind is None or not isinstance(shape, MessageShape):
        return OpenShape(bounds, quantity)
    quantity = _either(quantity, quantity_at(shape.schema, path))
    return ScalarShape(kind, narrow(bounds, shape.bounds.get(path, UNBOUNDED)), quantity)


def _either(stated: Quantity, by_type: Quantity) -> Quantity:
    return by_type if stated == UNKNOWN else stated


def _primitive(schema: MessageSchema, path: str) -> Primitive | None:
    """Return the primitive at a dotted path; numbers are indexes of arrays."""
    try:
        kind = type_at(schema, path)
    except ValueError:
        return None
    return kind if isinstance(kind, Primitive) else None


_MAX_NAMES = 5_000
"""Maximum number of names that are searched for a similar one."""


def warnings_of(resource: ComplexResource, tree: ResourceTree) -> tuple[str, ...]:
    """Return a sentence for each part of a mapped complex resource that is missing or unavailable."""
    found = [
        *(words for one in resource.properties for words in _of_property(one, tree)),
        *(words for one in resource.actions for words in _of_action(resource, one, tree)),
        *(
            f"map:target {one.target}: there is no such resource"
            for one in resource.links
            if one.target not in tree.paths
        ),
        *_of_conditions(resource, tree),
        *_of_stops(resource, tree),
    ]
    return tuple(f"{resource.path}: {words}." for words in dict.fromkeys(found))


def _of_property(mapped: MappedProperty, tree: ResourceTree) -> Iterator[str]:
    properties = tree.catalogue.properties
    found = properties.get(mapped.member)
    if found is None:
        yield f"map:member {mapped.member}: no such topic, parameter or getter" + _near(mapped.member, properties)
    elif mapped.field is not None and not has_scalar(found.shape, mapped.field):
        yield f"map:field {mapped.field}: {mapped.member} has no such scalar"
    elif mapped.writable_when and not found.writers:
        yield f"map:writableWhen of {mapped.member}: no topic, parameter or setter can write it"


def _of_action(resource: ComplexResource, mapped: MappedAction, tree: ResourceTree) -> Iterator[str]:
    plan = tree.action(resource.path + mapped.name)
    if plan is None:
        yield f"map:service {mapped.service}: there is no such service or action" + _near(
            mapped.service, tree.invocable
        )
    elif plan.schema is None:
        yield f"map:service {mapped.service}: it cannot be offered, because its type is not known"


def _of_conditions(resource: ComplexResource, tree: ResourceTree) -> Iterator[str]:
    for condition in resource.all_conditions():
        about = condition.about
        if about not in (tree.paths if about.endswith("/") else tree.catalogue.properties):
            yield f"map:about {about}: there is no such resource, so the condition never holds"


def _of_stops(resource: ComplexResource, tree: ResourceTree) -> Iterator[str]:
    for stop in (each.command for each in resource.stops):
        if stop.service is not None and stop.service not in tree.invocable:
            yield f"map:call {stop.service}: there is no such service" + _near(stop.service, tree.invocable)
        if stop.topic is not None and stop.topic not in tree.catalogue.by_topic:
            yield f"map:publish {stop.topic}: there is no such topic" + _near(stop.topic, tree.catalogue.by_topic)


def _near(name: str, names: Iterable[str]) -> str:
    """Return a phrase with the name most similar to a missing one, or an empty text."""
    known = list(names)
    close = get_close_matches(name, known, 1, 0.75) if len(known) <= _MAX_NAMES else ()
    return f" (there is {close[0]})" if close else ""
