"""Messages as plain values, as JSON has them: objects, lists, numbers and strings. No I/O."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping
from typing import Any, Protocol, cast

import numpy as np
import orjson

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
_PLAIN = (Mapping, list, str, int, float, type(None))


def message_of(schema: MessageSchema, values: Any, *, is_open: bool = False) -> Message:
    """Return a message with these values; what they lack has its default value, or is zero.

    Octets may be a list, bytes or text in base64; null is a float that JSON lacks; a nested message may be a message.
    Times may have ROS 1's names. What is no text is JSON in a string. Raises ValueError naming a field that does not
    fit or, unless `is_open`, does not exist.
    """

    def message(name: str, values: Any) -> Message:
        if not isinstance(values, Mapping):
            raise ValueError(f"{name} must be an object, not {values!r}")
        fields = schema.types[name].fields
        if name in _TIMES:
            values = {each.name: values.get(each.name, values.get(_ROS1_NAMES[each.name], 0)) for each in fields}
        unknown = values.keys() - {each.name for each in fields}
        if unknown and not is_open:
            raise ValueError(f"{name} has no field {min(unknown)!r}")
        return schema.codec.build(name, {each.attribute: member(name, each, values) for each in fields})

    def member(name: str, field: Field, values: Mapping[str, Any]) -> object:
        given = values.get(field.name, field.default)
        is_nan = field.name in values and isinstance(field.type, Primitive) and field.type.name.startswith("float")
        try:
            return zero(field.type) if given is None and not is_nan else value(field.type, given)
        except (ValueError, TypeError, OverflowError, AttributeError) as error:
            raise ValueError(f"{field.name} of {name}: {error}") from error

    def value(kind: FieldType, given: Any) -> object:
        if isinstance(kind, Array):
            return array(kind, given)
        if isinstance(kind, Nested):
            return message(kind.name, given) if isinstance(given, _PLAIN) else given
        if kind.name in STRINGS:
            return given if isinstance(given, str) else orjson.dumps(given).decode()
        if kind.name.startswith("float"):
            return math.nan if given is None else float(given)
        if kind.name == "byte":
            return int(np.array(given).astype(DTYPES["byte"]))
        return bool(given) if kind.name == "bool" else int(given)

    def array(kind: Array, given: Any) -> object:
        if not isinstance(kind.element, Primitive) or kind.element.name in STRINGS:
            items: Any = [value(kind.element, each) for each in given]
        else:
            items = _numbers(kind.element.name, given)
        if kind.length is not None and len(items) != kind.length:
            raise ValueError(f"an array must have exactly {kind.length} elements, not {len(items)}")
        return items

    def zero(kind: FieldType) -> object:
        if isinstance(kind, Nested):
            return message(kind.name, {})
        if isinstance(kind, Array):
            return array(kind, [zero(kind.element) for _ in range(kind.length or 0)])
        return "" if kind.name in STRINGS else value(kind, 0)

    return message(schema.ref.name, values)


def plain_of(
    schema: MessageSchema, message: object, *, ros1: bool = False, base64_octets: bool = True
) -> dict[str, Any]:
    """Return the values of a message, with octets in base64. With `ros1`, times have ROS 1's names."""

    def members(name: str, message: object) -> dict[str, Any]:
        renamed = _ROS1_NAMES if ros1 and name in _TIMES else {}
        fields = schema.types[name].fields
        return {
            renamed.get(each.name, each.name): plain(each.type, getattr(message, each.attribute)) for each in fields
        }

    def plain(kind: FieldType, value: Any) -> object:
        if isinstance(kind, Nested):
            return members(kind.name, value)
        if not isinstance(kind, Array):
            return value & 0xFF if kind.name == "byte" else value
        if isinstance(kind.element, Nested):
            return [members(kind.element.name, each) for each in value]
        if kind.element.name == "byte":
            return [int(each) & 0xFF for each in value]
        if kind.element.name in OCTETS and base64_octets:
            return base64.b64encode(bytes(value)).decode()
        return value.tolist() if isinstance(value, np.ndarray) else list(value)

    return members(schema.ref.name, message)


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
