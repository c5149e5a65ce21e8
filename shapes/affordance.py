"""Shapes of requests: a `ValueShape` as SHACL, for affordances."""

from __future__ import annotations

from collections.abc import Mapping

from pyoxigraph import NamedNode, Triple

from rosld.adapters.model import Array, MessageSchema, Nested, Primitive
from rosld.ontology.coercion import RANGES
from rosld.ontology.literals import DATATYPES
from rosld.ontology.triples import Value, integer, statements
from rosld.ontology.urls import Space
from rosld.ontology.vocab import rdf, ros, sh, xsd
from rosld.shapes.value import UNBOUNDED, Bounds, MessageShape, OpenShape, ScalarShape, ValueShape, narrow
from rosld.shapes.writer import ShapesWriter, within


def value_shape_triples(shape: ValueShape, node: NamedNode, path: NamedNode, space: Space) -> list[Triple]:
    """Return the triples of the node shape `node` for subjects with one such value of `path` (SHACL 2.1).

    Nested nodes are fragments derived from `node` (`#shape.value`); a message's own shape is referenced by its URL.
    """
    writer, value = ShapesWriter(node.value), within(node, "value")
    one = ((sh.minCount, integer(1)), (sh.maxCount, integer(1)))
    writer.add(node, (rdf.type, sh.NodeShape), (sh.property, value))
    writer.add(value, (rdf.type, sh.PropertyShape), (sh.path, path), *one)
    if isinstance(shape, MessageShape):
        _write_message(writer, value, shape, space)
    else:
        _write_scalar(writer, value, shape)
    return writer.triples


def _write_scalar(writer: ShapesWriter, node: NamedNode, shape: ScalarShape | OpenShape) -> None:
    """Write the constraints on a literal: the datatype of its primitive, its range and bounds."""
    kind, bounds, datatype = shape.kind, shape.bounds, None
    if kind is not None:
        least, greatest = RANGES.get(kind.name, (None, None))
        bounds = narrow(bounds, Bounds(integer(least), integer(greatest), max_length=kind.bound))
        is_integer = shape.is_parameter and least is not None  # all integers of parameters are xsd:integer
        datatype = xsd.integer if is_integer else NamedNode(xsd.iri + DATATYPES[kind.name])
    writer.add(
        node,
        (sh.datatype, datatype),
        *bounds.range_statements,
        *bounds.text_statements,
        (ros.step, bounds.step),
        *shape.quantity.statements,
        (sh.in_, writer.list_of(bounds.choices) if bounds.choices else None),
    )


def _write_message(writer: ShapesWriter, node: NamedNode, shape: MessageShape, space: Space) -> None:
    """Write all statements of the type's shape; for some of its fields, the statements about each of these."""
    kind = shape.schema.type
    type_shape = NamedNode(space.shape(kind.name))
    if shape.fields == kind.fields:
        writer.add(node, (sh.class_, NamedNode(space.class_of(kind.name))), (sh.node, type_shape))
    else:
        parts = [within(type_shape, field.name) for field in shape.fields]
        writer.add(node, (sh.nodeKind, sh.BlankNodeOrIRI), *statements(sh.property, parts))
    _write_bounds(writer, node, shape.schema, kind.name, shape.bounds, space)


def _write_bounds(
    writer: ShapesWriter, node: NamedNode, schema: MessageSchema, kind: str, bounds: Mapping[str, Bounds], space: Space
) -> None:
    """Write property shapes within `node` for the bounds; those of an array of messages apply to each element."""
    for field in schema.types[kind].fields:
        start = f"{field.name}."
        below = {path.removeprefix(start): each for path, each in bounds.items() if path.startswith(start)}
        if field.name not in bounds and not below:
            continue
        inner, element = within(node, field.name), field.type
        path: Value = NamedNode(space.property_of(kind, field.name))
        if isinstance(element, Array) and isinstance(element.element, Nested):
            # A path is a blank node: an IRI would be a predicate (SHACL 2.3.1).
            path = writer.list_of([path, writer.blank((sh.zeroOrMorePath, rdf.rest)), rdf.first])
            element = element.element
        writer.add(node, (sh.property, inner))
        writer.add(inner, (rdf.type, sh.PropertyShape), (sh.path, path))
        own = bounds.get(field.name, UNBOUNDED)
        if isinstance(element, Nested):
            _write_bounds(writer, inner, schema, element.name, below, space)
        else:
            scalar = ScalarShape(element, own) if isinstance(element, Primitive) else OpenShape(own)
            _write_scalar(writer, inner, scalar)
