"""Defaults of fields: what a field of a new message holds, as plain JSON. Pure."""

from __future__ import annotations

import math
from typing import TypeAlias

from rosld.adapters.model import Array, Field, FieldType, Nested, Primitive
from rosld.adapters.model.schema import Scalar
from rosld.ontology.coercion import Misfit, is_octets
from rosld.ontology.json_leaves import json_leaf
from rosld.ontology.literals import STRINGS, base64_text, special_float, wide_integer_json

Plain: TypeAlias = "Scalar | list[Scalar]"


def stated_default(field: Field) -> Plain | None:
    """The value that the definition of a field gives it; None where that says nothing, or what no message can hold."""
    kind, stated = field.type, field.default
    if stated is None or isinstance(kind, Nested):
        return None
    plain = _array(kind, stated) if isinstance(stated, tuple) else _plain(stated)
    try:
        json_leaf(kind)(plain)
    except Misfit:
        return None
    return plain


def zero_value(kind: Primitive) -> Scalar:
    """The default of a primitive."""
    if kind.name in STRINGS:
        return ""
    if kind.name == "bool":
        return False
    return 0.0 if kind.name.startswith("float") else 0


def _array(kind: FieldType, values: tuple[Scalar, ...]) -> Plain:
    """An array as JSON: octets are base64."""
    if isinstance(kind, Array) and is_octets(kind):
        return base64_text(bytes(int(value) & 0xFF for value in values))
    return list(map(_plain, values))


def _plain(value: Scalar) -> Scalar:
    """A scalar as JSON has it: numbers that JSON has not are strings."""
    if isinstance(value, bool | str):
        return value
    if isinstance(value, int):
        return wide_integer_json(value)
    return value if math.isfinite(value) else special_float(value)
