"""SHACL shapes of message types, as this server writes messages (SHACL 1.0 Core).

A shape states what classes and XSD datatypes do not: each field exists exactly once, the range of integers, the length
of strings and arrays, the alternatives for a value that is elided. The shape of a type is the resource
`/shapes/PKG/msg/NAME`, the property shape of a field is the fragment of its name. Nested types have their own shapes
there (`#std_msgs/msg/Header`), so that a validator needs only one document. Each has its class as its target, so that
no shape contains another: validators limit the nesting of shapes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from pyoxigraph import Literal, NamedNode

from rosld.adapters.model import (
    STRINGS,
    ActionSchema,
    Array,
    Constant,
    Field,
    FieldType,
    MessageSchema,
    MessageType,
    Nested,
    Primitive,
    Schema,
    ServiceSchema,
    halves_of,
)
from rosld.ontology.coercion import RANGES, is_octets
from rosld.ontology.describe_types import constant_value, definition_text
from rosld.ontology.document import Document
from rosld.ontology.json_leaves import stated_default
from rosld.ontology.literals import DATATYPES, base64_length
from rosld.ontology.triples import RDF_SOURCE, Statement, Value, boolean, integer, statements, text, triples_about
from rosld.ontology.units import UNKNOWN, field_quantity
from rosld.ontology.urls import Space
from rosld.ontology.vocab import geo, rdf, rdfs, ros, sh, xsd
from rosld.shapes.writer import ShapesWriter, list_of, within

SERVER_MANAGED = (rdf.type, ros.received, ros.sequence, ros.sentBy, ros.latched, ros.dateTime, geo.hasGeometry)
"""Properties of message nodes besides their fields."""

SHACL_SHACL = "http://www.w3.org/ns/shacl-shacl#"
"""Shapes of shapes graphs (SHACL 1.0, appendix C)."""

_LONGEST_PATTERN = 1000
_NUMBER = r"[^,\[\]{}]+"


def shape_document(schema: Schema, space: Space) -> Document:
    """Return the shape of a message type, or links to the shapes of the messages of a service or an action."""
    name = schema.ref.name
    url = space.shape(name)
    if isinstance(schema, MessageSchema):
        writer = ShapesWriter(url)
        writer.add(writer.node(), *RDF_SOURCE)
        MessageShapes(writer, schema, space).write()
        return Document(url, tuple(writer.triples))
    halves = [NamedNode(space.shape(half.ref.name)) for half in halves_of(schema)]
    label = (rdfs.label, text(f"Request and response of {name}"))
    triples = triples_about(NamedNode(url), *RDF_SOURCE, label, *zip(_HALVES[type(schema)], halves, strict=True))
    return Document(url, tuple(triples))


_HALVES: Mapping[type, Sequence[NamedNode]] = {
    ServiceSchema: (ros.requestShape, ros.responseShape),
    ActionSchema: (ros.goalShape, ros.resultShape, ros.feedbackShape),
}


class MessageShapes:
    """Writer of the shapes of a message type and its nested types, as this server writes messages.

    Strings and arrays may be elided. In ROS 1, a string that is not UTF-8 is written as octets.
    """

    def __init__(self, writer: ShapesWriter, schema: MessageSchema, space: Space) -> None:
        self._writer = writer
        self._schema = schema
        self._space = space

    def write(self) -> None:
        """Write the shapes of all types, and those of their fields."""
        root = self._schema.ref.name
        for kind in (self._schema.type, *(kind for name, kind in self._schema.types.items() if name != root)):
            self._write_type(kind)

    def _write_type(self, kind: MessageType) -> None:
        """Write the node shape of a type. Constants are included, but need not be stated in messages."""
        add, node = self._writer.add, self.node(kind.name)
        properties = {field: within(node, field.name) for field in kind.fields}
        values = [(constant, constant_value(constant)) for constant in kind.constants]
        add(
            node,
            (rdf.type, sh.NodeShape),
            (rdfs.label, text(kind.name)),
            *((rdfs.comment, text(f"{one.name} = {value.value}")) for one, value in values if value is not None),
            (sh.closed, boolean(True)),
            *statements(sh.property, properties.values()),
            *self.message(kind),
        )
        for position, (field, property) in enumerate(properties.items()):
            add(
                property,
                (rdf.type, sh.PropertyShape),
                (sh.path, NamedNode(self._space.property_of(kind.name, field.name))),
                (sh.name, text(field.name)),
                (sh.description, text(definition_text(field.type))),
                (sh.order, integer(position)),
                (sh.minCount, integer(self.least(kind))),
                (sh.maxCount, integer(1)),
                (sh.defaultValue, _default(field)),
                *(field_quantity(kind.name, field) or UNKNOWN).statements,
                *self.value(field.type),
            )

    def node(self, name: str) -> NamedNode:
        """Return the node shape of a type."""
        return self._writer.node("" if name == self._schema.ref.name else name)

    def least(self, kind: MessageType) -> int | None:
        """Return the minimum number of statements of each field of a type in a message."""
        return 1

    def message(self, kind: MessageType) -> Sequence[Statement]:
        """Return the statements about a message's own node, and its targets."""
        target = NamedNode(self._space.class_of(kind.name))
        return [(sh.targetClass, target), (sh.ignoredProperties, self._writer.list_of(SERVER_MANAGED))]

    def value(self, kind: FieldType) -> Sequence[Statement]:
        """Return the statements of a field's value."""
        match kind:
            case Nested(name):
                return [(sh.class_, NamedNode(self._space.class_of(name)))]
            case Array(Nested(name)):
                return self._or_elided(list_of(self._writer, self.value(Nested(name)), kind))
            case Array():
                return self._or_elided(self._writer.blank(*_array(kind)))
        datatype = NamedNode(xsd.iri + DATATYPES[kind.name])
        if kind.name in STRINGS:
            string = self._writer.blank((sh.datatype, datatype), (sh.maxLength, integer(kind.bound)))
            is_binary = not (self._schema.ref.hash or "").startswith("RIHS")
            octets = [self._writer.blank((sh.datatype, xsd.base64Binary))] if is_binary else []
            return self._or_elided(string, *octets)
        least, greatest = RANGES.get(kind.name, (None, None))
        # XSD's datatypes have these ranges, but not every validator checks them.
        return [(sh.datatype, datatype), (sh.minInclusive, integer(least)), (sh.maxInclusive, integer(greatest))]

    def _or_elided(self, *shapes: Value) -> list[Statement]:
        writer, one = self._writer, [(sh.minCount, integer(1)), (sh.maxCount, integer(1))]

        def write() -> Iterator[Statement]:
            count = ((sh.datatype, xsd.integer), (sh.minInclusive, integer(0)))
            yield rdfs.label, text("Placeholder for a value that is too large to include")
            yield sh.class_, ros.Elided
            yield sh.property, writer.blank((sh.path, ros.elidedLength), *count, *one)
            yield sh.property, writer.blank((sh.path, ros.bytes), (sh.nodeKind, sh.IRI), *one)

        return [writer.either([*shapes, writer.shared("elided", write)])]


def _default(field: Field) -> Literal | None:
    """Return the default in the definition of a scalar: forms may use it, but messages must state it."""
    stated = field.default
    if isinstance(stated, tuple | None) or not isinstance(field.type, Primitive) or stated_default(field) is None:
        return None
    return constant_value(Constant(field.name, field.type.name, stated))


def _array(kind: Array) -> list[Statement]:
    """Return the shape of an array of primitives: base64 for octets, JSON for others, whose length a pattern checks."""
    if is_octets(kind):
        return [
            (sh.datatype, xsd.base64Binary),
            (sh.minLength, integer(base64_length(kind.length))),
            (sh.maxLength, integer(base64_length(kind.most))),
        ]
    return [(sh.datatype, rdf.JSON), (sh.pattern, text(None if kind.element.name in STRINGS else _pattern(kind)))]


def _pattern(kind: Array) -> str | None:
    """Return a pattern of arrays of the right length; None if it would be too long to be useful."""
    least, most = kind.length or 0, kind.most
    if most is None or most > _LONGEST_PATTERN:
        return None
    if most == 0:
        return r"^\s*\[\s*\]\s*$"
    body = rf"{_NUMBER}(,{_NUMBER}){{{max(0, least - 1)},{most - 1}}}"
    return rf"^\s*\[{body}\]\s*$" if least else rf"^\s*\[({body}|\s*)\]\s*$"
