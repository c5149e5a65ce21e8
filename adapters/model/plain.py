"""Messages as plain values, as JSON has them: objects, lists, numbers and strings. No I/O."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterable, Mapping
from typing import Any, Protocol, cast

import numpy as np

from rosld.adapters.model.codec import DTYPES
from rosld.adapters.model.errors import UnknownType
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.model.schema import (
    OCTETS,
    STRINGS,
    Array,
    Encoding,
    Field,
    FieldType,
    Message,
    MessageSchema,
    Nested,
    Primitive,
    TypeRef,
)

_TIMES = frozenset({"builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"})
_ROS1_NAMES = {"sec": "secs", "nanosec": "nsecs"}
"""Names of the parts of times in ROS 1."""


def message_of(schema: MessageSchema, values: Mapping[str, Any], type_name: str | None = None) -> Message:
    """Return a message with these values; what they lack has its default value, or is zero.

    Octets may be a list, bytes or text in base64; null is a float that JSON lacks; a nested message may be a message.
    Times may have ROS 1's names. Raises ValueError naming a field that does not fit or does not exist.
    """
    name = type_name or schema.ref.name
    fields = schema.types[name].fields
    if name in _TIMES:
        values = {each.name: values.get(each.name, values.get(_ROS1_NAMES[each.name], 0)) for each in fields}
    unknown = values.keys() - {each.name for each in fields}
    if unknown:
        raise ValueError(f"{name} has no field {min(unknown)!r}")
    return schema.codec.build(name, {each.attribute: _field(schema, name, each, values) for each in fields})


def plain_of(schema: MessageSchema, message: object, *, ros1: bool, type_name: str | None = None) -> dict[str, Any]:
    """Return the values of a message, with octets in base64. With `ros1`, times have ROS 1's names."""
    name = type_name or schema.ref.name
    fields = schema.types[name].fields
    renamed = _ROS1_NAMES if ros1 and name in _TIMES else {}
    return {
        renamed.get(each.name, each.name): _plain(schema, each.type, getattr(message, each.attribute), ros1)
        for each in fields
    }


def _field(schema: MessageSchema, name: str, field: Field, values: Mapping[str, Any]) -> object:
    value = values.get(field.name, field.default)
    try:
        is_given = value is not None or field.name in values
        return _value(schema, field.type, value) if is_given else _zero(schema, field.type)
    except (ValueError, TypeError, OverflowError, AttributeError) as error:
        raise ValueError(f"{field.name} of {name}: {error}") from error


def _value(schema: MessageSchema, kind: FieldType, value: Any) -> object:
    if isinstance(kind, Array):
        return _array(schema, kind, value)
    if isinstance(kind, Nested):
        return message_of(schema, value, kind.name) if isinstance(value, Mapping) else value
    if kind.name in STRINGS:
        return str(value)
    if kind.name.startswith("float"):
        return math.nan if value is None else float(value)
    return bool(value) if kind.name == "bool" else _integer(kind.name, value)


def _integer(name: str, value: Any) -> int:
    return int(np.array(value).astype(DTYPES[name])) if name == "byte" else int(value)


def _array(schema: MessageSchema, kind: Array, value: Any) -> object:
    if not isinstance(kind.element, Primitive) or kind.element.name in STRINGS:
        items: Any = [_value(schema, kind.element, each) for each in value]
    else:
        items = _numbers(kind.element.name, value)
    if kind.length is not None and len(items) != kind.length:
        raise ValueError(f"an array must have exactly {kind.length} elements, not {len(items)}")
    return items


def _numbers(name: str, value: Any) -> object:
    dtype = np.dtype(DTYPES[name])
    if isinstance(value, str):
        value = base64.b64decode(value, validate=True)
    if isinstance(value, (bytes, bytearray, memoryview)):
        return np.frombuffer(value, dtype)
    if name == "byte":
        return np.array([each[0] if isinstance(each, bytes) else int(each) for each in value], "i8").astype(dtype)
    if dtype.kind == "f":
        return np.array([math.nan if each is None else each for each in value], dtype)
    return np.array(value if isinstance(value, (list, tuple, np.ndarray)) else list(value), dtype)


def _zero(schema: MessageSchema, kind: FieldType) -> object:
    if isinstance(kind, Nested):
        return message_of(schema, {}, kind.name)
    if isinstance(kind, Array):
        elements: Iterable[object] = (_zero(schema, kind.element) for _ in range(kind.length or 0))
        return _array(schema, kind, list(elements))
    return "" if kind.name in STRINGS else _value(schema, kind, 0)


def _plain(schema: MessageSchema, kind: FieldType, value: Any, ros1: bool) -> object:
    if isinstance(kind, Nested):
        return plain_of(schema, value, ros1=ros1, type_name=kind.name)
    if not isinstance(kind, Array):
        return value & 0xFF if kind.name == "byte" else value
    if isinstance(kind.element, Nested):
        return [plain_of(schema, each, ros1=ros1, type_name=kind.element.name) for each in value]
    if kind.element.name == "byte":
        return [int(each) & 0xFF for each in value]
    if kind.element.name in OCTETS:
        return base64.b64encode(bytes(value)).decode()
    return value.tolist() if isinstance(value, np.ndarray) else list(value)


class MessageFactory(Protocol):
    """Factory of ROS 2 messages, whose attributes are their fields; `half` is "Request" or "Response"."""

    def make_message(self, type: str, values: Mapping[str, object], half: str | None = None) -> object:
        """Return a message, or half of a service, with these values. Raises UnknownType."""

    def request_of(self, type: str, data: bytes) -> object:
        """Return the request of a service type from its bytes. Raises UnknownType, ValueError."""

    def deserialize(self, type: str, data: bytes) -> object:
        """Return a message from its bytes. Raises UnknownType, ValueError."""

    def serialize(self, message: object, type: str, half: str | None = None) -> bytes:
        """Return the bytes of a message."""

    def class_problem(self, type: str) -> str | None:
        """Return why messages of a type cannot be read or sent, or None."""


class LibraryMessages:
    """Messages of the types in a library: a `MessageFactory` that needs no ROS."""

    def __init__(self, library: TypeLibrary) -> None:
        self._library = library

    def schema(self, type: str, half: str | None = None) -> MessageSchema:
        """Return the schema of a message, or of half of a service. Raises UnknownType."""
        schema = self._library.find(TypeRef(type if half is None else f"{type}_{half}"))
        if not isinstance(schema, MessageSchema):
            raise UnknownType(f"{type} is not a message type")
        return schema

    def make_message(self, type: str, values: Mapping[str, object], half: str | None = None) -> object:
        """Return a message, or half of a service, with these values."""
        return message_of(self.schema(type, half), values)

    def request_of(self, type: str, data: bytes) -> object:
        """Return the request of a service type from its bytes."""
        return self.deserialize(f"{type}_Request", data)

    def deserialize(self, type: str, data: bytes) -> object:
        """Return a message from its bytes."""
        return self.schema(type).codec.decode(data, Encoding.CDR)

    def serialize(self, message: object, type: str, half: str | None = None) -> bytes:
        """Return the bytes of a message."""
        return self.schema(type, half).codec.encode(cast(Message, message), Encoding.CDR)

    def class_problem(self, type: str) -> str | None:
        """Return why the definition of a type is not known, or None."""
        try:
            self._library.find(TypeRef(type))
        except UnknownType as error:
            return error.sentence
        return None
