"""Message, service and action types described: classes, the properties of their fields, constants, definitions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pyoxigraph import Literal, NamedNode, Triple

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
    TypeRef,
    halves_of,
)
from rosld.ontology.document import Document
from rosld.ontology.literals import DATATYPES, OCTETS, STRINGS
from rosld.ontology.triples import RDF_SOURCE, Statement, boolean, double, integer, statements, text, triples_about
from rosld.ontology.urls import Space
from rosld.ontology.vocab import foaf, owl, rdf, rdfs, ros, schema_org, xsd


def type_document(schema: Schema, space: Space, variants: Sequence[TypeRef] = ()) -> Document:
    """A type: its class with definition and hash, fields in order, constants; the other variants where there are any.

    The class is the document's primary topic: it lies in the namespace of types, which all robots share.
    """
    others = [ref for ref in variants if ref.hash and ref.hash != schema.ref.hash]
    url = space.type(TypeRef(schema.ref.name, schema.ref.hash if others else None))
    kind = NamedNode(space.class_of(schema.ref.name))
    triples = triples_about(NamedNode(url), *RDF_SOURCE, (foaf.primaryTopic, kind))
    triples += triples_about(
        kind,
        (rdf.type, _KINDS[type(schema)]),
        *statements(rdf.type, (rdfs.Class, owl.Class) if isinstance(schema, MessageSchema) else ()),
        (rdfs.subClassOf, ros.Message if isinstance(schema, MessageSchema) else None),
        (rdfs.label, text(schema.ref.name)),
        (ros.name, text(schema.ref.name)),
        _hash(schema.ref),
        (rdfs.isDefinedBy, NamedNode(url)),
        *statements(ros.variant, [NamedNode(space.type(ref)) for ref in others]),
    )
    if isinstance(schema, MessageSchema):
        triples += triples_about(kind, (ros.shape, NamedNode(space.shape(schema.ref.name))))
        triples += _message_type(schema.type, space)
    else:
        for half, predicate in zip(halves_of(schema), _HALVES[type(schema)], strict=True):
            inner = NamedNode(space.class_of(half.ref.name))
            triples += triples_about(kind, (predicate, inner))
            triples += triples_about(inner, (rdfs.isDefinedBy, NamedNode(space.type(half.ref.name))))
            triples += _message_type(half.type, space)
    triples += triples_about(kind, (ros.definition, text(schema.definition)))
    return Document(url, tuple(triples))


_KINDS: Mapping[type, NamedNode] = {
    MessageSchema: ros.MessageType,
    ServiceSchema: ros.ServiceType,
    ActionSchema: ros.ActionType,
}
_HALVES: Mapping[type, Sequence[NamedNode]] = {
    ServiceSchema: (ros.requestType, ros.responseType),
    ActionSchema: (ros.goalType, ros.resultType, ros.feedbackType),
}


def _hash(ref: TypeRef) -> Statement:
    """The hash under the name that its kind of ROS has for it."""
    return (ros.typeHash if ref.hash and ref.hash.startswith("RIHS") else ros.md5, text(ref.hash))


def _message_type(kind: MessageType, space: Space) -> list[Triple]:
    """Return the fields and constants of a message type."""
    subject = NamedNode(space.class_of(kind.name))
    fields = [NamedNode(space.property_of(kind.name, field.name)) for field in kind.fields]
    constants = [NamedNode(space.property_of(kind.name, constant.name)) for constant in kind.constants]
    triples = triples_about(subject, *statements(ros.hasField, fields), *statements(ros.hasConstant, constants))
    for position, (node, field) in enumerate(zip(fields, kind.fields, strict=True)):
        triples += triples_about(node, *_field(field, position, subject, space))
        if (nested := _nested_type(field.type)) is not None:
            triples += triples_about(
                NamedNode(space.class_of(nested)), (rdfs.isDefinedBy, NamedNode(space.type(nested)))
            )  # fmt: skip
    for position, (node, constant) in enumerate(zip(constants, kind.constants, strict=True)):
        triples += triples_about(node, *_constant(constant, position))
    return triples


def _field(field: Field, position: int, kind: NamedNode, space: Space) -> list[Statement]:
    nested = _nested_type(field.type)
    array = field.type if isinstance(field.type, Array) else None
    element = array.element if array else field.type
    return [
        (rdf.type, ros.Field),
        *statements(rdf.type, _property_types(field.type)),
        (rdfs.label, text(field.name)),
        (ros.fieldName, text(field.name)),
        (ros.fieldType, text(definition_text(field.type))),
        (ros.position, integer(position)),
        (ros.nestedType, NamedNode(space.class_of(nested)) if nested else None),
        (ros.arrayLength, integer(array.length) if array else None),
        (ros.arrayBound, integer(array.bound) if array else None),
        (ros.stringBound, integer(element.bound) if isinstance(element, Primitive) else None),
        (rdfs.domain, kind),
        *_range(field.type, space),
    ]


def _property_types(kind: FieldType) -> tuple[NamedNode, ...]:
    """Return the classes of a field's property; one that may be elided has literals and nodes."""
    if isinstance(kind, Nested):
        return (rdf.Property, owl.ObjectProperty)
    return (rdf.Property,) if _may_be_elided(kind) else (rdf.Property, owl.DatatypeProperty)


def _range(kind: FieldType, space: Space) -> list[Statement]:
    """Return the range of a field; that of one that may be elided includes nodes."""
    if _may_be_elided(kind):
        return statements(schema_org.rangeIncludes, (value_type(kind, space), ros.Elided))
    return [(rdfs.range, value_type(kind, space))]


def _may_be_elided(kind: FieldType) -> bool:
    """Whether a value may be too large to write, so that a node replaces it."""
    return isinstance(kind, Array) or (isinstance(kind, Primitive) and kind.name in STRINGS)


def _constant(constant: Constant, position: int) -> list[Statement]:
    return [
        (rdf.type, ros.Constant),
        (rdfs.label, text(constant.name)),
        (ros.fieldName, text(constant.name)),
        (ros.fieldType, text(constant.type)),
        (ros.position, integer(position)),
        (ros.value, constant_value(constant)),
    ]


def constant_value(constant: Constant) -> Literal | None:
    """Return the value of a constant, with the datatype of its type."""
    value = constant.value
    if isinstance(value, str):
        return text(value)
    if isinstance(value, bool):
        return boolean(value)
    datatype = NamedNode(xsd.iri + DATATYPES.get(constant.type, "integer" if isinstance(value, int) else "double"))
    return Literal(double(value).value if isinstance(value, float) else str(value), datatype=datatype)


def _nested_type(kind: FieldType) -> str | None:
    """Return the name of the message type within a field's type."""
    element = kind.element if isinstance(kind, Array) else kind
    return element.name if isinstance(element, Nested) else None


def definition_text(kind: FieldType) -> str:
    """Return a field's type as ROS definitions write it: `float64`, `geometry_msgs/msg/Point[]`, `string<=10[<=3]`."""
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
