"""SHACL shapes of message types: what a message must look like to be written (SHACL 1.0 Core).

A shape says what the datatypes of XSD and the classes do not say by themselves: each field is there exactly once, the
range of integers, the length of strings and arrays. The shape of a type is the resource `/shapes/PKG/msg/NAME`, the
property shape of a field is the fragment of its name.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import count

from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from rosld.adapters.model import (
    ActionSchema,
    Array,
    Constant,
    Field,
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
from rosld.ontology.field_defaults import stated_default
from rosld.ontology.literals import DATATYPES, OCTETS, STRINGS
from rosld.ontology.triples import RDF_SOURCE, Statement, Value, boolean, integer, statements, text, triples_about
from rosld.ontology.urls import Space
from rosld.ontology.vocab import rdf, rdfs, ros, sh, xsd

SERVER_MANAGED = (rdf.type, ros.received, ros.sequence, ros.sentBy, ros.latched, ros.dateTime)
"""What a message node may say beside its fields."""

_LONGEST_PATTERN = 1000
_NUMBER = r"[^,\[\]{}]+"


def shape_document(schema: Schema, space: Space) -> Document:
    """The shape of a message type, or those of the messages of a service or an action. Nested types have their own."""
    name = schema.ref.name
    url = space.shape(name)
    if isinstance(schema, MessageSchema):
        return Document(url, (*triples_about(NamedNode(url), *RDF_SOURCE), *type_shape(schema.type, schema, space)))
    halves = halves_of(schema)
    shapes = [NamedNode(space.shape(half.ref.name)) for half in halves]
    triples = triples_about(
        NamedNode(url),
        *RDF_SOURCE,
        (rdfs.label, text(f"What {name} is sent and answers")),
        *zip(_HALVES[type(schema)], shapes, strict=True),
    )
    for half in halves:
        triples += type_shape(half.type, half, space)
    return Document(url, tuple(triples))


_HALVES: Mapping[type, Sequence[NamedNode]] = {
    ServiceSchema: (ros.requestShape, ros.responseShape),
    ActionSchema: (ros.goalShape, ros.resultShape, ros.feedbackShape),
}


def shapes_closure(schema: MessageSchema, space: Space) -> list[Triple]:
    """The shapes of a message type and of all types nested in it: all that a validator needs."""
    return [triple for kind in schema.types.values() for triple in type_shape(kind, schema, space)]


def type_shape(kind: MessageType, schema: MessageSchema, space: Space) -> list[Triple]:
    """The node shape of one type of a schema."""
    return _Shape(kind, space, binary_strings=not (schema.ref.hash or "").startswith("RIHS")).triples()


class _Shape:
    """Writes the shape of one type. `binary_strings`: a string that is not UTF-8 may come as octets (ROS 1)."""

    def __init__(self, kind: MessageType, space: Space, *, binary_strings: bool) -> None:
        self.kind = kind
        self.space = space
        self.binary_strings = binary_strings
        self.url = space.shape(kind.name)
        self.blanks = (BlankNode(f"{kind.name.replace('/', '-')}-{number}") for number in count())
        self.inner: list[Triple] = []

    def triples(self) -> list[Triple]:
        """All of it."""
        properties = {field: NamedNode(self.space.fragment(self.url, field.name)) for field in self.kind.fields}
        triples = triples_about(
            NamedNode(self.url),
            (rdf.type, sh.NodeShape),
            (sh.targetClass, NamedNode(self.space.class_of(self.kind.name))),
            (rdfs.label, text(self.kind.name)),
            (sh.closed, boolean(True)),
            (sh.ignoredProperties, self.list_of(SERVER_MANAGED)),
            *statements(sh.property, properties.values()),
            *statements(rdfs.comment, self.comments()),
        )
        for position, (field, node) in enumerate(properties.items()):
            triples += triples_about(node, *self.field(field, position))
        return triples + self.inner

    def comments(self) -> list[Literal]:
        """The constants, which a field may but need not hold."""
        values = [(constant, constant_value(constant)) for constant in self.kind.constants]
        return [Literal(f"{constant.name} = {value.value}") for constant, value in values if value is not None]

    def field(self, field: Field, position: int) -> list[Statement]:
        """The property shape of a field."""
        return [
            (rdf.type, sh.PropertyShape),
            (sh.path, NamedNode(self.space.property_of(self.kind.name, field.name))),
            (sh.name, text(field.name)),
            (sh.description, text(definition_text(field.type))),
            (sh.order, integer(position)),
            (sh.minCount, integer(1)),
            (sh.maxCount, integer(1)),
            (sh.defaultValue, _default(field)),
            *self.value(field),
        ]

    def value(self, field: Field) -> list[Statement]:
        """What the value must be."""
        kind = field.type
        if isinstance(kind, Primitive):
            return self.primitive(kind)
        if isinstance(kind, Nested):
            return self.nested(kind.name)
        if isinstance(kind.element, Nested):
            self.elements(field, kind, kind.element)
            return [(sh.nodeKind, sh.BlankNodeOrIRI)]
        return octets(kind) if kind.element.name in OCTETS else array(kind, kind.element)

    def primitive(self, kind: Primitive) -> list[Statement]:
        """A scalar."""
        datatype = NamedNode(xsd.iri + DATATYPES[kind.name])
        if kind.name in STRINGS:
            if self.binary_strings:
                either = [self.blank((sh.datatype, each)) for each in (datatype, xsd.base64Binary)]
                return [(sh.or_, self.list_of(either))]
            return [(sh.datatype, datatype), (sh.maxLength, integer(kind.bound))]
        least, greatest = RANGES.get(kind.name, (None, None))
        # XSD has these ranges in its datatypes, but not every validator looks into them.
        return [(sh.datatype, datatype), (sh.minInclusive, integer(least)), (sh.maxInclusive, integer(greatest))]

    def nested(self, name: str) -> list[Statement]:
        """A message within a message."""
        return [(sh.class_, NamedNode(self.space.class_of(name))), (sh.node, NamedNode(self.space.shape(name)))]

    def elements(self, field: Field, kind: Array, element: Nested) -> None:
        """A second property shape for the elements of an rdf:List of messages."""
        steps: list[Value] = [
            NamedNode(self.space.property_of(self.kind.name, field.name)),
            self.blank((sh.zeroOrMorePath, rdf.rest)),
            rdf.first,
        ]
        node = NamedNode(self.space.fragment(self.url, field.name) + ".elements")
        self.inner += triples_about(NamedNode(self.url), (sh.property, node))
        self.inner += triples_about(
            node,
            (rdf.type, sh.PropertyShape),
            (sh.path, self.list_of(steps)),
            (sh.name, text(f"elements of {field.name}")),
            (sh.minCount, integer(kind.length)),
            (sh.maxCount, integer(kind.length if kind.length is not None else kind.bound)),
            *self.nested(element.name),
        )

    def blank(self, *statements: Statement) -> BlankNode:
        """A blank node that says this."""
        node = next(self.blanks)
        self.inner += triples_about(node, *statements)
        return node

    def list_of(self, elements: Iterable[Value]) -> Value:
        """An rdf:List."""
        rest: Value = rdf.nil
        for element in reversed(list(elements)):
            rest = self.blank((rdf.first, element), (rdf.rest, rest))
        return rest


def _default(field: Field) -> Literal | None:
    """The default value that the definition of a scalar states: a form may be filled with it, a message must say it."""
    stated = field.default
    if isinstance(stated, tuple | None) or not isinstance(field.type, Primitive) or stated_default(field) is None:
        return None
    return constant_value(Constant(field.name, field.type.name, stated))


def octets(kind: Array) -> list[Statement]:
    """An array of octets: one base64 literal, four characters for each three octets begun."""
    longest = kind.length if kind.length is not None else kind.bound
    return [
        (sh.datatype, xsd.base64Binary),
        (sh.minLength, integer(None if kind.length is None else _base64_length(kind.length))),
        (sh.maxLength, integer(None if longest is None else _base64_length(longest))),
    ]


def _base64_length(octets: int) -> int:
    return (octets + 2) // 3 * 4


def array(kind: Array, element: Primitive) -> list[Statement]:
    """An array of numbers, bools or strings: one rdf:JSON literal, whose length a pattern can tell for numbers."""
    return [(sh.datatype, rdf.JSON), (sh.pattern, text(_pattern(kind)) if element.name not in STRINGS else None)]


def _pattern(kind: Array) -> str | None:
    """A pattern of arrays of the right length; None where it would be too long to be of use."""
    least, limit = (kind.length, kind.length) if kind.length is not None else (0, kind.bound)
    if limit is None or limit > _LONGEST_PATTERN:
        return None
    if limit == 0:
        return r"^\s*\[\s*\]\s*$"
    more = f"{{{max(0, (least or 0) - 1)},{limit - 1}}}" if least != limit else f"{{{limit - 1}}}"
    body = rf"{_NUMBER}(,{_NUMBER}){more}"
    return rf"^\s*\[{body}\]\s*$" if least else rf"^\s*\[({body}|\s*)\]\s*$"
