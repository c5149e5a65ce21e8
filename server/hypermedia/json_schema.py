"""JSON Schemas of values and messages, for Thing Descriptions (data schemas: WoT TD 1.1, 5.3.2) and OpenAPI 3.1. Pure.

They describe the JSON of rosld: integers that a double may not represent are strings of digits; NaN, INF and -INF are
strings; octets are base64; an array that is too large is an object with the URL of its bytes. To keep plain values
simple, the schemas ignore strings that are too large or not UTF-8, and missing values (null). Values to send are
commands: their floats are numbers, and those of velocities have a range.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from typing import TypeAlias, TypeVar, cast

from pyoxigraph import Literal

from rosld.adapters.model import (
    STRINGS,
    ActionSchema,
    Array,
    Field,
    FieldType,
    MessageSchema,
    Nested,
    Primitive,
    Schema,
    ServiceSchema,
    TypeRef,
)
from rosld.ontology.coercion import RANGES, is_octets
from rosld.ontology.json_leaves import stated_default, zero_value
from rosld.ontology.lift import LiftSettings
from rosld.ontology.literals import SAFE_INTEGER, base64_length, special_float, wide_integer_json
from rosld.ontology.units import Quantity, quantity_within
from rosld.ontology.vocab import xsd
from rosld.shapes.command_numbers import LARGEST_VELOCITY, is_any_number_meant, largest_number
from rosld.shapes.terms import number
from rosld.shapes.value import UNBOUNDED, Bounds, MessageShape, ScalarShape, ValueShape

Json: TypeAlias = "bool | int | float | str | list[Json] | dict[str, Json] | None"
_T = TypeVar("_T")

JsonSchema: TypeAlias = dict[str, Json]

ANYTHING: JsonSchema = {}
TEXT: JsonSchema = {"type": "string"}
BOOLEAN: JsonSchema = {"type": "boolean"}
NUMBER: JsonSchema = {"type": "number"}
URI: JsonSchema = {"type": "string", "format": "uri"}
OBJECT: JsonSchema = {"type": "object"}
NOTHING: JsonSchema = {"type": "null"}
JSON_LD: JsonSchema = {"anyOf": [{"type": "object"}, {"type": "array", "items": {}}]}


def json_object(required: Mapping[str, Json] | None = None, optional: Mapping[str, Json] | None = None) -> JsonSchema:
    """Return the schema of an object with these members."""
    properties = {**(required or {}), **(optional or {})}
    return {"type": "object", "properties": properties, **({"required": list[Json](required)} if required else {})}


def json_array(items: JsonSchema) -> JsonSchema:
    """Return the schema of an array."""
    return {"type": "array", "items": items}


_MAX_NODES = 2000
_DEEPEST = 32
_FLOATS = frozenset({"float32", "float64"})
_VELOCITIES: JsonSchema = {"minimum": -LARGEST_VELOCITY, "maximum": LARGEST_VELOCITY}
_SPECIALS: JsonSchema = {"type": "string", "enum": ["NaN", "INF", "-INF"]}
_DIGITS: JsonSchema = {"type": "string", "pattern": "^-?[0-9]{16,20}$"}
_LENGTH: JsonSchema = {"type": "integer", "minimum": 0}
_ELIDED = {**json_object({"elided": {**BOOLEAN, "const": True}, "length": _LENGTH, "href": TEXT}), "readOnly": True}
_SETTINGS = LiftSettings()


def value_schema(
    shape: ValueShape, lifting: LiftSettings = _SETTINGS, *, read: bool = True, sent: bool = False, unit: str = "unit"
) -> JsonSchema:
    """Return the schema of a property's value when read, when sent, or both.

    In a value to send, fields have defaults and are optional. `unit` is the keyword for the unit.
    """
    if isinstance(shape, MessageShape):
        return _Schemas(shape.schema, shape.bounds, lifting, read, sent, unit).fields(shape.fields)
    if isinstance(shape, ScalarShape) and shape.is_parameter:
        found = _parameter_schema(shape.kind, shape.bounds)
    else:
        found = _scalar(shape.kind, shape.bounds, is_finite=sent)
    return found if shape.quantity.unit is None else {**found, unit: shape.quantity.unit}


def message_schema(
    schema: MessageSchema,
    lifting: LiftSettings = _SETTINGS,
    *,
    read: bool = True,
    sent: bool = False,
    unit: str = "unit",
) -> JsonSchema:
    """Return the schema of a message, the object of its fields, which are optional when the message is sent."""
    return _Schemas(schema, {}, lifting, read, sent, unit).fields(schema.type.fields)


def patch_schema(schema: JsonSchema) -> JsonSchema:
    """Return the schema of a JSON merge patch (RFC 7396): any members of an object, else the whole value."""
    members = schema.get("properties")
    if not isinstance(members, dict):
        return {name: each for name, each in schema.items() if name != "default"}  # omitted members stay unchanged
    return json_object(optional={name: patch_schema(cast(JsonSchema, each)) for name, each in members.items()})


def nullable(schema: JsonSchema) -> JsonSchema:
    """Return the schema of a value that may be missing."""
    return {"anyOf": [schema, NOTHING]} if schema else schema


class _Schemas:
    """Schemas within one message type, limited in number because types are provided by robots."""

    def __init__(
        self,
        schema: MessageSchema,
        bounds: Mapping[str, Bounds],
        lifting: LiftSettings,
        read: bool,
        sent: bool,
        unit: str,
    ) -> None:
        self._root = schema.ref.name
        self._unit = unit
        self._types = schema.types
        self._bounds = bounds
        self._read = read
        self._limit = lifting.inline_limit
        self._sent = sent
        self._range = _VELOCITIES if sent and largest_number(schema) == LARGEST_VELOCITY else {}
        self._left = _MAX_NODES

    def fields(
        self,
        fields: Iterable[Field],
        path: tuple[str, ...] = (),
        name: str | None = None,
        enclosing: Quantity | None = None,
    ) -> JsonSchema:
        """Return an object of fields of the type `name` (by default that of the message)."""
        properties: dict[str, Json] = {}
        for field in fields:
            inner = (*path, field.name)
            is_finite = self._sent and not is_any_number_meant(field)
            quantity = quantity_within(enclosing, name or self._root, field)
            own = self._field(field.type, inner, quantity, is_finite=is_finite)
            own |= self._default(field, inner) if self._sent else {}
            if quantity is not None and quantity.unit is not None and field.nested is None:
                own[self._unit] = quantity.unit
            properties[field.name] = own
        return {"type": "object", "properties": properties, **({} if self._sent else {"required": list(properties)})}

    def _default(self, field: Field, path: tuple[str, ...]) -> JsonSchema:
        """Return the default of a field: of scalars, of arrays without a fixed length, and of fields that state one.

        Defaults that bounds may reject are omitted.
        """
        stated, kind = stated_default(field), field.type
        if self._bounds.get(".".join(path), UNBOUNDED) != UNBOUNDED:
            return {}
        if stated is not None:
            return {"default": list(stated) if isinstance(stated, list) else stated}
        if isinstance(kind, Primitive):
            return {"default": zero_value(kind)}
        if isinstance(kind, Array) and kind.length is None:
            return {"default": "" if is_octets(kind) else []}
        return {}

    def _field(
        self, kind: FieldType, path: tuple[str, ...], quantity: Quantity | None, *, is_finite: bool
    ) -> JsonSchema:
        self._left -= 1
        if isinstance(kind, Array):
            return self._array(kind, path, quantity)
        if isinstance(kind, Primitive):
            found = _scalar(kind, self._bounds.get(".".join(path), UNBOUNDED), is_finite=is_finite)
            return self._range | found if kind.name in _FLOATS else found
        if self._left < 0 or len(path) >= _DEEPEST:
            return {"type": "object"}
        return self.fields(self._types[kind.name].fields, path, kind.name, quantity)

    def _array(self, kind: Array, path: tuple[str, ...], quantity: Quantity | None) -> JsonSchema:
        least, most = kind.length, kind.most
        if is_octets(kind):
            lengths = without_none(minLength=base64_length(least), maxLength=base64_length(most))
            found: JsonSchema = {"type": "string", "contentEncoding": "base64", **lengths}
        else:
            lengths = without_none(minItems=least, maxItems=most)
            found = {"type": "array", "items": self._element(kind.element, path, quantity), **lengths}
        return {"oneOf": [found, _ELIDED]} if self._read and self._may_be_elided(kind) else found

    def _element(self, kind: Primitive | Nested, path: tuple[str, ...], quantity: Quantity | None) -> JsonSchema:
        if isinstance(kind, Nested):
            return self._field(kind, path, quantity, is_finite=self._sent)
        if kind.name in _FLOATS:
            specials: list[Json] = ["-0.0"] if self._sent else ["NaN", "INF", "-INF", "-0.0"]
            return {"oneOf": [{"type": "number"}, {"type": "string", "enum": specials}]}
        return _scalar(kind, UNBOUNDED)

    def _may_be_elided(self, kind: Array) -> bool:
        """Whether a field may exceed the size limit of arrays, at eight bytes per element, the largest of a number."""
        is_plain = isinstance(kind.element, Primitive) and kind.element.name not in STRINGS
        return not is_plain or kind.most is None or kind.most * 8 > self._limit


# Scalars


def _scalar(kind: Primitive | None, bounds: Bounds, *, is_finite: bool = False) -> JsonSchema:
    """Return the schema of a scalar of a primitive (or of any type) within bounds; a float may have to be finite."""
    if bounds.choices:
        choices = {(type(value), value): value for value in map(_choice, bounds.choices)}
        return {**_type(kind), "enum": list(choices.values())}
    if kind is not None and kind.name in STRINGS:
        longest = [count for count in (bounds.max_length, kind.bound) if count is not None]
        return {
            "type": "string",
            **without_none(
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


def _parameter_schema(kind: Primitive, bounds: Bounds) -> JsonSchema:
    """Return the schema of a scalar parameter, whose numbers are those of JSON."""
    if bounds.choices or kind.name in STRINGS or kind.name == "bool":
        return _scalar(kind, bounds)
    limits, step = _limits(bounds), _number(bounds.step)
    ends = (limits.get("minimum"), limits.get("maximum"))
    even = isinstance(step, int) and all(isinstance(each, int) and each % step == 0 for each in ends)
    type = "integer" if kind.name in RANGES else "number"
    return {"type": type, **limits, **without_none(multipleOf=step if even else None)}


def _type(kind: Primitive | None) -> JsonSchema:
    """Return the type of a choice; floats and wide integers may be strings too."""
    if kind is None or kind.name.startswith("float") or kind.name.endswith("64"):
        return {}
    return {"type": "string" if kind.name in STRINGS else "boolean" if kind.name == "bool" else "integer"}


def _integer(kind: Primitive, limits: JsonSchema) -> JsonSchema:
    """Return the schema of an integer in a primitive's range; a string of digits beyond the precision of a double."""
    least, greatest = RANGES[kind.name]
    if not limits.keys() & {"minimum", "exclusiveMinimum"}:
        limits = {**limits, "minimum": max(least, -SAFE_INTEGER)}
    if not limits.keys() & {"maximum", "exclusiveMaximum"}:
        limits = {**limits, "maximum": min(greatest, SAFE_INTEGER)}
    found: JsonSchema = {"type": "integer", **limits}
    is_wide = limits.get("minimum") == -SAFE_INTEGER or limits.get("maximum") == SAFE_INTEGER
    return {"oneOf": [found, _DIGITS]} if is_wide else found


def _limits(bounds: Bounds) -> JsonSchema:
    return without_none(
        minimum=_number(bounds.minimum),
        maximum=_number(bounds.maximum),
        exclusiveMinimum=_number(bounds.exclusive_minimum),
        exclusiveMaximum=_number(bounds.exclusive_maximum),
    )


def _number(literal: Literal | None) -> int | float | None:
    """Return a bound as a JSON number; None for other literals and for numbers that JSON cannot represent."""
    value = None if literal is None else number(literal)
    if value is None or isinstance(value, int):
        return None if value is None or abs(value) > SAFE_INTEGER else value
    return float(value) if math.isfinite(value) else None


def _choice(literal: Literal) -> bool | int | float | str:
    if literal.datatype == xsd.boolean:
        return literal.value in ("true", "1")
    value = number(literal)
    if value is None or isinstance(value, int):
        return literal.value if value is None else wide_integer_json(value)
    return float(value) if math.isfinite(value) else special_float(float(value))


def without_none(**keywords: _T | None) -> dict[str, _T]:
    """Return the keywords that have a value."""
    return {name: value for name, value in keywords.items() if value is not None}


_ESCAPE = r"\\[dDwWsSnrt.\\()\[\]{}+*?^$|]"
_OF_ECMA = re.compile(rf"(?:[^\\(\[\]{{]|{_ESCAPE}|\((?!\?[^:])|\{{(?!,)|\[(?:[^\\\[\]]|\\-|{_ESCAPE})*\])*", re.DOTALL)


def _ecma(pattern: str) -> str | None:
    """Return an XPath pattern if it means the same in ECMAScript (ECMA-262 22.2), else None.

    ECMAScript lacks subtraction, flags, and the escapes of names, blocks and common letters.
    """
    return pattern if _OF_ECMA.fullmatch(pattern) else None


_Kind = TypeVar("_Kind", MessageSchema, ServiceSchema, ActionSchema)
_NOT_IN_A_KEY = re.compile(r"[^A-Za-z0-9._-]")


class MessageSchemas:
    """Collector of referenced schemas. `find` returns a type, or None if it is unknown.

    Messages of an unknown type are objects without further constraints.
    """

    def __init__(self, find: Callable[[TypeRef], Schema | None], lifting: LiftSettings) -> None:
        self.lifting = lifting
        self.by_key: dict[str, JsonSchema] = {}
        """Schemas that `#/components/schemas/KEY` references."""
        self._find = find
        self._keys: dict[TypeRef, str] = {}

    def find(self, ref: TypeRef | None, kind: type[_Kind]) -> _Kind | None:
        """Return a type of a kind (of messages, services or actions)."""
        found = None if ref is None else self._find(ref)
        return found if isinstance(found, kind) else None

    def read(self, schema: MessageSchema | None) -> JsonSchema:
        """Return a reference to the schema of a message when read."""
        if schema is None:
            return OBJECT
        key = self._key(schema.ref)
        return self._shared(key, lambda: message_schema(schema, self.lifting, unit="x-unit"))

    def write(self, schema: MessageSchema | None) -> JsonSchema:
        """Return a reference to the schema of a message when sent, in which members with defaults are optional."""
        if schema is None:
            return OBJECT
        key = f"{self._key(schema.ref)}.sent"
        return self._shared(key, lambda: message_schema(schema, self.lifting, read=False, sent=True, unit="x-unit"))

    def value(self, shape: ValueShape, *, sent: bool = False) -> JsonSchema:
        """Return the schema of a property's value when read, or when sent."""
        return value_schema(shape, self.lifting, read=not sent, sent=sent, unit="x-unit")

    def _shared(self, key: str, make: Callable[[], JsonSchema]) -> JsonSchema:
        if key not in self.by_key:
            self.by_key[key] = make()
        return {"$ref": f"#/components/schemas/{key}"}

    def _key(self, ref: TypeRef) -> str:
        """Return the name of the schema of a type; variants of a type include its hash."""
        key = self._keys.get(ref)
        if key is None:
            key = _NOT_IN_A_KEY.sub(".", ref.name)
            if key in self._keys.values():
                key = f"{key}.{_NOT_IN_A_KEY.sub('.', ref.hash or '')}.{len(self._keys)}"
            self._keys[ref] = key
        return key
