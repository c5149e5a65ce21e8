"""One field of a message by its path, as in `?field=transforms.0.data`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, cast

import numpy as np

from rosld.adapters.model import (
    OCTETS,
    STRINGS,
    Array,
    Field,
    FieldType,
    Message,
    MessageSchema,
    Nested,
    Primitive,
    TypeRef,
)
from rosld.ontology.lift import LiftSettings, lifter
from rosld.ontology.literals import json_numbers, json_strings, wire_bytes

_WHOLE = LiftSettings(inline_limit=2**62)


def field_bytes(schema: MessageSchema, message: Message, path: str) -> tuple[bytes, str]:
    """Return the bytes of the field at `path` (`transforms.0.data`) and their media type.

    Octets and strings are as on the wire, everything else is JSON, complete at any size. Raises ValueError with the
    path if there is no such field.
    """
    return _write(schema, *field_at(schema, message, path))


def field_at(schema: MessageSchema, message: Message, path: str) -> tuple[FieldType, object]:
    """Return the type and value of the field at `path`. Raises ValueError with the path if there is no such field."""
    return _walk(schema, message, path, _member, " here")


def type_at(schema: MessageSchema, path: str) -> FieldType:
    """Return the type of the field at `path`. Raises ValueError with the path if there is no such field."""
    return _walk(schema, None, path, lambda value, place: None, "")[0]


def fields_along(schema: MessageSchema, path: str) -> Sequence[tuple[str, Field]]:
    """Return the fields along a dotted path through messages and arrays of them, each with the name of its type.

    Empty if there is no such field.
    """
    name: str | None = schema.ref.name
    found: list[tuple[str, Field]] = []
    for step in path.split("."):
        try:
            found.append((name or "", _field(schema, name or "", step)))
        except LookupError:
            return ()
        name = found[-1][1].nested
    return found


def number_type(schema: MessageSchema, path: str) -> Primitive | Array:
    """Return the type of the number, or of the array of numbers, at `path` in every message of a type.

    Raises ValueError with the path if there is no such field, or if it has no numbers.
    """
    kind = type_at(schema, path)
    element = kind.element if isinstance(kind, Array) else kind
    if isinstance(element, Nested) or element.name in STRINGS:
        raise ValueError(f"{path!r} of {schema.ref.name} is not a number")
    assert not isinstance(kind, Nested)
    return kind


def _walk(
    schema: MessageSchema, value: object, path: str, member: Callable[[Any, Field | int], object], where: str
) -> tuple[FieldType, object]:
    """Return the type and value at `path`; `member` returns what each value on the way holds."""
    kind: FieldType = Nested(schema.ref.name)
    steps = path.split(".")
    for count, step in enumerate(steps, 1):
        try:
            if isinstance(kind, Nested):
                field = _field(schema, kind.name, step)
                kind, value = field.type, member(value, field)
            elif isinstance(kind, Array) and step.isdecimal() and len(step) < 12:
                kind, value = kind.element, member(value, int(step))
            else:
                raise LookupError(step)
        except (LookupError, ValueError) as error:
            raise ValueError(f"{schema.ref.name} has no field {'.'.join(steps[:count])!r}{where}") from error
    return kind, value


def _member(value: Any, place: Field | int) -> object:
    return getattr(value, place.attribute) if isinstance(place, Field) else value[place]


def _field(schema: MessageSchema, name: str, step: str) -> Field:
    for field in schema.types[name].fields:
        if field.name == step:
            return field
    raise LookupError(step)


def _write(schema: MessageSchema, kind: FieldType, value: object) -> tuple[bytes, str]:
    if isinstance(kind, Nested):
        return _message_json(schema, kind, cast(Message, value)), "application/json"
    if isinstance(kind, Primitive):
        return _primitive(kind, value)
    if isinstance(kind.element, Nested):
        texts = [_message_json(schema, kind.element, each) for each in cast("list[Message]", value)]
        return b"[" + b",".join(texts) + b"]", "application/json"
    if kind.element.name in STRINGS:
        return json_strings(cast("list[str]", value)).encode(), "application/json"
    array = cast("np.ndarray[Any, Any]", value)
    if kind.element.name in OCTETS:
        return array.tobytes(), "application/octet-stream"
    return json_numbers(array).encode(), "application/json"


def _message_json(schema: MessageSchema, kind: Nested, message: Message) -> bytes:
    return lifter(_part(schema, kind.name), _WHOLE).json(message, "")


@lru_cache(maxsize=256)
def _part(schema: MessageSchema, name: str) -> MessageSchema:
    """Return the schema of a type nested in `schema`."""
    return replace(schema, ref=TypeRef(name, schema.ref.hash))


def _primitive(kind: Primitive, value: object) -> tuple[bytes, str]:
    if kind.name not in STRINGS:
        dtype = "f4" if kind.name == "float32" else None
        return json_numbers(np.array([value], dtype))[1:-1].encode(), "application/json"
    text = wire_bytes(cast(str, value))
    try:
        text.decode()
    except UnicodeDecodeError:
        return text, "application/octet-stream"
    return text, "text/plain; charset=utf-8"
