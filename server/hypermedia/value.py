"""Values of properties, in RDF, in plain JSON, and in bodies. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cached_property, lru_cache
from types import MappingProxyType
from typing import TypeAlias, cast

import numpy as np
from msgspec import Struct
from pyoxigraph import BlankNode, Literal, NamedNode

from rosld.adapters.model import (
    STRINGS,
    Codec,
    Encoding,
    Field,
    Message,
    MessageSchema,
    MessageType,
    ParameterValue,
    Primitive,
)
from rosld.ontology import parameters
from rosld.ontology.body import RdfBody, Term, parse_json
from rosld.ontology.document import LiftedMessage
from rosld.ontology.fields import field_at
from rosld.ontology.lift import LiftSettings, lifter
from rosld.ontology.literals import (
    BASE64,
    DATATYPES,
    DTYPES,
    base64_text,
    json_scalars,
    json_string,
    scalar_texts,
    wide_integer_json,
    wire_bytes,
)
from rosld.ontology.lower import lowerer
from rosld.ontology.urls import Space
from rosld.ontology.violations import LoweringError, Violation, brief_value
from rosld.ontology.vocab import rdf, xsd
from rosld.server.http.conditional import digest
from rosld.server.hypermedia.catalogue import Getter, Property, Setter, TopicSource
from rosld.shapes.value import MessageShape

WHOLE = LiftSettings().unelided
"""Lifting settings that elide nothing."""

_WORDS = frozenset({"message", "status_message"})


class MessageValue(Struct, frozen=True, eq=False):
    """The `fields` of a message; `origin` is the URL with the bytes of elided fields (`?field=`).

    That is the URL of the topic or, for the response of a getter, of the property.
    """

    schema: MessageSchema
    message: Message
    fields: tuple[Field, ...]
    origin: str


class StoredValue(Struct, frozen=True, eq=False):
    """The value of a parameter."""

    value: ParameterValue


Value: TypeAlias = MessageValue | StoredValue


class Reading(Struct, frozen=True, eq=False):
    """The result of reading a property: its value, or the reason for its absence.

    `failure` describes the problem without a full stop (a getter that times out, refuses or has vanished; invalid
    bytes); it is None if there is a value or no value yet. `read_ns` (wall clock) is when the value was received.
    `fresh_until` is the loop time until which it may be reused; None for a topic, whose value is valid until the next
    message. `words` are the robot's own words about a failure, `about` the URLs of the sources that failed. Readings
    are compared by identity: the same object means that nothing changed.
    """

    name: str
    value: Value | None
    failure: str | None = None
    read_ns: int | None = None
    fresh_until: float | None = None
    words: str | None = None
    about: tuple[str, ...] = ()


# Parts of messages


def scalar_field(fields: tuple[Field, ...]) -> Field | None:
    """Return the single field that is a scalar value; None if the value is a message."""
    return fields[0] if len(fields) == 1 and isinstance(fields[0].type, Primitive) else None


def select_fields(schema: MessageSchema, fields: tuple[Field, ...]) -> MessageSchema:
    """Return the schema with only these fields; the others have ROS's defaults in its messages."""
    return schema if fields == schema.type.fields else _part_of(schema, fields)


@lru_cache(maxsize=1024)
def _part_of(schema: MessageSchema, fields: tuple[Field, ...]) -> MessageSchema:
    name = schema.ref.name
    types = MappingProxyType({**schema.types, name: MessageType(name, fields, schema.type.constants)})
    return replace(schema, types=types, codec=_PartCodec(schema))


class _PartCodec:
    """Codec that builds whole messages from the values of some fields."""

    def __init__(self, schema: MessageSchema) -> None:
        self._schema = schema
        self._codec: Codec = schema.codec

    def decode(self, data: bytes, encoding: Encoding) -> Message:
        return self._codec.decode(data, encoding)

    def encode(self, message: Message, encoding: Encoding) -> bytes:
        return self._codec.encode(message, encoding)

    def build(self, type_name: str, values: Mapping[str, object]) -> Message:
        whole = type_name == self._schema.ref.name
        return self._codec.build(type_name, {**self._defaults, **values} if whole else values)

    @cached_property
    def _defaults(self) -> Mapping[str, object]:
        message = lowerer(self._schema).from_json({}, defaults=True)
        return {field.attribute: getattr(message, field.attribute) for field in self._schema.type.fields}


def refusal_text(schema: MessageSchema, response: Message, value: tuple[Field, ...] = ()) -> str | None:
    """Return the message of a response with `bool success` false (or ""); None for other responses.

    The fields of its `value` are no status.
    """
    status = [field for field in schema.type.fields if field not in value]
    if not any(
        field.name == "success" and field.type == Primitive("bool") and not getattr(response, field.attribute)
        for field in status
    ):
        return None
    words = (getattr(response, one.attribute) for one in status if one.name in _WORDS and scalar_field((one,)))
    return next((str(one) for one in words if one), "")


def shape_url(reading: Reading, field: str | None, space: Space) -> str | None:
    """Return the URL of the shape that a reading shown as a message with all of its fields conforms to."""
    value = reading.value
    if not isinstance(value, MessageValue) or field is not None or value.fields != value.schema.type.fields:
        return None
    return None if scalar_field(value.fields) is not None else space.shape(value.schema.ref.name)


# Plain JSON


def plain_json(value: Value, lifting: LiftSettings) -> bytes:
    """Return the value as plain JSON: a scalar (never elided), or a message as the object of its fields.

    Raises ValueError for the value of a parameter that is nested too deeply.
    """
    if isinstance(value, StoredValue):
        return parameters.parameter_json(value.value)
    field = scalar_field(value.fields)
    if field is not None:
        return scalar_json(cast(Primitive, field.type), getattr(value.message, field.attribute))
    return lifter(select_fields(value.schema, value.fields), lifting).json(value.message, value.origin)


def field_json(value: Value, field: str) -> bytes:
    """Return one scalar of the value, by its path (`pose.position.x`), as plain JSON.

    Raises ValueError, with a sentence, if there is no such scalar.
    """
    if isinstance(value, StoredValue):
        return parameters.parameter_json(_stored_at(value.value, field))
    return scalar_json(*_scalar_at(value, field))


def scalar_json(kind: Primitive, value: object) -> bytes:
    """Return a scalar of a message as plain JSON."""
    if kind.name in STRINGS:
        return json_string(cast(str, value)).encode()
    if kind.name == "float32":
        return json_scalars(np.array([value], np.float32))[0].encode()
    number = cast("int | float", value)
    return json_scalars((wide_integer_json(cast(int, number)) if kind.name.endswith("int64") else number,))[0].encode()


# RDF


def value_literal(value: Value, field: str | None = None) -> Literal | None:
    """Return the literal of a scalar, or of that at the path `field`; None for messages and trees of parameters.

    Raises ValueError, with a sentence, if there is no scalar at `field`.
    """
    if isinstance(value, StoredValue):
        stored = value.value if field is None else _stored_at(value.value, field)
        return None if isinstance(stored, dict) else parameters.parameter_literal(stored)
    if field is not None:
        return _literal(*_scalar_at(value, field))
    scalar = scalar_field(value.fields)
    return None if scalar is None else _literal(cast(Primitive, scalar.type), getattr(value.message, scalar.attribute))


def _literal(kind: Primitive, value: object) -> Literal:
    if kind.name not in STRINGS:
        form = scalar_texts(np.array([value], DTYPES[kind.name]))[0]
        return Literal(form, datatype=NamedNode(xsd.iri + DATATYPES[kind.name]))
    text = cast(str, value)
    try:
        return Literal(text)
    except ValueError:  # invalid UTF-8
        return Literal(base64_text(wire_bytes(text)), datatype=NamedNode(BASE64))


def lift_value(value: MessageValue, node: str, lifting: LiftSettings) -> LiftedMessage:
    """Return the message as the node at the fragment `node` (`#value`), with the fields of the value."""
    lift = lifter(select_fields(value.schema, value.fields), lifting)
    return LiftedMessage(node, lift, value.message, source=value.origin)


# Fields


def _scalar_at(value: MessageValue, path: str) -> tuple[Primitive, object]:
    kind, found = field_at(select_fields(value.schema, value.fields), value.message, path)
    if not isinstance(kind, Primitive):
        raise ValueError(f"the field {path!r} of {value.schema.ref.name} is not a scalar")
    return kind, found


def _stored_at(value: ParameterValue, path: str) -> ParameterValue:
    found = value
    for step in path.split("."):
        if isinstance(found, dict) and step in found:
            found = found[step]
        elif isinstance(found, list) and step.isdecimal() and len(step) < 12 and int(step) < len(found):
            found = found[int(step)]
        else:
            raise ValueError(f"the parameter has no field {path!r}")
    if isinstance(found, dict | list):
        raise ValueError(f"the field {path!r} of the parameter is not a scalar")
    return found


# Identity


def version_key(reading: Reading) -> str:
    """Return a short text that changes with the value or the failure, but not with the time of reading."""
    value = reading.value
    if isinstance(value, MessageValue):
        ref = value.schema.ref
        kind = f"message\0{ref.name}\0{ref.hash}\0{value.origin}\0"
        return digest(kind.encode("utf-8", "surrogatepass") + plain_json(value, WHOLE))
    if isinstance(value, StoredValue):
        return digest(b"stored\0" + parameters.parameter_json(value.value))
    return digest(f"none\0{reading.failure or ''}\0{reading.words or ''}".encode("utf-8", "surrogatepass"))


def content_from_rdf(
    body: RdfBody,
    subject: NamedNode,
    predicate: NamedNode,
    property: Property,
    lifting: LiftSettings,
) -> object:
    """Return the content that `subject` `predicate` states for a property.

    The content is a literal, or a node typed as one of the messages that the property is read as or written with.
    Raises LoweringError if there is no value, more than one, or a value of another kind.
    """
    term = _single_object(body, subject, predicate)
    if isinstance(term, Literal):
        return term
    if not isinstance(term, NamedNode | BlankNode):
        raise LoweringError(Violation("", "expected a literal or a node", brief_value(term)))
    return _describe(body, term, property, lifting, subject.value)


def _single_object(body: RdfBody, subject: NamedNode, predicate: NamedNode) -> Term:
    terms = body.objects(subject, predicate)
    if len(terms) > 1:
        raise LoweringError(Violation("", f"expected one value, not {len(terms)}: {predicate} is given more than once"))
    if terms:
        return terms[0]
    raise LoweringError(Violation("", f"missing: expected the value, as {subject} {predicate}"))


def _describe(
    body: RdfBody, node: NamedNode | BlankNode, property: Property, lifting: LiftSettings, document: str
) -> object:
    """Return the plain JSON of the message at a node."""
    kinds = body.objects(node, rdf.type)
    known = {NamedNode(lifting.types + each.schema.ref.name): each for each in layouts(property)}
    found = next((known[kind] for kind in kinds if isinstance(kind, NamedNode) and kind in known), None)
    if found is None:
        expected = f"a node of type {' or '.join(map(str, known))}" if known else "a literal"
        stated = ", ".join(map(str, kinds)) or f"{node} without a type"
        raise LoweringError(Violation("", f"expected {expected}", brief_value(stated)))
    part = select_fields(found.schema, found.fields)
    message = lowerer(part, lifting).from_graph(body, node)
    return parse_json(plain_json(MessageValue(found.schema, message, found.fields, document), WHOLE))


def layouts(property: Property) -> Iterator[MessageShape]:
    """Yield the messages that the property is read as and written with."""
    for way in (*property.readers, *property.writers):
        match way:
            case TopicSource(schema=schema) if schema is not None:
                yield MessageShape(schema, schema.type.fields)
            case Getter(schema=service, fields=fields):
                yield MessageShape(service.response, fields)
            case Setter(schema=service):
                yield MessageShape(service.request, service.request.type.fields)
            case _:
                pass
