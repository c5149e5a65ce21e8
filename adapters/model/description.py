"""Conversion of ROS 2 type descriptions (REP 2016) to definitions, for types not written as .msg. No I/O.

A description has names, types and default values of fields, but neither constants nor comments.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rosld.adapters.model.definition import written_form
from rosld.adapters.model.library import SEPARATOR

_NESTED, _BLOCK = 1, 48
_BOUNDED_STRING, _BOUNDED_WSTRING = 21, 22
_STRINGS = frozenset({17, 18, _BOUNDED_STRING, _BOUNDED_WSTRING})
_PRIMITIVES = {
    2: "int8",
    3: "uint8",
    4: "int16",
    5: "uint16",
    6: "int32",
    7: "uint32",
    8: "int64",
    9: "uint64",
    10: "float32",
    11: "float64",
    15: "bool",
    16: "byte",
    17: "string",
    18: "wstring",
}
_SUFFIXES = ("", "[{}]", "[<={}]", "[]")
"""Suffixes of a single value, an array, a bounded and an unbounded sequence, whose ids are 48 apart."""
_DUMMY = "structure_needs_at_least_one_member"
_PARTS: Mapping[str, tuple[str, ...]] = {
    "msg": ("",),
    "srv": ("_Request", "_Response"),
    "action": ("_Goal", "_Result", "_Feedback"),
}


def definition_of(name: str, described: Iterable[Any]) -> str:
    """Return the definition of a message, service or action, with the messages that it nests appended.

    `described` are the type and all that it refers to (type_description_interfaces/msg/IndividualTypeDescription).
    Raises ValueError naming a type that is missing or impossible.
    """
    fields = {each.type_name: each.fields for each in described}
    parts = [f"{name}{end}" for end in _PARTS[written_form(name)]]
    lacking = [part for part in parts if part not in fields]
    if lacking:
        raise ValueError(f"the description of {name} lacks {lacking[0]}")
    whole = "\n---\n".join(_text(fields[part]) for part in parts)
    nested = [each for each in _types_within(parts, fields) if each not in parts]
    return "\n".join([whole, *(f"{SEPARATOR}\nMSG: {_short(each)}\n{_text(fields[each])}" for each in nested)]) + "\n"


def _types_within(parts: Sequence[str], fields: Mapping[str, Sequence[Any]]) -> list[str]:
    """Return these types and all that they nest. Raises ValueError if one is not described."""
    visited: dict[str, None] = {}
    pending = list(parts)
    while pending:
        name = pending.pop()
        if name in visited:
            continue
        if name not in fields:
            raise ValueError(f"the description of {parts[0]} lacks {name}")
        visited[name] = None
        pending += [field.type.nested_type_name for field in fields[name] if field.type.type_id % _BLOCK == _NESTED]
    return list(visited)


def _text(fields: Sequence[Any]) -> str:
    parts = ((_type(field.type), field.name, _default(field)) for field in fields if field.name != _DUMMY)
    return "\n".join(" ".join(filter(None, each)) for each in parts)


def _default(field: Any) -> str:
    """Return the default value of a field as in a definition, or an empty string. Descriptions use Python's notation.

    Strings that a definition cannot contain are omitted: there, a line break or a comment ends the string.
    """
    text = str(field.default_value)
    block, kind = divmod(field.type.type_id, _BLOCK)
    if not text or kind == _NESTED or any(each in text for each in "\n\r#="):
        return ""
    if block:
        return f"[{text[1:-1].rstrip(', ')}]"
    return '"' + text.replace('"', '\\"') + '"' if kind in _STRINGS else text


def _type(message: Any) -> str:
    block, kind = divmod(message.type_id, _BLOCK)
    if block >= len(_SUFFIXES):
        raise ValueError(f"unknown field type id {message.type_id}")
    if kind == _NESTED:
        element = _short(message.nested_type_name)
    elif kind in (_BOUNDED_STRING, _BOUNDED_WSTRING):
        element = f"{'string' if kind == _BOUNDED_STRING else 'wstring'}<={message.string_capacity}"
    elif kind in _PRIMITIVES:
        element = _PRIMITIVES[kind]
    else:
        raise ValueError(f"a field of the type {message.type_id} has no name in a .msg")
    return element + _SUFFIXES[block].format(message.capacity)


def _short(name: str) -> str:
    return name.replace("/msg/", "/")
