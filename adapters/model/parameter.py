"""Parameters: their values, and their declarations by nodes in ROS 2 and with dynamic_reconfigure. No I/O."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from enum import Enum
from typing import TypeAlias

ParameterValue: TypeAlias = (
    "bool | int | float | str | bytes | datetime | list[ParameterValue] | dict[str, ParameterValue]"
)
"""A scalar, a list, or a dict (a tree of parameters, or within a list just a dict)."""

_MAX_TEXT = 4096
_CLOSE = 1e-6
"""Tolerance of steps for doubles: rclpy's PARAM_REL_TOL; rclcpp is stricter."""


class ParameterType(Enum):
    """Declared type of a parameter (rcl_interfaces/msg/ParameterType), with the names of ROS 2's tools."""

    BOOLEAN = "boolean"
    INTEGER = "integer"
    DOUBLE = "double"
    STRING = "string"
    BYTE_ARRAY = "byte array"
    BOOLEAN_ARRAY = "boolean array"
    INTEGER_ARRAY = "integer array"
    DOUBLE_ARRAY = "double array"
    STRING_ARRAY = "string array"


@dataclass(frozen=True, slots=True)
class Range:
    """Range of a numeric parameter, both ends included (rcl_interfaces/msg/IntegerRange, FloatingPointRange).

    With a `step` (above 0), values are counted from `minimum`; `maximum` is always valid. No end is NaN.
    """

    minimum: int | float
    maximum: int | float
    step: int | float | None = None

    def contains(self, value: int | float) -> bool:
        """Whether a number is within the ends, on a step or not."""
        return self.minimum <= value <= self.maximum

    def is_on_step(self, value: int | float) -> bool:
        """Whether a number within the ends is on a step; floats approximately, as in ROS 2."""
        if self.step is None or value == self.maximum:
            return True
        if isinstance(value, int) and isinstance(self.minimum, int) and isinstance(self.step, int):
            return (value - self.minimum) % self.step == 0
        steps = (value - self.minimum) / self.step
        if not math.isfinite(steps):
            return True
        nearest = self.minimum + round(steps) * self.step
        return math.isclose(nearest, value, rel_tol=_CLOSE, abs_tol=_CLOSE * self.step)


@dataclass(frozen=True, slots=True)
class Choice:
    """One of a parameter's possible values (dynamic_reconfigure): its name and its description."""

    value: bool | int | float | str
    name: str = ""
    description: str = ""


@dataclass(frozen=True, slots=True)
class Descriptor:
    """A node's declaration of a parameter (rcl_interfaces/ParameterDescriptor, dynamic_reconfigure/ParamDescription).

    `type` is None if the node does not report it, or if the type may change (`dynamic_typing`); `range` is for an
    integer or a double, else None. `constraints` is a text about other constraints. `choices` are the only values
    allowed, of the declared type; if empty, any value is allowed.
    """

    type: ParameterType | None = None
    description: str = ""
    read_only: bool = False
    dynamic_typing: bool = False
    constraints: str = ""
    range: Range | None = None
    choices: tuple[Choice, ...] = ()


def shortened(text: str) -> str:
    """Return a node's text with at most 4096 characters, all of which can be encoded."""
    short = text if len(text) <= _MAX_TEXT else text[: _MAX_TEXT - 1] + "…"
    return short.encode("utf-8", "replace").decode()


def as_declared(value: ParameterValue, descriptor: Descriptor | None) -> ParameterValue:
    """Return the value converted to the declared type if possible; the node checks other values."""
    fit = None if descriptor is None or descriptor.type is None else coerce(value, descriptor.type)
    return value if fit is None else fit


def coerce(value: ParameterValue, type: ParameterType) -> ParameterValue | None:
    """Return the value converted to this type, or None: 1 is also a double, and 1.0 also an integer."""
    element = _ELEMENTS.get(type)
    if element is None:
        return _octets(value) if type is ParameterType.BYTE_ARRAY else _scalar(value, type)
    if not isinstance(value, list):
        return None
    values: list[ParameterValue] = [fit for each in value if (fit := _scalar(each, element)) is not None]
    return values if len(values) == len(value) else None


_ELEMENTS: Mapping[ParameterType, ParameterType] = {
    ParameterType.BOOLEAN_ARRAY: ParameterType.BOOLEAN,
    ParameterType.INTEGER_ARRAY: ParameterType.INTEGER,
    ParameterType.DOUBLE_ARRAY: ParameterType.DOUBLE,
    ParameterType.STRING_ARRAY: ParameterType.STRING,
}


def _scalar(value: ParameterValue, type: ParameterType) -> bool | int | float | str | None:
    match type, value:
        case ParameterType.STRING, str(text):
            return text
        case ParameterType.BOOLEAN, bool(truth):
            return truth
        case _, bool():
            return None
        case ParameterType.INTEGER, int(number):
            return number
        case ParameterType.INTEGER, float(real):
            return int(real) if real.is_integer() else None
        case ParameterType.DOUBLE, int(number) | float(number):
            return _double(number)
    return None


def _double(value: int | float) -> float | None:
    try:
        return float(value)
    except OverflowError:
        return None


def _octets(value: ParameterValue) -> bytes | None:
    """Return octets or None; an empty list is valid for any array type."""
    return value if isinstance(value, bytes) else b"" if value == [] else None
