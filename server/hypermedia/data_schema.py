"""Data schemas (WoT Thing Description 1.1, 5.3.2): what plain JSON a value is, in JSON Schema's words. Pure.

They describe JSON as rosld writes it: integers that a double might not hold are strings of digits; NaN, INF and -INF
are strings; octets are base64; an array that may be too large to be written is an object with the URL of its bytes
then. Of a string that is too large, or not UTF-8, and of a value that is not there (null) they say nothing, so that
plain values keep plain schemas. What is sent is a command: its floats are numbers, those of a velocity have a range.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from typing import TypeAlias

from pyoxigraph import Literal

from rosld.adapters.model import Array, Field, FieldType, MessageSchema, Nested, Primitive
from rosld.ontology.coercion import RANGES, Misfit
from rosld.ontology.json_leaves import stated_default, zero_value
from rosld.ontology.lexical import NUMBERS, parse_boolean
from rosld.ontology.lift import LiftSettings
from rosld.ontology.literals import OCTETS, SAFE_INTEGER, STRINGS, special_float, wide_integer_json
from rosld.ontology.vocab import xsd
from rosld.shapes.command_numbers import LARGEST_VELOCITY, is_any_number_meant, largest_number
from rosld.shapes.value import UNBOUNDED, Bounds, Measure, MessageShape, ScalarShape, ValueShape

Json: TypeAlias = "bool | int | float | str | list[Json] | dict[str, Json] | None"
DataSchema: TypeAlias = dict[str, Json]

_MAX_NODES = 2000
_DEEPEST = 32
_FLOATS = frozenset({"float32", "float64"})
_VELOCITIES: DataSchema = {"minimum": -LARGEST_VELOCITY, "maximum": LARGEST_VELOCITY}
_SPECIALS: DataSchema = {"type": "string", "enum": ["NaN", "INF", "-INF"]}
_DIGITS: DataSchema = {"type": "string", "pattern": "^-?[0-9]{16,20}$"}
_ELIDED: DataSchema = {
    "type": "object",
    "properties": {
        "elided": {"type": "boolean", "const": True},
        "length": {"type": "integer", "minimum": 0},
        "href": {"type": "string"},
    },
    "required": ["elided", "length", "href"],
    "readOnly": True,
}
_SETTINGS = LiftSettings()


def value_schema(shape: ValueShape, lifting: LiftSettings = _SETTINGS, *, sent: bool = False) -> DataSchema:
    """The data schema of a property's value; of one that may be `sent`, fields have defaults and may be left out."""
    if isinstance(shape, MessageShape):
        fields = [field for field in shape.schema.type.fields if field.name in shape.fields]
        return _Schemas(shape.schema, shape.bounds, lifting, sent).fields(fields)
    if isinstance(shape, ScalarShape) and shape.is_parameter:
        return _parameter_schema(shape) | _unit(shape.measure)
    kind = shape.kind if isinstance(shape, ScalarShape) else None
    return _scalar(kind, shape.bounds, is_finite=sent) | _unit(shape.measure)


def message_schema(schema: MessageSchema, lifting: LiftSettings = _SETTINGS, *, sent: bool = False) -> DataSchema:
    """Return the data schema of a message, the object of its fields; of one that is `sent`, these may be left out."""
    return _Schemas(schema, {}, lifting, sent).fields(schema.type.fields)


class _Schemas:
    """The schemas of one message type. Types come from robots, so what is written of one is bounded."""

    def __init__(self, schema: MessageSchema, bounds: Mapping[str, Bounds], lifting: LiftSettings, sent: bool) -> None:
        self._types = schema.types
        self._bounds = bounds
        self._limit = lifting.inline_limit
        self._sent = sent
        self._range = _VELOCITIES if sent and largest_number(schema) == LARGEST_VELOCITY else {}
        self._left = _MAX_NODES

    def fields(self, fields: Iterable[Field], path: tuple[str, ...] = ()) -> DataSchema:
        """Return an object of fields."""
        properties: dict[str, Json] = {}
        for field in fields:
            inner = (*path, field.name)
            is_finite = self._sent and not is_any_number_meant(field)
            properties[field.name] = self._field(field.type, inner, is_finite=is_finite) | (
                self._default(field, inner) if self._sent else {}
            )
        return {"type": "object", "properties": properties, **({} if self._sent else {"required": list(properties)})}

    def _default(self, field: Field, path: tuple[str, ...]) -> DataSchema:
        """What a field is that is left out: told of scalars, of arrays without a length and of what a type states.

        What its bounds might refuse is not told.
        """
        stated, kind = stated_default(field), field.type
        if self._bounds.get(".".join(path), UNBOUNDED) != UNBOUNDED:
            return {}
        if stated is not None:
            return {"default": list(stated) if isinstance(stated, list) else stated}
        if isinstance(kind, Primitive):
            return {"default": zero_value(kind)}
        if isinstance(kind, Array) and kind.length is None:
            return {"default": "" if _is_octets(kind) else []}
        return {}

    def _field(self, kind: FieldType, path: tuple[str, ...], *, is_finite: bool) -> DataSchema:
        self._left -= 1
        if isinstance(kind, Array):
            return self._array(kind, path)
        if isinstance(kind, Primitive):
            found = _scalar(kind, self._bounds.get(".".join(path), UNBOUNDED), is_finite=is_finite)
            return self._range | found if kind.name in _FLOATS else found
        if self._left < 0 or len(path) >= _DEEPEST:
            return {"type": "object"}
        return self.fields(self._types[kind.name].fields, path)

    def _array(self, kind: Array, path: tuple[str, ...]) -> DataSchema:
        if _is_octets(kind):
            found = _octets(kind)
        else:
            found = {"type": "array", "items": self._element(kind.element, path)}
            found |= _without_none(
                minItems=kind.length, maxItems=kind.length if kind.length is not None else kind.bound
            )
        return {"oneOf": [found, _ELIDED]} if self._may_be_elided(kind) else found

    def _element(self, kind: Primitive | Nested, path: tuple[str, ...]) -> DataSchema:
        if isinstance(kind, Nested):
            return self._field(kind, path, is_finite=self._sent)
        if kind.name in _FLOATS:
            specials: list[Json] = ["-0.0"] if self._sent else ["NaN", "INF", "-INF", "-0.0"]
            return {"oneOf": [{"type": "number"}, {"type": "string", "enum": specials}]}
        return _scalar(kind, UNBOUNDED)

    def _may_be_elided(self, kind: Array) -> bool:
        """Whether it may take more bytes than are written; eight an element is the most of a number."""
        count = kind.length if kind.length is not None else kind.bound
        return (
            count is None or isinstance(kind.element, Nested) or kind.element.name in STRINGS or count * 8 > self._limit
        )


def _is_octets(kind: Array) -> bool:
    """Whether an array is one string of base64."""
    return isinstance(kind.element, Primitive) and kind.element.name in OCTETS


def _octets(kind: Array) -> DataSchema:
    """Return the length of octets in base64: four characters for each three octets begun."""
    count = kind.length if kind.length is not None else kind.bound
    return {
        "type": "string",
        "contentEncoding": "base64",
        **_without_none(
            minLength=None if kind.length is None else (kind.length + 2) // 3 * 4,
            maxLength=None if count is None else (count + 2) // 3 * 4,
        ),
    }


# Scalars


def _scalar(kind: Primitive | None, bounds: Bounds, *, is_finite: bool = False) -> DataSchema:
    """One scalar: of a primitive or, without one, of any type, within bounds; a float may have to be finite."""
    if bounds.choices:
        choices = _choices(bounds.choices)
        return {**_type(kind), "enum": choices} if choices else _type(kind)
    if kind is not None and kind.name in STRINGS:
        longest = [count for count in (bounds.max_length, kind.bound) if count is not None]
        return {
            "type": "string",
            **_without_none(
                minLength=bounds.min_length,
                maxLength=min(longest, default=None),
                pattern=None if bounds.pattern is None else _ecma(bounds.pattern),
            ),
        }
    limits = _limits(bounds)
    if kind is None:
        return {"type": "number", **limits} if limits else {}
    if kind.name == "bool":
        return {"type": "boolean"}
    if kind.name in RANGES:
        return _integer(kind, limits)
    return {"type": "number", **limits} if limits or is_finite else {"oneOf": [{"type": "number"}, _SPECIALS]}


def _parameter_schema(shape: ScalarShape) -> DataSchema:
    """Return the scalar of a parameter, whose numbers are JSON's."""
    name, limits, step = shape.kind.name, _limits(shape.bounds), _number(shape.bounds.step)
    if shape.bounds.choices or not (name in RANGES or name.startswith("float")):
        return _scalar(shape.kind, shape.bounds)
    ends = (limits.get("minimum"), limits.get("maximum"))
    even = isinstance(step, int) and all(isinstance(each, int) and each % step == 0 for each in ends)
    return {
        "type": "integer" if name in RANGES else "number",
        **limits,
        **_without_none(multipleOf=step if even else None),
    }


def _type(kind: Primitive | None) -> DataSchema:
    """The type of what is one of several values; floats and wide integers may be strings too."""
    if kind is None or kind.name.startswith("float") or kind.name.endswith("64"):
        return {}
    return {"type": "string" if kind.name in STRINGS else "boolean" if kind.name == "bool" else "integer"}


def _integer(kind: Primitive, limits: DataSchema) -> DataSchema:
    """Return an integer of a primitive's range; beyond what a double holds it is its digits."""
    least, greatest = RANGES[kind.name]
    if not limits.keys() & {"minimum", "exclusiveMinimum"}:
        limits = {**limits, "minimum": max(least, -SAFE_INTEGER)}
    if not limits.keys() & {"maximum", "exclusiveMaximum"}:
        limits = {**limits, "maximum": min(greatest, SAFE_INTEGER)}
    number: DataSchema = {"type": "integer", **limits}
    beyond = [limits.get("minimum") == -SAFE_INTEGER, limits.get("maximum") == SAFE_INTEGER]
    return {"oneOf": [number, _DIGITS]} if any(beyond) else number


def _limits(bounds: Bounds) -> DataSchema:
    """Return the ends of a range of numbers."""
    return _without_none(
        minimum=_number(bounds.minimum),
        maximum=_number(bounds.maximum),
        exclusiveMinimum=_number(bounds.exclusive_minimum),
        exclusiveMaximum=_number(bounds.exclusive_maximum),
    )


def _number(literal: Literal | None) -> int | float | None:
    """Return a bound as JSON's number; None for what is no number, or none that JSON has."""
    if literal is None or literal.datatype not in NUMBERS:
        return None
    try:
        value = NUMBERS[literal.datatype](literal.value)
    except Misfit:
        return None
    if isinstance(value, int):
        return value if abs(value) <= SAFE_INTEGER else None
    return float(value) if math.isfinite(value) else None


def _choices(choices: Iterable[Literal]) -> list[Json]:
    """Return the values of an enumeration, as plain JSON has them, each once."""
    found = {(type(value), value): value for value in map(_choice, choices)}
    return list(found.values())


def _choice(literal: Literal) -> bool | int | float | str:
    try:
        if literal.datatype == xsd.boolean:
            return parse_boolean(literal.value)
        if literal.datatype in NUMBERS:
            value = NUMBERS[literal.datatype](literal.value)
            if isinstance(value, int):
                return wide_integer_json(value)
            return float(value) if math.isfinite(value) else special_float(float(value))
    except Misfit:
        pass
    return literal.value


def _unit(measure: Measure) -> DataSchema:
    return {} if measure.unit is None else {"unit": measure.unit.value}


def _without_none(**keywords: int | float | str | None) -> DataSchema:
    """The keywords that have a value."""
    return {name: value for name, value in keywords.items() if value is not None}


_ESCAPE = r"\\[dDwWsSnrt.\\()\[\]{}+*?^$|]"
_OF_ECMA = re.compile(rf"(?:[^\\(\[\]{{]|{_ESCAPE}|\((?!\?[^:])|\{{(?!,)|\[(?:[^\\\[\]]|\\-|{_ESCAPE})*\])*", re.DOTALL)


def _ecma(pattern: str) -> str | None:
    """Return the pattern (XPath's) if it means the same in ECMAScript (ECMA-262 22.2), else None.

    Subtraction, flags, and the escapes of names, blocks and common letters are not ECMAScript's.
    """
    return pattern if _OF_ECMA.fullmatch(pattern) else None
