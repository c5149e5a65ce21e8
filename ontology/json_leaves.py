"""Leaves: JSON values as primitives and as arrays of them.

A leaf takes a value from `parse_json` and returns the value for the message or raises `Misfit`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from math import isfinite
from typing import Any, TypeAlias, TypeVar, cast

import numpy as np
import orjson

from rosld.adapters.model import STRINGS, Array, Field, FieldType, Nested, Primitive
from rosld.adapters.model.schema import Scalar
from rosld.ontology.coercion import (
    RANGES,
    SPECIALS,
    Misfit,
    Numbers,
    base64_octets,
    check_length,
    describe_kind,
    float_fit,
    integer_fit,
    is_octets,
    octet_array,
    string_fit,
)
from rosld.ontology.literals import BASE64, DTYPES, base64_text, special_float, wide_integer_json

_T = TypeVar("_T")
Leaf: TypeAlias = Callable[[object], object]

_INTEGER = re.compile(r"-?(0|[1-9][0-9]{0,23})", re.ASCII)


def json_leaf(kind: Primitive | Array) -> Leaf:
    """Return the reader of a primitive or an array of primitives. It raises Misfit, for an element with its index."""
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
    raise unexpected_value(Primitive("bool"), value)


def _integer(kind: Primitive) -> Leaf:
    fit = integer_fit(kind)
    wide = kind.name.endswith("64")

    def read(value: object) -> int:
        if type(value) is int or type(value) is float:
            return fit(value)
        if wide and isinstance(value, str) and _is_integer(value):
            return fit(int(value))
        raise unexpected_value(kind, value)

    return read


def _is_integer(text: str) -> bool:
    return _INTEGER.fullmatch(text) is not None


def _float(kind: Primitive) -> Leaf:
    fit = float_fit(kind)

    def read(value: object) -> float:
        if type(value) is float and not isfinite(value):  # 1e400: JSON has no infinity, the number is too large
            raise Misfit(f"expected a {kind.name}, but this is out of its range", value)
        if type(value) is float or type(value) is int:
            return fit(value)
        if isinstance(value, str):
            if value == "-0.0":
                return -0.0
            if value in SPECIALS:
                return SPECIALS[value]
            if _is_integer(value):
                return fit(int(value))
        raise unexpected_value(kind, value)

    return read


def _string(kind: Primitive) -> Leaf:
    fit = string_fit(kind)

    def read(value: object) -> str:
        if isinstance(value, str):
            return fit(_utf8(value))
        if isinstance(value, dict) and value.keys() == {"@value", "@type"} and value["@type"] == BASE64:
            return fit(_raw(value["@value"]))
        raise unexpected_value(kind, value)

    return read


def _utf8(value: str) -> str:
    try:
        value.encode()
    except UnicodeEncodeError as error:
        raise Misfit("expected a string of Unicode characters, without lone surrogates", value) from error
    return value


def _raw(value: object) -> str:
    if not isinstance(value, str):
        raise Misfit("expected base64", value)
    return base64_octets(value).decode("utf-8", "surrogateescape")


def unexpected_value(kind: FieldType, value: object) -> Misfit:
    """Return the misfit of a value of the wrong kind, which mentions if it was elided."""
    if isinstance(value, dict) and value.get("elided") is True:
        return Misfit("this was elided when it was read: fetch it and send all of it", value)
    return Misfit(f"expected {describe_kind(kind)}", value)


# Arrays of primitives


def _array(kind: Array) -> Leaf:
    element = cast(Primitive, kind.element)
    values = _string_array(kind, element) if element.name in STRINGS else _number_array(kind, element)
    octets = is_octets(kind)

    def read(value: object) -> object:
        if octets and isinstance(value, str):
            return octet_array(kind, base64_octets(value))
        if not isinstance(value, list):
            raise unexpected_value(kind, value)
        return values(check_length(kind, value))

    return read


def _string_array(kind: Array, element: Primitive) -> Callable[[list[object]], object]:
    read = json_leaf(element)
    return lambda values: read_all(read, values)


def _number_array(kind: Array, element: Primitive) -> Callable[[list[object]], object]:
    dtype, read = DTYPES[element.name], json_leaf(element)
    whole = _floats_at_once if dtype.kind == "f" else _bools_at_once if dtype.kind == "b" else _integers_at_once
    limits = RANGES.get(element.name, (0, 0))

    def numbers(values: list[object]) -> Numbers:
        fast = whole(values, dtype, limits)
        return np.array(read_all(read, values), dtype) if fast is None else fast

    return numbers


def read_all(read: Callable[[_T], object], values: Sequence[_T]) -> list[object]:
    """Read all values, one by one. Raises Misfit, whose path is the index of the value."""
    found = []
    for index, value in enumerate(values):
        try:
            found.append(read(value))
        except Misfit as misfit:
            raise Misfit(misfit.words, misfit.value, str(index)) from misfit
    return found


# These three read a whole array of obviously valid values, or return None to have it read one by one instead.


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
    """Return the reader of an rdf:JSON literal as an array of primitives. It raises Misfit.

    Integers must have no fraction: a shape could not distinguish which other numbers are integers.
    """
    read, is_integer = json_leaf(kind), kind.element.name in RANGES

    def parse(text: str) -> object:
        try:
            value = orjson.loads(text)
        except orjson.JSONDecodeError as error:
            raise Misfit(f"expected {describe_kind(kind)} in JSON ({error.msg})", text) from error
        if not isinstance(value, list):
            raise Misfit(f"expected {describe_kind(kind)} in JSON", text)
        if is_integer and float in set(map(type, value)):
            raise Misfit(f"expected {describe_kind(kind)}, written without fraction and exponent", text)
        return read(value)

    return parse


Plain: TypeAlias = "Scalar | list[Scalar]"


def stated_default(field: Field) -> Plain | None:
    """Return the default in the definition of a field, or None if there is none or no message can hold it."""
    kind, stated = field.type, field.default
    if stated is None or isinstance(kind, Nested):
        return None
    plain = _default_array(kind, stated) if isinstance(stated, tuple) else _plain(stated)
    try:
        json_leaf(kind)(plain)
    except Misfit:
        return None
    return plain


def zero_value(kind: Primitive) -> Scalar:
    """Return the default of a primitive."""
    if kind.name in STRINGS:
        return ""
    if kind.name == "bool":
        return False
    return 0.0 if kind.name.startswith("float") else 0


def _default_array(kind: FieldType, values: tuple[Scalar, ...]) -> Plain:
    """Return an array as JSON: octets are base64."""
    if isinstance(kind, Array) and is_octets(kind):
        return base64_text(bytes(int(value) & 0xFF for value in values))
    return list(map(_plain, values))


def _plain(value: Scalar) -> Scalar:
    """Return a scalar as JSON: numbers that JSON cannot represent are strings."""
    if isinstance(value, bool | str):
        return value
    if isinstance(value, int):
        return wide_integer_json(value)
    return value if math.isfinite(value) else special_float(value)
