"""Shapes of requests: a `ValueShape` as SHACL, for affordances."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from rosld.adapters.model import Array, MessageSchema, Nested, Primitive
from rosld.ontology.coercion import RANGES
from rosld.ontology.literals import DATATYPES
from rosld.ontology.triples import Statement, Value, integer, statements, text, triples_about
from rosld.ontology.urls import Space
from rosld.ontology.vocab import qudt, rdf, ros, sh, xsd
from rosld.shapes.value import UNBOUNDED, Bounds, MessageShape, OpenShape, ScalarShape, ValueShape, narrow
from rosld.shapes.writer import within


def value_shape_triples(shape: ValueShape, node: NamedNode, path: NamedNode, space: Space) -> list[Triple]:
    """The node shape `node` of what has one such value by the predicate `path` (SHACL 2.1).

    Nodes within it are fragments beside `node` (`#shape.value`); a message's own shape is referred to by its URL.
    """
    value = within(node, "value")
    triples = triples_about(node, (rdf.type, sh.NodeShape), (sh.property, value))
    triples += triples_about(
        value, (rdf.type, sh.PropertyShape), (sh.path, path), (sh.minCount, integer(1)), (sh.maxCount, integer(1))
    )
    if isinstance(shape, MessageShape):
        return triples + _message(shape, value, space)
    return triples + _scalar(value, shape)


def _scalar(node: NamedNode, shape: ScalarShape | OpenShape) -> list[Triple]:
    """Return the constraints on a literal: the datatype of its primitive, its range and bounds."""
    kind, bounds, measure = shape.kind, shape.bounds, shape.measure
    datatype = None
    if kind is not None:
        least, greatest = RANGES.get(kind.name, (None, None))
        bounds = narrow(bounds, Bounds(integer(least), integer(greatest), max_length=kind.bound))
        is_integer = shape.is_parameter and least is not None  # all integers of parameters are xsd:integer
        datatype = xsd.integer if is_integer else NamedNode(xsd.iri + DATATYPES[kind.name])
    triples = triples_about(
        node,
        (sh.datatype, datatype),
        (sh.minInclusive, bounds.minimum),
        (sh.maxInclusive, bounds.maximum),
        (sh.minExclusive, bounds.exclusive_minimum),
        (sh.maxExclusive, bounds.exclusive_maximum),
        (sh.pattern, text(bounds.pattern)),
        (sh.minLength, integer(bounds.min_length)),
        (sh.maxLength, integer(bounds.max_length)),
        (ros.step, bounds.step),
        (qudt.hasUnit, measure.unit),
        (qudt.hasQuantityKind, measure.quantity_kind),
    )
    if bounds.choices:
        head, cells = _list_triples(within(node, "in"), bounds.choices)
        triples += [*triples_about(node, (sh.in_, head)), *cells]
    return triples


def _message(shape: MessageShape, node: NamedNode, space: Space) -> list[Triple]:
    """What a message must be: all that its type's shape says or, of a part of its fields, what that says of each."""
    kind = shape.schema.type
    type_shape = space.shape(kind.name)
    if shape.fields == kind.fields:
        said: list[Statement] = [(sh.class_, NamedNode(space.class_of(kind.name))), (sh.node, NamedNode(type_shape))]
    else:
        parts = [within(NamedNode(type_shape), field.name) for field in shape.fields]
        said = [(sh.nodeKind, sh.BlankNodeOrIRI), *statements(sh.property, parts)]
    return triples_about(node, *said) + _bounds_triples(node, kind.name, shape.schema, _tree(shape.bounds), space)


class _Bounded(dict[str, "_Bounded"]):
    """Fields by name, each with the bounds of its own value."""

    bounds: Bounds = UNBOUNDED


def _tree(bounds: Mapping[str, Bounds]) -> _Bounded:
    root = _Bounded()
    for path, demanded in bounds.items():
        place = root
        for step in path.split("."):
            place = place.setdefault(step, _Bounded())
        place.bounds = demanded
    return root


def _bounds_triples(node: NamedNode, kind: str, schema: MessageSchema, tree: _Bounded, space: Space) -> list[Triple]:
    """Property shapes within `node` that lead to the bounds; those of an array of messages hold for each element."""
    triples: list[Triple] = []
    for field in schema.types[kind].fields:
        if field.name not in tree:
            continue
        inner, property = within(node, field.name), NamedNode(space.property_of(kind, field.name))
        triples += triples_about(node, (sh.property, inner)) + triples_about(inner, (rdf.type, sh.PropertyShape))
        element = field.type
        if isinstance(element, Array) and isinstance(element.element, Nested):
            element = element.element
            # A path is a blank node: an IRI would be a predicate (SHACL 2.3.1).
            rest = BlankNode(_label(inner) + "-rest")
            head, cells = _list_triples(within(inner, "path"), (property, rest, rdf.first))
            triples += [
                *triples_about(inner, (sh.path, head)),
                *triples_about(rest, (sh.zeroOrMorePath, rdf.rest)),
                *cells,
            ]
        else:
            triples += triples_about(inner, (sh.path, property))
        if isinstance(element, Nested):
            triples += _bounds_triples(inner, element.name, schema, tree[field.name], space)
        else:
            bounds = tree[field.name].bounds
            triples += _scalar(
                inner, ScalarShape(element, bounds) if isinstance(element, Primitive) else OpenShape(bounds)
            )
    return triples


def _list_triples(name: NamedNode, elements: Iterable[NamedNode | BlankNode | Literal]) -> tuple[Value, list[Triple]]:
    """Return an rdf:List, whose cells are blank: its head and its triples."""
    cells: list[Triple] = []
    rest: Value = rdf.nil
    for number, element in reversed(list(enumerate(elements))):
        cell = BlankNode(f"{_label(name)}-{number}")
        cells += triples_about(cell, (rdf.first, element), (rdf.rest, rest))
        rest = cell
    return rest, cells


def _label(name: NamedNode) -> str:
    """Return a label for blank nodes that belong to a node: no other node's, within one document or many."""
    return "".join(letter if letter.isascii() and letter.isalnum() else f"-{ord(letter):x}-" for letter in name.value)
