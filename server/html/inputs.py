"""Inputs: what a form asks for, one a field. Pure values; `forms.py` draws them up, the templates write them out."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import isfinite
from typing import ClassVar, TypeAlias

from rosld.adapters.model import Array, Field, FieldType, MessageSchema, Nested, Primitive
from rosld.ontology.fitting import RANGES
from rosld.ontology.literals import OCTETS, STRINGS
from rosld.server.html.messages import type_name
from rosld.server.html.view import visible

Json: TypeAlias = "bool | int | float | str | Sequence[Json] | Mapping[str, Json] | None"
"""Plain JSON as parsed; whole numbers are ints of any size."""

FLOATS = frozenset({"float32", "float64"})
MOST_LEAVES = 120
"""A nested message with more fields than this (all levels counted) is one text of JSON, not a fieldset."""
MOST_TEXT = 20_000
"""Characters that an input is filled with; what is longer stays empty, to be sent by other means."""
_DEEPEST = 64


@dataclass(frozen=True, slots=True)
class Input:
    """One input. `type` is number, text, checkbox, textarea or select; `name` is the path of the field.

    `value` is the text in it ("true" or "" for a checkbox), `hint` the ROS type, `note` a quiet sentence below it,
    `error` what does not fit.
    """

    kind: ClassVar[str] = "input"
    name: str
    label: str
    type: str
    value: str = ""
    hint: str = ""
    note: str = ""
    error: str = ""
    required: bool = True
    min: str = ""
    max: str = ""
    step: str = ""
    maxlength: str = ""
    options: tuple[str, ...] = ()

    @property
    def lines(self) -> int:
        """How many lines a textarea shows."""
        return max(2, min(12, self.value.count("\n") + 1 + len(self.value) // 60))


@dataclass(frozen=True, slots=True)
class Fieldset:
    """The inputs of a nested message."""

    kind: ClassVar[str] = "fieldset"
    name: str
    label: str
    hint: str
    inputs: tuple[Control, ...]
    error: str = ""


Control: TypeAlias = Input | Fieldset


@dataclass(frozen=True, slots=True)
class Filling:
    """What a form is filled with: what was `typed` into it last time, else a value; and the `errors` by path."""

    typed: Mapping[str, str] | None = None
    errors: Mapping[str, str] | None = None

    def text(self, path: str, otherwise: str) -> str:
        """What stands in the input of `path`."""
        return otherwise if self.typed is None else self.typed.get(path, "")

    def error(self, path: str) -> str:
        """What does not fit at `path` itself."""
        return visible((self.errors or {}).get(path, ""))

    def below(self, path: str) -> str:
        """What does not fit at `path` or anywhere below it, for a field that has no inputs of its own below."""
        found = (
            message if name == path else f"{name}: {message}"
            for name, message in (self.errors or {}).items()
            if name == path or name.startswith((f"{path}.", f"{path}["))
        )
        return visible("; ".join(found))


def controls(schema: MessageSchema, value: Json, filling: Filling) -> tuple[Control, ...]:
    """The inputs for a message of `schema`; `value` is plain JSON, and ROS's defaults stand where it has nothing."""
    return _controls(schema, schema.ref.name, "", value, filling)


def _controls(schema: MessageSchema, name: str, prefix: str, value: Json, filling: Filling) -> tuple[Control, ...]:
    values = value if isinstance(value, Mapping) else {}
    return tuple(
        _control(schema, each, f"{prefix}{each.name}", values.get(each.name), filling)
        for each in schema.types[name].fields
    )


def _control(schema: MessageSchema, each: Field, path: str, value: Json, filling: Filling) -> Control:
    if is_fieldset(schema, each.type):
        assert isinstance(each.type, Nested)
        inner = _controls(schema, each.type.name, f"{path}.", value, filling)
        return Fieldset(path, each.name, each.type.name, inner, filling.error(path))
    if value is None:
        value = default(schema, each.type)
    if isinstance(each.type, Primitive):
        return _primitive(each.type, each.name, path, value, filling)
    return _json(each.type, each.name, path, value, filling)


def is_fieldset(schema: MessageSchema, kind: FieldType) -> bool:
    """Whether a field is drawn as inputs of its own: a nested message that is not too large."""
    return isinstance(kind, Nested) and leaves(schema, kind.name) <= MOST_LEAVES


def leaves(schema: MessageSchema, name: str) -> int:
    """How many inputs all fields of a type come to; counting stops above `MOST_LEAVES`, however deep types nest."""
    count = 0
    waiting = [name]
    while waiting and count <= MOST_LEAVES:
        for each in schema.types[waiting.pop()].fields:
            count += 1
            if isinstance(each.type, Nested):
                waiting.append(each.type.name)
    return count


def _primitive(kind: Primitive, label: str, path: str, value: Json, filling: Filling) -> Input:
    if kind.name == "bool":
        checked = filling.text(path, "true" if value is True else "")
        return Input(
            path, label, "checkbox", checked and "true", hint="bool", error=filling.below(path), required=False
        )
    if kind.name in STRINGS:
        return _text(kind, label, path, value, filling)
    return _number(kind, label, path, value, filling)


def _text(kind: Primitive, label: str, path: str, value: Json, filling: Filling) -> Input:
    present = value if isinstance(value, str) and can_be_typed(value) else None
    text = filling.text(path, present or "")
    return Input(
        path,
        label,
        "textarea" if "\n" in text or "\r" in text else "text",
        visible(text),
        hint=type_name(kind),
        note="The present value cannot be edited here." if present is None and filling.typed is None else "",
        error=filling.below(path),
        required=False,
        maxlength=str(kind.bound or ""),
    )


def can_be_typed(text: str) -> bool:
    """Whether a browser sends a text back as it got it: not too long, and without control characters."""
    return len(text) <= MOST_TEXT and visible(text) == text and "\r" not in text


def _number(kind: Primitive, label: str, path: str, value: Json, filling: Filling) -> Input:
    text = filling.text(path, number_text(value))
    least, greatest = limits(kind.name)
    return Input(
        path,
        label,
        "number" if _browser_reads(text) else "text",
        visible(text),
        hint=kind.name,
        error=filling.below(path),
        min=least,
        max=greatest,
        step="any" if kind.name in FLOATS else "1",
    )


def number_text(value: Json) -> str:
    """A number of plain JSON as it stands in an input."""
    if isinstance(value, bool):
        return str(int(value))
    return value if isinstance(value, str) else repr(value) if isinstance(value, int | float) else "0"


def _browser_reads(text: str) -> bool:
    """Whether a number input can hold it: not NaN, INF or what was typed wrongly (it would be lost)."""
    try:
        return text == "" or (isfinite(float(text)) and "_" not in text and text.strip("+ ") == text)
    except (ValueError, OverflowError):
        return False


@lru_cache(maxsize=64)
def limits(name: str) -> tuple[str, str]:
    """The least and greatest value of an integer type as texts; empty for floats."""
    least, greatest = RANGES.get(name, ("", ""))
    return str(least), str(greatest)


def _json(kind: FieldType, label: str, path: str, value: Json, filling: Filling) -> Input:
    present = json_text(kind, value)
    text = filling.text(path, present or "")
    too_long = "The present value is too long to be edited here."
    return Input(
        path,
        label,
        "textarea",
        visible(text),
        hint=type_name(kind),
        note=too_long if present is None and filling.typed is None else _how(kind),
        error=filling.below(path),
        required=not is_octets(kind),
    )


def _how(kind: FieldType) -> str:
    if is_octets(kind):
        return "base64"
    return "JSON object" if isinstance(kind, Nested) else "JSON array"


def is_octets(kind: FieldType) -> bool:
    """Whether a field's plain JSON is one string of base64."""
    return isinstance(kind, Array) and isinstance(kind.element, Primitive) and kind.element.name in OCTETS


def json_text(kind: FieldType, value: Json) -> str | None:
    """The text for a field that is edited as JSON (or base64); None where it is elided or too long for that."""
    if is_octets(kind):
        return value if isinstance(value, str) and len(value) <= MOST_TEXT else None
    if not isinstance(value, list if isinstance(kind, Array) else Mapping):
        return None
    try:
        text = written(value, indent=2 if _is_of_messages(kind) else None)
    except (TypeError, ValueError):
        return None
    return text if len(text) <= MOST_TEXT else None


def written(value: Json, indent: int | None = None) -> str:
    """A value as JSON that a browser sends back as it is."""
    text = json.dumps(value, ensure_ascii=False, indent=indent)
    return text if visible(text) == text else json.dumps(value, indent=indent)


def _is_of_messages(kind: FieldType) -> bool:
    return isinstance(kind.element if isinstance(kind, Array) else kind, Nested)


def default(schema: MessageSchema, kind: FieldType) -> Json:
    """ROS's default of a field, as plain JSON; None where it would be too large to be typed anyway."""
    try:
        return _Defaults(schema).of(kind, 0)
    except OverflowError:
        return None


class _Defaults:
    """Defaults being made: by nesting, a few lines of definition may come to more values than there are atoms."""

    def __init__(self, schema: MessageSchema) -> None:
        self._schema = schema
        self._left = MOST_TEXT // 2

    def of(self, kind: FieldType, depth: int) -> Json:
        """The default of a type; raises OverflowError where it is too large."""
        self._left -= 1
        if self._left < 0 or depth > _DEEPEST:
            raise OverflowError
        if isinstance(kind, Primitive):
            return "" if kind.name in STRINGS else False if kind.name == "bool" else 0
        if isinstance(kind, Nested):
            return {each.name: self.of(each.type, depth + 1) for each in self._schema.types[kind.name].fields}
        if is_octets(kind):
            return _zeros(kind.length or 0)
        return [self.of(kind.element, depth + 1) for _ in range(kind.length or 0)]


def _zeros(count: int) -> str:
    """The base64 of `count` zero bytes, as far as an input would hold it."""
    whole, rest = divmod(min(count, MOST_TEXT), 3)
    return "AAAA" * whole + ("", "AA==", "AAA=")[rest]
