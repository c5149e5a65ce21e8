"""Parser of submitted forms: converts pairs of names and texts to the plain JSON of a message."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from functools import partial
from typing import TypeAlias, cast

from rosld.adapters.model import STRINGS, Field, FieldType, MessageSchema, Nested, Primitive
from rosld.ontology.body import BodyError, parse_json
from rosld.ontology.violations import LoweringError, Violation
from rosld.ontology.vocab import xsd
from rosld.server.html.forms import METHOD_FIELD, PARAMETER_TYPES, TYPE_FIELD, VALUE_FIELD
from rosld.server.html.inputs import FLOATS, MAX_TEXT, is_base64, is_fieldset
from rosld.server.html.values import NUMBERS
from rosld.server.http.origin import CSRF_FIELD
from rosld.shapes.value import Bounds, MessageShape, OpenShape, ScalarShape, ValueShape

JsonValue: TypeAlias = "bool | int | float | str | list[JsonValue] | dict[str, JsonValue] | None"
_Reader: TypeAlias = Callable[[str], JsonValue]

_INTEGER = re.compile(r"[+-]?[0-9]{1,40}")
_FLOAT = re.compile(r"[+-]?([0-9]{1,400}\.?[0-9]{0,400}|\.[0-9]{1,400})([eE][+-]?[0-9]{1,6})?")
_SPECIAL = {"nan": "NaN", "inf": "INF", "+inf": "INF", "-inf": "-INF", "infinity": "INF", "-infinity": "-INF"}


def split_hidden(pairs: Iterable[tuple[str, str]]) -> tuple[str | None, str | None, list[tuple[str, str]]]:
    """Return the CSRF token, the intended method (each None if missing), and the other pairs."""
    hidden: dict[str, str] = {}
    rest: list[tuple[str, str]] = []
    for name, value in pairs:
        if name in (CSRF_FIELD, METHOD_FIELD) and name not in hidden:
            hidden[name] = value
        else:
            rest.append((name, value))
    return hidden.get(CSRF_FIELD), hidden.get(METHOD_FIELD), rest


def split_query(pairs: Iterable[tuple[str, str]]) -> tuple[dict[str, str], list[tuple[str, str]]]:
    """Return the pairs for the query (named `?rate`; no field name begins so), and the others."""
    query: dict[str, str] = {}
    rest: list[tuple[str, str]] = []
    for name, value in pairs:
        if name.startswith("?"):
            query.setdefault(name[1:], value)
        else:
            rest.append((name, value))
    return query, rest


def parse_value(shape: ValueShape, pairs: Iterable[tuple[str, str]]) -> JsonValue:
    """Return the plain JSON of a submitted `ValueForm`: the bare scalar, or an object of its fields.

    `pairs` are names (paths of fields) and texts, without the hidden fields. Browsers omit an unchecked box, which is
    false; every other missing field, unknown field or value of the wrong type is a violation. Line ends become LF:
    browsers send CR LF. Bounds are not checked here, as the shape validates every value. Raises LoweringError with all
    violations.
    """
    reading = _Reading(pairs)
    match shape:
        case MessageShape(schema, fields):
            return reading.end(reading.message(schema, fields, ""), schema.ref.name)
        case ScalarShape(kind, bounds):
            unsent = "" if kind.name == "bool" and not bounds.choices else None
            return reading.end(reading.value(VALUE_FIELD, _reader(kind), unsent))
        case OpenShape(bounds) if bounds.choices:
            return reading.end(reading.value(VALUE_FIELD, partial(_read_choice, bounds)))
        case OpenShape():
            kind_name = reading.texts.pop(TYPE_FIELD, "")
            return reading.end(reading.value(VALUE_FIELD, partial(_read_parameter, kind_name), ""))


def parse_choice(name: str, pairs: Iterable[tuple[str, str]]) -> JsonValue:
    """Return the plain JSON of a submitted `ChoiceForm`, whether or not the choice is still available.

    Raises LoweringError if the choice is missing or if there are other fields.
    """
    reading = _Reading(pairs)
    return reading.end({name: reading.value(name, str)})


def _read_choice(bounds: Bounds, text: str) -> JsonValue:
    """Return a choice for a value without a type, as plain JSON according to the choice's own datatype."""
    chosen = next((each for each in bounds.choices if each.value == text), None)
    if chosen is None:
        raise ValueError(f"must be one of {', '.join(each.value for each in bounds.choices)}")
    if chosen.datatype == xsd.boolean:
        return text in ("true", "1")
    return _read_parameter("number", text) if chosen.datatype in NUMBERS else text


class _Reading:
    """State of parsing a form: `texts` are the pairs not yet consumed."""

    def __init__(self, pairs: Iterable[tuple[str, str]]) -> None:
        self.texts: dict[str, str] = {}
        self.violations: list[Violation] = []
        for name, text in pairs:
            if name in self.texts:
                self.violations.append(Violation(name, "is given twice", text))
            self.texts.setdefault(name, text)

    def message(self, schema: MessageSchema, fields: Iterable[Field], prefix: str) -> JsonValue:
        """Return the fields of a message, each from a fieldset or from the text of one input."""
        found: dict[str, JsonValue] = {}
        for field in fields:
            path, kind = f"{prefix}{field.name}", field.type
            if is_fieldset(schema, kind):
                assert isinstance(kind, Nested)
                found[field.name] = self.message(schema, schema.types[kind.name].fields, f"{path}.")
            else:
                found[field.name] = self.value(path, _reader(kind), "" if kind == Primitive("bool") else None)
        return found

    def value(self, name: str, reader: _Reader, unsent: str | None = None) -> JsonValue:
        """Return the value of one input; `unsent` is the meaning of a missing pair."""
        text = self.texts.pop(name, unsent)
        try:
            if text is None:
                raise ValueError("is missing")
            return reader(text)
        except ValueError as error:
            self.violations.append(Violation(name, str(error), text))
            return None

    def end(self, value: JsonValue, form: str = "this form") -> JsonValue:
        """Return the value. Raises LoweringError for violations and for unknown fields."""
        rest = (Violation(name, f"is not a field of {form}", text) for name, text in self.texts.items())
        violations = (*self.violations, *rest)
        if violations:
            raise LoweringError(*violations)
        return value


def _reader(kind: FieldType) -> _Reader:
    if not isinstance(kind, Primitive):
        return _read_base64 if is_base64(kind) else _read_json
    if kind.name in STRINGS:
        return _read_string
    if kind.name == "bool":
        return _read_bool
    return _read_float if kind.name in FLOATS else _read_integer


def _read_bool(text: str) -> JsonValue:
    if text not in ("", "true", "on", "false"):
        raise ValueError("must be true or false")
    return text in ("true", "on")


def _read_string(text: str) -> JsonValue:
    return text.replace("\r\n", "\n")


def _read_base64(text: str) -> JsonValue:
    return "".join(text.split())


def _read_integer(text: str) -> JsonValue:
    text = text.strip()
    if not text:
        raise ValueError("is empty: enter an integer")
    if not _INTEGER.fullmatch(text):
        raise ValueError("must be an integer")
    return int(text)


def _read_float(text: str) -> JsonValue:
    text = text.strip()
    if not text:
        raise ValueError("is empty: enter a number")
    if special := _SPECIAL.get(text.lower()):
        return special
    if not _FLOAT.fullmatch(text):
        raise ValueError("must be a number")
    value = float(text)
    if value in (float("inf"), float("-inf")):
        raise ValueError("is too large for a float64")
    return value


def _read_json(text: str) -> JsonValue:
    if not text.strip():
        raise ValueError("is empty: write JSON, such as [] for none")
    if len(text) > 50 * MAX_TEXT:
        raise ValueError(f"is too long for a form ({len(text):,} characters): send it as application/json")
    try:
        return cast(JsonValue, parse_json(text.replace("\r\n", "\n").encode("utf-8", "surrogatepass")))
    except BodyError as error:
        raise ValueError(str(error)) from None


def _read_parameter(kind: str, text: str) -> JsonValue:
    if kind == "number":
        return _read_integer(text) if _INTEGER.fullmatch(text.strip()) else _read_float(text)
    if kind == "boolean":
        if text.strip().lower() not in ("true", "false"):
            raise ValueError("must be true or false")
        return text.strip().lower() == "true"
    if kind == "JSON":
        return _read_json(text)
    if kind == "string":
        return _read_string(text)
    raise ValueError(f"{kind!r} is not a parameter type; choose from {', '.join(PARAMETER_TYPES)}")
