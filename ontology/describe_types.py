"""Documents of message, service and action types: classes, the properties of their fields, constants, definitions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import takewhile
from typing import NamedTuple

from pyoxigraph import Literal, NamedNode, Triple

from rosld.adapters.model import (
    OCTETS,
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
    TypeRef,
    halves_of,
)
from rosld.ontology import kinds
from rosld.ontology.describe_topics import type_url
from rosld.ontology.document import Document
from rosld.ontology.literals import DATATYPES
from rosld.ontology.node_shape import SOURCE, NodeShape, Property, many, one, optional
from rosld.ontology.triples import Statement, boolean, double, statements, text, triples_about
from rosld.ontology.units import UNKNOWN, Quantity, field_quantity
from rosld.ontology.urls import Space
from rosld.ontology.vocab import foaf, owl, qudt, rdf, rdfs, ros, schema_org, xsd


class _TypeView(NamedTuple):
    """A type, the URL of its document, and its other variants."""

    schema: Schema
    url: str
    others: Sequence[TypeRef]


_TYPE_PROPERTIES: tuple[Property[_TypeView], ...] = (
    one(rdfs.label, kinds.TEXT, lambda view: view.schema.ref.name),
    optional(rdfs.comment, kinds.TEXT, lambda view: leading_comment(view.schema.definition)),
    one(ros.name, kinds.TEXT, lambda view: view.schema.ref.name),
    optional(ros.md5, kinds.TEXT.where('sh:pattern "^[0-9a-f]{32}$"'), lambda view: _hash(view.schema.ref, False)),
    optional(ros.typeHash, kinds.TEXT.where('sh:pattern "^RIHS[0-9]{2}_"'), lambda view: _hash(view.schema.ref, True)),
    one(rdfs.isDefinedBy, kinds.IRI.where('sh:pattern "/types/"'), lambda view: view.url),
    many(ros.variant, kinds.TYPE, lambda view: view.others),
    one(ros.definition, kinds.TEXT, lambda view: view.schema.definition),
)
_TYPE = NodeShape[NamedNode](
    "Type", "the description of a type", *SOURCE, target="sh:targetSubjectsOf foaf:primaryTopic"
).with_properties(one(rdfs.label, kinds.TEXT), one(foaf.primaryTopic, kinds.TERM, lambda kind: kind))
_MESSAGE_TYPE = NodeShape[_TypeView](
    "MessageType", "a message type", ros.MessageType, rdfs.Class, owl.Class
).with_properties(
    *_TYPE_PROPERTIES,
    one(rdfs.subClassOf, kinds.TERM.where("sh:hasValue ros:Message"), lambda view: ros.Message),
    one(ros.shape, kinds.SHAPE, lambda view: view.schema.ref),
    many(ros.hasField, kinds.IRI.where("sh:class ros:Field")),
    many(ros.hasConstant, kinds.IRI.where("sh:class ros:Constant")),
)
_SERVICE_TYPE = NodeShape[_TypeView]("ServiceType", "a service type", ros.ServiceType).with_properties(
    *_TYPE_PROPERTIES, one(ros.requestType, kinds.IRI), one(ros.responseType, kinds.IRI)
)
_ACTION_TYPE = NodeShape[_TypeView]("ActionType", "an action type", ros.ActionType).with_properties(
    *_TYPE_PROPERTIES, one(ros.goalType, kinds.IRI), one(ros.resultType, kinds.IRI), one(ros.feedbackType, kinds.IRI)
)


def type_document(schema: Schema, space: Space, variants: Sequence[TypeRef] = ()) -> Document:
    """Return a type: its class with definition and hash, its fields in order, its constants and other variants.

    The class is the document's primary topic: it is in the namespace of types, which all robots share.
    """
    others = [ref for ref in variants if ref.hash and ref.hash != schema.ref.hash]
    url = space.type(TypeRef(schema.ref.name, schema.ref.hash if others else None))
    kind, view = NamedNode(space.class_of(schema.ref.name)), _TypeView(schema, url, others)
    triples = _TYPE.triples(NamedNode(url), kind, space, (rdfs.label, text(schema.ref.name)))
    if isinstance(schema, MessageSchema):
        triples += _MESSAGE_TYPE.triples(kind, view, space)
        triples += _message_type(schema.type, space)
    else:
        shape, predicates = _HALVES[type(schema)]
        triples += shape.triples(kind, view, space)
        for half, predicate in zip(halves_of(schema), predicates, strict=True):
            inner = NamedNode(space.class_of(half.ref.name))
            triples.append(Triple(kind, predicate, inner))
            triples += type_url(half.ref, space)
            triples += _message_type(half.type, space)
    return Document(url, tuple(triples))


_HALVES: Mapping[type, tuple[NodeShape[_TypeView], Sequence[NamedNode]]] = {
    ServiceSchema: (_SERVICE_TYPE, (ros.requestType, ros.responseType)),
    ActionSchema: (_ACTION_TYPE, (ros.goalType, ros.resultType, ros.feedbackType)),
}


def _hash(ref: TypeRef, is_ros2: bool) -> str | None:
    """Return the hash of a type if its kind of ROS defines it."""
    return ref.hash if ref.hash and ref.hash.startswith("RIHS") == is_ros2 else None


class _FieldView(NamedTuple):
    """A field of a message type, with its position."""

    field: Field
    position: int
    quantity: Quantity | None

    @property
    def array(self) -> Array | None:
        return self.field.type if isinstance(self.field.type, Array) else None

    @property
    def string(self) -> Primitive | None:
        element = self.array.element if self.array else self.field.type
        return element if isinstance(element, Primitive) else None

    @property
    def nested(self) -> TypeRef | None:
        name = self.field.nested
        return None if name is None else TypeRef(name)


_FIELD = NodeShape[_FieldView](
    "Field",
    "a field of a message type",
    ros.Field,
    rdf.Property,
    more="sh:xone ( [ sh:property [ sh:path rdfs:range ; sh:minCount 1 ] ]"
    " [ sh:property [ sh:path schema:rangeIncludes ; sh:minCount 1 ] ] )",
).with_properties(
    one(rdfs.label, kinds.TEXT, lambda view: view.field.name),
    one(ros.fieldName, kinds.TEXT, lambda view: view.field.name),
    one(ros.fieldType, kinds.TEXT, lambda view: definition_text(view.field.type)),
    one(ros.position, kinds.COUNT, lambda view: view.position),
    optional(ros.nestedType, kinds.CLASS, lambda view: view.nested),
    optional(ros.arrayLength, kinds.COUNT, lambda view: view.array.length if view.array else None),
    optional(ros.arrayBound, kinds.COUNT, lambda view: view.array.bound if view.array else None),
    optional(ros.stringBound, kinds.COUNT, lambda view: view.string.bound if view.string else None),
    optional(qudt.hasUnit, kinds.IRI, lambda view: view.quantity and view.quantity.unit),
    optional(qudt.hasQuantityKind, kinds.IRI, lambda view: view.quantity and view.quantity.kind),
    optional(ros.unitUnknown, kinds.BOOLEAN, lambda view: view.quantity == UNKNOWN or None),
    one(rdfs.domain, kinds.IRI),
    optional(rdfs.range, kinds.IRI),
    many(schema_org.rangeIncludes, kinds.IRI),
)
_CONSTANT = NodeShape[tuple[int, Constant]]("Constant", "a constant of a message type", ros.Constant).with_properties(
    one(rdfs.label, kinds.TEXT, lambda of: of[1].name),
    one(ros.fieldName, kinds.TEXT, lambda of: of[1].name),
    one(ros.fieldType, kinds.TEXT, lambda of: of[1].type),
    one(ros.position, kinds.COUNT, lambda of: of[0]),
    optional(ros.value, kinds.LITERAL, lambda of: constant_value(of[1])),
)


def _message_type(kind: MessageType, space: Space) -> list[Triple]:
    subject = NamedNode(space.class_of(kind.name))
    fields = [NamedNode(space.property_of(kind.name, field.name)) for field in kind.fields]
    constants = [NamedNode(space.property_of(kind.name, constant.name)) for constant in kind.constants]
    triples = triples_about(subject, *statements(ros.hasField, fields), *statements(ros.hasConstant, constants))
    for position, (node, field) in enumerate(zip(fields, kind.fields, strict=True)):
        view = _FieldView(field, position, field_quantity(kind.name, field))
        triples += _FIELD.triples(node, view, space, (rdfs.domain, subject), *_range(field.type, space))
        if view.nested is not None:
            triples += type_url(view.nested, space)
    for node, each in zip(constants, enumerate(kind.constants), strict=True):
        triples += _CONSTANT.triples(node, each, space)
    return triples


def _range(kind: FieldType, space: Space) -> list[Statement]:
    """Return the class and the range of a field; a field that may be elided has literals and nodes."""
    values = value_type(kind, space)
    if isinstance(kind, Array) or (isinstance(kind, Primitive) and kind.name in STRINGS):
        return statements(schema_org.rangeIncludes, (values, ros.Elided))
    return [(rdf.type, owl.ObjectProperty if isinstance(kind, Nested) else owl.DatatypeProperty), (rdfs.range, values)]


def constant_value(constant: Constant) -> Literal | None:
    """Return the value of a constant, with the datatype of its type."""
    value = constant.value
    if isinstance(value, str):
        return text(value)
    if isinstance(value, bool):
        return boolean(value)
    datatype = NamedNode(xsd.iri + DATATYPES.get(constant.type, "integer" if isinstance(value, int) else "double"))
    return Literal(double(value).value if isinstance(value, float) else str(value), datatype=datatype)


def leading_comment(definition: str) -> str | None:
    """Return the text of the comment lines at the head of a definition, or None."""
    lines = takewhile(lambda line: line.startswith("#"), definition.lstrip().splitlines())
    return " ".join(filter(None, (line.strip("# \t") for line in lines))) or None


def definition_text(kind: FieldType) -> str:
    """Return a field's type as in ROS definitions: `float64`, `geometry_msgs/msg/Point[]`, `string<=10[<=3]`."""
    if isinstance(kind, Nested):
        return kind.name
    if isinstance(kind, Primitive):
        return kind.name if kind.bound is None else f"{kind.name}<={kind.bound}"
    size = f"<={kind.bound}" if kind.bound is not None else "" if kind.length is None else str(kind.length)
    return f"{definition_text(kind.element)}[{size}]"


def value_type(kind: FieldType, space: Space) -> NamedNode:
    """Return the class or datatype of a field's values in RDF."""
    if isinstance(kind, Nested):
        return NamedNode(space.class_of(kind.name))
    if isinstance(kind, Primitive):
        return NamedNode(xsd.iri + DATATYPES[kind.name])
    if isinstance(kind.element, Nested):
        return rdf.List
    return xsd.base64Binary if kind.element.name in OCTETS else rdf.JSON
