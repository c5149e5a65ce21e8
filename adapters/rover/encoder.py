"""From the fields of a message to its bytes, by its schema."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import cast

import numpy as np

from rosld.adapters.model import Encoding, FieldType, Message, MessageSchema, Nested, Primitive
from rosld.adapters.rover.messages import Fields

ENCODING = Encoding.CDR
_DTYPES: Mapping[str, str] = {"byte": "uint8", "char": "uint8", "bool": "bool"}


def encode(schema: MessageSchema, fields: Fields) -> bytes:
    """The bytes of a message whose fields are all given."""
    return schema.codec.encode(message(schema, fields), ENCODING)


def message(schema: MessageSchema, fields: Fields) -> Message:
    """The message whose fields are all given."""
    return _build(schema, schema.ref.name, fields)


def _build(schema: MessageSchema, name: str, fields: Fields) -> Message:
    values = {each.attribute: _value(schema, each.type, fields[each.name]) for each in schema.types[name].fields}
    return schema.codec.build(name, values)


def _value(schema: MessageSchema, type: FieldType, value: object) -> object:
    if isinstance(type, Nested):
        return _build(schema, type.name, cast(Fields, value))
    if isinstance(type, Primitive):
        return value
    if isinstance(type.element, Primitive):
        return _numbers(type.element, value)
    return [_value(schema, type.element, each) for each in cast("Sequence[object]", value)]


def _numbers(element: Primitive, value: object) -> object:
    return np.asarray(value, _DTYPES.get(element.name, element.name)) if element.name != "string" else value
