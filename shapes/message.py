"""SHACL shapes of message types, as this server writes messages (SHACL 1.0 Core).

A shape says what the datatypes of XSD and the classes do not say by themselves: each field is there exactly once, the
range of integers, the length of strings and arrays, what may stand for a value that is too large to be written. The
shape of a type is the resource `/shapes/PKG/msg/NAME`, the property shape of a field is the fragment of its name. Types
nested in it have shapes of their own there (`#std_msgs/msg/Header`), so that one document is all that a validator
needs. Each has its class as its target, so that none holds another: validators bound how deep shapes may nest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from pyoxigraph import Literal, NamedNode

from rosld.adapters.model import (
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
from rosld.ontology.coercion import RANGES
from rosld.ontology.describe_types import constant_value, definition_text
from rosld.ontology.document import Document
from rosld.ontology.json_leaves import stated_default
from rosld.ontology.literals import DATATYPES, OCTETS, STRINGS, base64_length
from rosld.ontology.triples import RDF_SOURCE, Statement, Value, boolean, integer, statements, text, triples_about
from rosld.ontology.urls import Space
from rosld.ontology.vocab import rdf, rdfs, ros, sh, xsd
from rosld.shapes.writer import ShapesWriter, list_of, within, write_list_shape

SERVER_MANAGED = (rdf.type, ros.received, ros.sequence, ros.sentBy, ros.latched, ros.dateTime)
"""What a message node may say beside its fields."""

SHACL_SHACL = "http://www.w3.org/ns/shacl-shacl#"
"""The shapes of shapes graphs (SHACL 1.0, appendix C)."""

_LONGEST_PATTERN = 1000
_NUMBER = r"[^,\[\]{}]+"


def shape_document(schema: Schema, space: Space) -> Document:
    """Return the shape of a message type, or links to the shapes of the messages of a service or an action."""
    name = schema.ref.name
    url = space.shape(name)
    if isinstance(schema, MessageSchema):
        writer = ShapesWriter(url)
        writer.add(writer.node(), *RDF_SOURCE)
        write_message_shapes(writer, schema, space, _Said(writer, schema, space))
        return Document(url, tuple(writer.triples))
    halves = [NamedNode(space.shape(half.ref.name)) for half in halves_of(schema)]
    label = (rdfs.label, text(f"What {name} is sent and answers"))
    triples = triples_about(NamedNode(url), *RDF_SOURCE, label, *zip(_HALVES[type(schema)], halves, strict=True))
    return Document(url, tuple(triples))


_HALVES: Mapping[type, Sequence[NamedNode]] = {
    ServiceSchema: (ros.requestShape, ros.responseShape),
    ActionSchema: (ros.goalShape, ros.resultShape, ros.feedbackShape),
}


class FieldShapes(Protocol):
    """Shapes of the values of fields, by kind."""

    def node(self, name: str) -> NamedNode:
        """Return the node shape of a type."""
        ...

    def is_required(self, kind: MessageType) -> bool:
        """Whether messages must state each field of a type."""
        ...

    def primitive(self, kind: Primitive) -> Sequence[Statement]:
        """Return the statements of a scalar."""
        ...

    def nested(self, name: str) -> Sequence[Statement]:
        """Return the statements of a nested message, by the name of its type."""
        ...

    def array(self, kind: Array, element: Primitive) -> Sequence[Statement]:
        """Return the statements of an array of primitives."""
        ...

    def messages(self, kind: Array, name: str) -> Sequence[Statement]:
        """Return the statements of an array of messages, by the name of their type."""
        ...

    def message(self, kind: MessageType) -> Sequence[Statement]:
        """Return the statements of a message's node itself, and its targets."""
        ...


def write_message_shapes(writer: ShapesWriter, schema: MessageSchema, space: Space, fields: FieldShapes) -> None:
    """Write the shapes of all types of a schema, and those of their fields, by the names that `fields` has for them."""
    for kind in (schema.type, *(kind for name, kind in schema.types.items() if name != schema.ref.name)):
        _write_type(writer, kind, space, fields)


def _write_type(writer: ShapesWriter, kind: MessageType, space: Space, fields: FieldShapes) -> None:
    """Write the node shape of a type. Constants are included, but need not be stated in messages."""
    node = fields.node(kind.name)
    properties = {field: within(node, field.name) for field in kind.fields}
    values = [(constant, constant_value(constant)) for constant in kind.constants]
    writer.add(
        node,
        (rdf.type, sh.NodeShape),
        (rdfs.label, text(kind.name)),
        *statements(
            rdfs.comment, [Literal(f"{one.name} = {value.value}") for one, value in values if value is not None]
        ),
        (sh.closed, boolean(True)),
        *statements(sh.property, properties.values()),
        *fields.message(kind),
    )
    least = 1 if fields.is_required(kind) else None
    for position, (field, property) in enumerate(properties.items()):
        writer.add(
            property,
            (rdf.type, sh.PropertyShape),
            (sh.path, NamedNode(space.property_of(kind.name, field.name))),
            (sh.name, text(field.name)),
            (sh.description, text(definition_text(field.type))),
            (sh.order, integer(position)),
            (sh.minCount, integer(least)),
            (sh.maxCount, integer(1)),
            (sh.defaultValue, _default(field)),
            *_value(field.type, fields),
        )


def _value(kind: FieldType, fields: FieldShapes) -> Sequence[Statement]:
    if isinstance(kind, Primitive):
        return fields.primitive(kind)
    if isinstance(kind, Nested):
        return fields.nested(kind.name)
    element = kind.element
    return fields.array(kind, element) if isinstance(element, Primitive) else fields.messages(kind, element.name)


class _Said:
    """The values of fields as this server says them.

    Strings and arrays may be elided. In ROS 1 a string that is not UTF-8 comes as octets.
    """

    def __init__(self, writer: ShapesWriter, schema: MessageSchema, space: Space) -> None:
        self._writer = writer
        self._space = space
        self._root = schema.ref.name
        self._binary_strings = not (schema.ref.hash or "").startswith("RIHS")
        kinds = [field.type for kind in schema.types.values() for field in kind.fields]
        if any(isinstance(kind, Array) or kind.name in STRINGS for kind in kinds):
            self._write_elided()
        if any(isinstance(kind, Array) and isinstance(kind.element, Nested) for kind in kinds):
            write_list_shape(writer)

    def node(self, name: str) -> NamedNode:
        return self._writer.node("" if name == self._root else name)

    def is_required(self, kind: MessageType) -> bool:
        return True

    def _write_elided(self) -> None:
        writer, one = self._writer, [(sh.minCount, integer(1)), (sh.maxCount, integer(1))]
        count = ((sh.datatype, xsd.integer), (sh.minInclusive, integer(0)))
        length = writer.blank((sh.path, ros.elidedLength), *count, *one)
        place = writer.blank((sh.path, ros.bytes), (sh.nodeKind, sh.IRI), *one)
        writer.add(
            self._elided_node,
            (rdf.type, sh.NodeShape),
            (rdfs.label, text("What stands for a value that is too large to be written")),
            (sh.class_, ros.Elided),
            *statements(sh.property, [length, place]),
        )

    @property
    def _elided_node(self) -> NamedNode:
        return self._writer.node("elided")

    def _or_elided(self, *shapes: Value) -> list[Statement]:
        return [self._writer.either([*shapes, self._elided_node])]

    def primitive(self, kind: Primitive) -> Sequence[Statement]:
        datatype = NamedNode(xsd.iri + DATATYPES[kind.name])
        if kind.name in STRINGS:
            string = self._writer.blank((sh.datatype, datatype), (sh.maxLength, integer(kind.bound)))
            octets = [self._writer.blank((sh.datatype, xsd.base64Binary))] if self._binary_strings else []
            return self._or_elided(string, *octets)
        least, greatest = RANGES.get(kind.name, (None, None))
        # XSD has these ranges in its datatypes, but not every validator looks into them.
        return [(sh.datatype, datatype), (sh.minInclusive, integer(least)), (sh.maxInclusive, integer(greatest))]

    def nested(self, name: str) -> Sequence[Statement]:
        return [(sh.class_, NamedNode(self._space.class_of(name)))]

    def array(self, kind: Array, element: Primitive) -> Sequence[Statement]:
        said = _octets(kind) if element.name in OCTETS else _json(kind, element)
        return self._or_elided(self._writer.blank(*said))

    def messages(self, kind: Array, name: str) -> Sequence[Statement]:
        return self._or_elided(list_of(self._writer, self.nested(name), kind))

    def message(self, kind: MessageType) -> Sequence[Statement]:
        ignored = self._writer.list_of(SERVER_MANAGED)
        return [
            (sh.targetClass, NamedNode(self._space.class_of(kind.name))),
            (sh.ignoredProperties, ignored),
        ]  # fmt: skip


def _default(field: Field) -> Literal | None:
    """The default value that the definition of a scalar states: a form may be filled with it, a message must say it."""
    stated = field.default
    if isinstance(stated, tuple | None) or not isinstance(field.type, Primitive) or stated_default(field) is None:
        return None
    return constant_value(Constant(field.name, field.type.name, stated))


def _octets(kind: Array) -> list[Statement]:
    """Return an array of octets: one base64 literal."""
    return [
        (sh.datatype, xsd.base64Binary),
        (sh.minLength, integer(base64_length(kind.length))),
        (sh.maxLength, integer(base64_length(kind.most))),
    ]


def _json(kind: Array, element: Primitive) -> list[Statement]:
    """An array of numbers, bools or strings: one rdf:JSON literal, whose length a pattern can tell for numbers."""
    return [(sh.datatype, rdf.JSON), (sh.pattern, text(_pattern(kind)) if element.name not in STRINGS else None)]


def _pattern(kind: Array) -> str | None:
    """Return a pattern of arrays of the right length; None where it would be too long to be of use."""
    least, limit = (kind.length, kind.length) if kind.length is not None else (0, kind.bound)
    if limit is None or limit > _LONGEST_PATTERN:
        return None
    if limit == 0:
        return r"^\s*\[\s*\]\s*$"
    more = f"{{{max(0, (least or 0) - 1)},{limit - 1}}}" if least != limit else f"{{{limit - 1}}}"
    body = rf"{_NUMBER}(,{_NUMBER}){more}"
    return rf"^\s*\[{body}\]\s*$" if least else rf"^\s*\[({body}|\s*)\]\s*$"
