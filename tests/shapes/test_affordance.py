"""Shapes of requests: pyshacl accepts valid bodies and rejects others."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from pyoxigraph import Literal, NamedNode, Triple

from rosld.adapters.model import Primitive
from rosld.ontology.lift import lifter
from rosld.ontology.lower import lowerer
from rosld.ontology.units import Quantity
from rosld.ontology.urls import Space
from rosld.ontology.vocab import qudt, rdf, sh, xsd
from rosld.shapes.affordance import value_shape_triples
from rosld.shapes.message import shape_document
from rosld.shapes.shapes_graph import ShapesGraph, compile_shape
from rosld.shapes.value import Bounds, MessageShape, OpenShape, ScalarShape, ValueShape
from tests.shapes.values import compiled, graph, schema_of, typed, validate

SPACE = Space("http://127.0.0.1:8080/")
URL = "http://127.0.0.1:8080/resources/a"
SHAPE = NamedNode(URL + "#shape")
ONE = typed("1.0", xsd.double)
SPEED = NamedNode("https://w3id.org/rosld/aircraft#speed")


def conforms(
    shape: ValueShape, data: Sequence[Triple], path: NamedNode = rdf.value, more: Sequence[Triple] = ()
) -> bool:
    shapes = [*value_shape_triples(shape, SHAPE, path, SPACE), *more, Triple(SHAPE, sh.targetNode, NamedNode(URL))]
    return validate(graph(data), compiled(graph(shapes)))[0]


def of(*values: Literal, path: NamedNode = rdf.value) -> list[Triple]:
    return [Triple(NamedNode(URL), path, value) for value in values]


def test_a_mapped_property_is_by_its_predicate_and_tells_its_unit() -> None:
    unit = NamedNode("http://qudt.org/vocab/unit/KN")
    shape = ScalarShape(Primitive("float64"), quantity=Quantity(unit=unit.value))
    assert conforms(shape, of(ONE, path=SPEED), SPEED)
    assert not conforms(shape, of(ONE), SPEED)
    assert Triple(NamedNode(URL + "#shape.value"), qudt.hasUnit, unit) in value_shape_triples(
        shape, SHAPE, SPEED, SPACE
    )


def twist(x: float = 0.0, turn: float = 0.0) -> list[Triple]:
    return message("geometry_msgs/msg/Twist", {"linear": {"x": x}, "angular": {"x": turn}})


def message(name: str, values: dict[str, object]) -> list[Triple]:
    schema = schema_of(name)
    triples = lifter(schema).triples(lowerer(schema).from_json(values, defaults=True), URL, "#value")
    return [Triple(NamedNode(URL), rdf.value, NamedNode(URL + "#value")), *triples]


def whole(name: str, **bounds: Bounds) -> MessageShape:
    schema = schema_of(name)
    dotted = {path.replace("_", "."): each for path, each in bounds.items()}
    return MessageShape(schema, schema.type.fields, dotted)


def test_a_message_is_of_its_types_shape_and_within_the_bounds_of_its_fields() -> None:
    name = "geometry_msgs/msg/Twist"
    shape, types = (
        whole(name, linear_x=Bounds(maximum=typed("1000", xsd.integer))),
        shape_document(schema_of(name), SPACE).triples,
    )
    assert conforms(shape, twist(1000.0, 5000.0), more=types)
    assert not conforms(shape, twist(1000.5), more=types)
    assert not conforms(shape, [t for t in twist() if not t.predicate.value.endswith("Twist#angular")], more=types)
    assert not conforms(shape, of(ONE), more=types)


def test_a_part_of_a_messages_fields_needs_no_others() -> None:
    schema = schema_of("geometry_msgs/msg/Twist")
    shape, types = MessageShape(schema, schema.type.fields[:1]), shape_document(schema, SPACE).triples
    untyped = [t for t in twist() if (t.subject, t.predicate) != (NamedNode(URL + "#value"), rdf.type)]
    without = [t for t in untyped if not t.predicate.value.endswith("Twist#angular")]
    assert conforms(shape, without, more=types)
    assert not conforms(shape, [t for t in untyped if not t.predicate.value.endswith("Twist#linear")], more=types)


def test_bounds_within_an_array_hold_for_each_element() -> None:
    name = "geometry_msgs/msg/Polygon"
    shape = whole(name, points_x=Bounds(maximum=typed("5", xsd.integer)))
    types = shape_document(schema_of(name), SPACE).triples
    for x, holds in ((5.0, True), (6.0, False)):
        points = [{"x": each, "y": 9.0} for each in (1.0, x)]
        assert conforms(shape, message(name, {"points": points}), more=types) is holds


@pytest.mark.parametrize(
    "shape",
    [
        ScalarShape(Primitive("string"), Bounds(choices=(Literal("on"),), pattern="^o", min_length=1)),
        whole("geometry_msgs/msg/Twist", linear_x=Bounds(minimum=typed("0", xsd.integer))),
        OpenShape(),
    ],
)
def test_the_shape_can_be_compiled_and_its_nodes_are_fragments(shape: ValueShape) -> None:
    triples = value_shape_triples(shape, SHAPE, rdf.value, SPACE)
    of_twist = shape_document(schema_of("geometry_msgs/msg/Twist"), SPACE).triples
    compile_shape(ShapesGraph([*triples, *of_twist]), SHAPE)
    shapes = {t.subject for t in triples if t.predicate not in (rdf.first, rdf.rest, sh.zeroOrMorePath)}
    assert all(isinstance(each, NamedNode) and each.value.startswith(URL + "#shape") for each in shapes)
