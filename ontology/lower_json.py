"""Lowering from JSON values: tables of readers, made once a schema.

A reader takes a value, as `parse_json` gives it, and the path to it; it returns what belongs into the message or
raises `Misfit`. The reader of a message collects its fields' misfits as violations instead, so that all are told.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import isfinite
from typing import Any, NamedTuple, TypeAlias, cast

import numpy as np
import orjson

from rosld.adapters.model import Array, Field, FieldType, Message, MessageSchema, Nested, Primitive
from rosld.ontology.fitting import (
    RANGES,
    SPECIALS,
    Misfit,
    Numbers,
    base64_octets,
    described,
    float_fit,
    integer_fit,
    is_octets,
    octet_array,
    sized,
    string_fit,
)
from rosld.ontology.literals import BASE64, DTYPES, STRINGS
from rosld.ontology.violations import Findings, Path

Leaf: TypeAlias = Callable[[object], object]
Reader: TypeAlias = Callable[[object, Path, "JsonReading"], object]


class JsonReading(NamedTuple):
    """One lowering under way; `defaults`: fields that are missing have ROS's defaults."""

    findings: Findings
    defaults: bool


def json_leaf(kind: Primitive | Array) -> Leaf:
    """The reader of a primitive or of an array of them. It raises Misfit, for an element with its index as path."""
    if isinstance(kind, Array):
        return _array(kind)
    if kind.name in STRINGS:
        return _string(kind)
    if kind.name == "bool":
        return _bool
    return _float(kind) if kind.name.startswith("float") else _integer(kind)


def _bool(value: object) -> bool:
    if value is True or value is False:
        return value
    raise _unexpected(Primitive("bool"), value)


def _integer(kind: Primitive) -> Leaf:
    fit = integer_fit(kind)
    wide = kind.name.endswith("64")

    def read(value: object) -> int:
        if type(value) is int or type(value) is float:
            return fit(value)
        if wide and isinstance(value, str) and _is_integer(value):
            return fit(int(value))
        raise _unexpected(kind, value)

    return read


def _is_integer(text: str) -> bool:
    return len(text) <= 24 and text.isascii() and text.removeprefix("-").isdigit()


def _float(kind: Primitive) -> Leaf:
    fit = float_fit(kind)

    def read(value: object) -> float:
        if type(value) is float and not isfinite(value):  # 1e400: JSON has no infinity, this was a number too large
            raise Misfit(f"expected a {kind.name}, and this is beyond its range", value)
        if type(value) is float or type(value) is int:
            return fit(value)
        if isinstance(value, str):
            if value == "-0.0":
                return -0.0
            if value in SPECIALS:
                return SPECIALS[value]
            if _is_integer(value):
                return fit(int(value))
        raise _unexpected(kind, value)

    return read


def _string(kind: Primitive) -> Leaf:
    fit = string_fit(kind)

    def read(value: object) -> str:
        if isinstance(value, str):
            return fit(_utf8(value))
        if isinstance(value, dict) and value.keys() == {"@value", "@type"} and value["@type"] == BASE64:
            return fit(_raw(value["@value"]))
        raise _unexpected(kind, value)

    return read


def _utf8(value: str) -> str:
    try:
        value.encode()
    except UnicodeEncodeError as error:
        raise Misfit("expected a string of Unicode characters, and half a surrogate pair is none", value) from error
    return value


def _raw(value: object) -> str:
    if not isinstance(value, str):
        raise Misfit("expected base64", value)
    return base64_octets(value).decode("utf-8", "surrogateescape")


def _unexpected(kind: FieldType, value: object) -> Misfit:
    if isinstance(value, dict) and value.get("elided") is True:
        return Misfit("this was left out where it was read (elided): fetch it and send it whole", value)
    return Misfit(f"expected {described(kind)}", value)


# Arrays of primitives


def _array(kind: Array) -> Leaf:
    element = cast(Primitive, kind.element)
    values = _string_array(kind, element) if element.name in STRINGS else _number_array(kind, element)
    octets = is_octets(kind)

    def read(value: object) -> object:
        if octets and isinstance(value, str):
            return octet_array(kind, base64_octets(value))
        if not isinstance(value, list):
            raise _unexpected(kind, value)
        return values(sized(kind, value))

    return read


def _string_array(kind: Array, element: Primitive) -> Callable[[list[object]], object]:
    read = json_leaf(element)
    return lambda values: each(read, values)


def _number_array(kind: Array, element: Primitive) -> Callable[[list[object]], object]:
    dtype, read = DTYPES[element.name], json_leaf(element)
    whole = _floats_at_once if dtype.kind == "f" else _bools_at_once if dtype.kind == "b" else _integers_at_once
    limits = RANGES.get(element.name, (0, 0))

    def numbers(values: list[object]) -> Numbers:
        fast = whole(values, dtype, limits)
        return np.array(each(read, values), dtype) if fast is None else fast

    return numbers


def each(read: Leaf, values: Sequence[object]) -> list[object]:
    """All values read, one by one; a misfit has the index as its path."""
    found = []
    for index, value in enumerate(values):
        try:
            found.append(read(value))
        except Misfit as misfit:
            raise Misfit(misfit.words, misfit.value, str(index)) from misfit
    return found


# These three read a whole array of what is plainly right, and return None to have it read one by one instead.


def _floats_at_once(values: list[Any], dtype: np.dtype[Any], limits: tuple[int, int]) -> Numbers | None:
    if not set(map(type, values)) <= {float, int}:
        return None
    try:
        with np.errstate(over="ignore"):
            numbers = np.array(values, np.float64).astype(dtype)
    except OverflowError:
        return None
    return numbers if np.isfinite(numbers).all() else None


def _integers_at_once(values: list[Any], dtype: np.dtype[Any], limits: tuple[int, int]) -> Numbers | None:
    if not set(map(type, values)) <= {int}:
        return None
    if values and not (limits[0] <= min(values) and max(values) <= limits[1]):
        return None
    return np.array(values, dtype)


def _bools_at_once(values: list[Any], dtype: np.dtype[Any], limits: tuple[int, int]) -> Numbers | None:
    return np.array(values, dtype) if set(map(type, values)) <= {bool} else None


def array_of_json(kind: Array) -> Callable[[str], object]:
    """The reader of an rdf:JSON literal as an array of primitives. It raises Misfit."""
    read = json_leaf(kind)

    def parse(text: str) -> object:
        try:
            value = orjson.loads(text)
        except orjson.JSONDecodeError as error:
            raise Misfit(f"expected {described(kind)} in JSON ({error.msg})", text) from error
        if not isinstance(value, list):
            raise Misfit(f"expected {described(kind)} in JSON", text)
        return read(value)

    return parse


# Messages


class _Field(NamedTuple):
    field: Field
    read: Reader
    default: Callable[[], object]


class JsonReaders:
    """The readers of one schema's messages."""

    def __init__(self, schema: MessageSchema) -> None:
        self._schema = schema
        self._messages: dict[str, Reader] = {}

    def message(self, name: str) -> Reader:
        """The reader of messages of a type of this schema."""
        if name not in self._messages:
            self._messages[name] = self._message(name)
        return self._messages[name]

    def _message(self, name: str) -> Reader:
        build, kind = self._schema.codec.build, Nested(name)
        fields = {
            field.name: _Field(field, self._reader(field.type), self._default(field.type))
            for field in self._schema.types[name].fields
        }

        def read(value: object, path: Path, reading: JsonReading) -> object:
            if type(value) is not dict:
                raise _unexpected(kind, value)
            values: dict[str, object] = {}
            for key, entry in fields.items():
                if key in value:
                    values[entry.field.attribute] = _read(entry, value[key], (path, key), reading)
                elif reading.defaults:
                    values[entry.field.attribute] = entry.default()
                else:
                    reading.findings.add((path, key), f"missing: expected {described(entry.field.type)}")
            if not value.keys() <= fields.keys():
                for key in value.keys() - fields.keys():
                    reading.findings.add((path, key), f"{name} has no such field; it has {_listed(fields)}")
            return None if reading.findings.violations else build(name, values)

        return read

    def _reader(self, kind: FieldType) -> Reader:
        if isinstance(kind, Nested):
            return self.message(kind.name)
        if isinstance(kind, Array) and isinstance(kind.element, Nested):
            return self._messages_reader(kind, kind.element)
        leaf = json_leaf(kind)
        return lambda value, path, reading: leaf(value)

    def _messages_reader(self, kind: Array, element: Nested) -> Reader:
        one = self.message(element.name)

        def read(value: object, path: Path, reading: JsonReading) -> object:
            if not isinstance(value, list):
                raise _unexpected(kind, value)
            found = []
            for index, item in enumerate(sized(kind, value)):
                try:
                    found.append(one(item, (path, str(index)), reading))
                except Misfit as misfit:
                    reading.findings.misfit((path, str(index)), misfit)
            return found

        return read

    def _default(self, kind: FieldType) -> Callable[[], object]:
        """What ROS fills a missing field with: zeros, empty strings and arrays, defaults all the way down."""
        if isinstance(kind, Nested):
            return lambda: self.default(kind.name)
        if isinstance(kind, Primitive):
            return lambda: _default_primitive(kind)
        element, length = kind.element, kind.length or 0
        if isinstance(element, Primitive) and element.name not in STRINGS:
            return lambda: np.zeros(length, DTYPES[element.name])
        one = self._default(element)
        return lambda: [one() for _ in range(length)]

    def default(self, name: str) -> Message:
        """A message of a type of this schema with every field at its default."""
        fields = self._schema.types[name].fields
        return self._schema.codec.build(name, {field.attribute: self._default(field.type)() for field in fields})


def _read(entry: _Field, value: object, path: Path, reading: JsonReading) -> object:
    try:
        return entry.read(value, path, reading)
    except Misfit as misfit:
        reading.findings.misfit(path, misfit)
        return None


def _default_primitive(kind: Primitive) -> object:
    if kind.name in STRINGS:
        return ""
    if kind.name == "bool":
        return False
    return 0.0 if kind.name.startswith("float") else 0


def _listed(fields: Mapping[str, _Field]) -> str:
    return ", ".join(fields) or "none"
