"""Parameters: what one can hold, and what its node declares of it: in ROS 2, and by dynamic_reconfigure. Pure."""

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

_CLOSE = 1e-6
"""How far from a step a double may be: rclpy's PARAM_REL_TOL; rclcpp is stricter."""


class ParameterType(Enum):
    """The types that a parameter is declared with (rcl_interfaces/msg/ParameterType), as ROS 2's tools call them."""

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
    """The numbers that a parameter may have, both ends included (rcl_interfaces/msg/IntegerRange, FloatingPointRange).

    With a `step` (above 0) they are counted from `minimum`; `maximum` is always among them. No end is NaN.
    """

    minimum: int | float
    maximum: int | float
    step: int | float | None = None

    def contains(self, value: int | float) -> bool:
        """Whether a number lies within, on a step or not."""
        return self.minimum <= value <= self.maximum

    def is_on_step(self, value: int | float) -> bool:
        """Whether a number within lies on a step; floats nearly so, as ROS 2 takes them."""
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
    """One of the values that a parameter may have (dynamic_reconfigure): what it is called, and what it is about."""

    value: bool | int | float | str
    name: str = ""
    description: str = ""


@dataclass(frozen=True, slots=True)
class Descriptor:
    """What a node declares of a parameter (rcl_interfaces/ParameterDescriptor, dynamic_reconfigure/ParamDescription).

    `type` is None where the node does not tell, or where the type may change (`dynamic_typing`); the `range` is that of
    an integer or a double, None for any other type. `constraints` are words about what no range can say. `choices` are
    of the type, and the only values that it may have; none where it may have others.
    """

    type: ParameterType | None = None
    description: str = ""
    read_only: bool = False
    dynamic_typing: bool = False
    constraints: str = ""
    range: Range | None = None
    choices: tuple[Choice, ...] = ()


def coerce(value: ParameterValue, type: ParameterType) -> ParameterValue | None:
    """Return the value as one of this type, None where it is none: 1 is a double too, and 1.0 an integer."""
    element = _ELEMENTS.get(type)
    if element is None:
        return _octets(value) if type is ParameterType.BYTE_ARRAY else _scalar(value, type)
    if not isinstance(value, list):
        return None
    found: list[ParameterValue] = [fit for each in value if (fit := _scalar(each, element)) is not None]
    return found if len(found) == len(value) else None


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
    """Return octets; an empty list is one of any type."""
    return value if isinstance(value, bytes) else b"" if value == [] else None
