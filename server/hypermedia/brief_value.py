"""Brief values: a value as plain JSON with so much of it as fits a line, for lists of very many. Pure.

What is left out is visible: `"...": "more"` in an object, `"..."` at the end of an array or a string. The header of a
message is left out without a word.
"""

from __future__ import annotations

from typing import cast

from rosld.adapters.model import Array, Field, FieldType, Message, MessageSchema, Nested, ParameterValue, Primitive
from rosld.ontology.literals import OCTETS, STRINGS, json_string
from rosld.ontology.parameters import parameter_json
from rosld.server.hypermedia.value import StoredValue, Value, scalar_json

MAX_CHARACTERS = 200
"""Characters of a brief value."""
MORE = "..."
_MARK = f'"{MORE}":"more"'
_MAX_STRING = 60
_MAX_ELEMENTS = 8
"""Elements of an array of scalars that is told; longer ones are covariances, scans and images."""
_HEADERS = frozenset({"std_msgs/msg/Header", "roslib/msg/Header"})


def brief_json(value: Value, limit: int = MAX_CHARACTERS) -> str:
    """The value as plain JSON, shortened to about so many characters. Raises ValueError for one nested too deep."""
    if isinstance(value, StoredValue):
        return _parameter_text(value.value, limit)
    return _members(value.schema, value.fields, value.message, limit) or f"{{{_MARK}}}"


def _members(schema: MessageSchema, fields: tuple[Field, ...], message: Message, room: int) -> str | None:
    """The object of those fields that fit, in their order; None where none does."""
    told = [field for field in fields if not _is_header(field.type)] or list(fields)
    parts: list[str] = []
    left = room - len(_MARK) - 2
    for field in told:
        text = _of(schema, field.type, getattr(message, field.attribute), left - len(field.name) - 4)
        if text is not None:
            parts.append(f'"{field.name}":{text}')
            left -= len(parts[-1]) + 1
    return _fitting(_object(parts, is_whole=len(parts) == len(told)), room) if parts or not told else None


def _object(parts: list[str], *, is_whole: bool) -> str:
    return "{" + ",".join(parts if is_whole else [*parts, _MARK]) + "}"


def _is_header(kind: FieldType) -> bool:
    return isinstance(kind, Nested) and kind.name in _HEADERS


def _of(schema: MessageSchema, kind: FieldType, value: object, room: int) -> str | None:
    """A field's value; None where it does not fit."""
    if isinstance(kind, Nested):
        return _members(schema, schema.types[kind.name].fields, cast(Message, value), room)
    if isinstance(kind, Primitive):
        return _fitting(_scalar(kind, value), room)
    if isinstance(kind.element, Nested):
        return _messages(schema, kind.element, cast("list[Message]", value), room)
    return _scalars(kind, cast("list[object]", value), room)


def _messages(schema: MessageSchema, kind: Nested, values: list[Message], room: int) -> str | None:
    """As many elements as fit; None where not even the first does."""
    parts: list[str] = []
    left = room - 8
    for value in values:
        text = _members(schema, schema.types[kind.name].fields, value, left)
        if text is None:
            break
        parts.append(text)
        left -= len(text) + 1
    if values and not parts:
        return None
    return _fitting("[" + ",".join(parts if len(parts) == len(values) else [*parts, f'"{MORE}"']) + "]", room)


def _scalars(kind: Array, values: list[object], room: int) -> str | None:
    """All elements, or None: octets and what is long are no line to be read."""
    element = cast(Primitive, kind.element)
    if element.name in OCTETS or len(values) > _MAX_ELEMENTS:
        return None
    return _fitting(f"[{','.join(_scalar(element, each) for each in values)}]", room)


def _scalar(kind: Primitive, value: object) -> str:
    return _string(cast(str, value)) if kind.name in STRINGS else scalar_json(kind, value).decode()


def _string(value: str) -> str:
    return json_string(value if len(value) <= _MAX_STRING else value[:_MAX_STRING] + MORE)


def _fitting(text: str, room: int) -> str | None:
    return text if len(text) <= room else None


def _parameter_text(value: ParameterValue, room: int) -> str:
    """The value of a parameter where it fits, of a long string its beginning."""
    text = _string(value) if isinstance(value, str) else parameter_json(value).decode()
    return text if len(text) <= room else f'"{MORE}"'
