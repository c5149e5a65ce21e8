"""Numbers that may be sent to a robot: finite ones, and plausible velocities.

A base that receives NaN loses its position for good, and one that receives 1e300 overflows when it squares it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import TypeAlias

import numpy as np

from rosld.adapters.model import Array, Field, FieldType, Message, MessageSchema, Nested, ParameterValue, Primitive
from rosld.ontology.literals import special_float
from rosld.ontology.neutral_message import COMMANDS
from rosld.ontology.violations import Findings, LoweringError, Path

LARGEST_NUMBER = math.nextafter(3.4028235677973366e38, 0)
"""Largest number that is finite as a float32, which many controllers use."""
LARGEST_VELOCITY = 1e6
"""Largest number in a velocity command, in m/s, rad/s and their derivatives."""

_Report: TypeAlias = Callable[[Path, float], None]
_Check: TypeAlias = Callable[[object, Path, float, _Report], None]


def largest_number(schema: MessageSchema) -> float:
    """Return the largest absolute value of a float in a message of this type."""
    return LARGEST_VELOCITY if schema.ref.name in COMMANDS else LARGEST_NUMBER


def is_any_number_meant(field: Field) -> bool:
    """Whether the definition of a float has a default that is not finite, which then has a meaning."""
    return isinstance(field.default, float) and not math.isfinite(field.default)


def require_finite_message(schema: MessageSchema, message: Message, hint: str) -> None:
    """Raise LoweringError if a float of a command is not finite or too large; `hint` explains how to send it anyway."""
    check = _message_check(schema, schema.ref.name)
    if check is not None:
        largest, findings = largest_number(schema), Findings()
        check(message, None, largest, _reporting(findings, largest, hint))
        if findings.violations:
            raise LoweringError(*findings.violations)


def require_finite_parameter(value: ParameterValue, path: Path, hint: str) -> None:
    """Raise LoweringError if a parameter, or an element of one, is a float that is not finite or too large."""
    findings = Findings()
    report = _reporting(findings, LARGEST_NUMBER, hint)
    for index, each in enumerate(value if isinstance(value, list) else [value]):
        if isinstance(each, float):
            _check_float(each, (path, str(index)) if isinstance(value, list) else path, LARGEST_NUMBER, report)
    if findings.violations:
        raise LoweringError(*findings.violations)


def _reporting(findings: Findings, largest: float, hint: str) -> _Report:
    def report(path: Path, value: float) -> None:
        number_text = f"{value:g}" if math.isfinite(value) else special_float(value)
        demand = f"a number from {-largest:.2g} to {largest:.2g}" if math.isfinite(value) else "a finite number"
        findings.add(path, f"must be {demand}, not {number_text}; {hint}", number_text)

    return report


def _check_float(value: object, path: Path, largest: float, report: _Report) -> None:
    assert isinstance(value, int | float)
    if not -largest <= value <= largest:
        report(path, value)


@lru_cache(maxsize=1024)
def _message_check(schema: MessageSchema, name: str) -> _Check | None:
    """Return the check of a type of a schema; None if it has no floats."""
    checks = [
        (field, check)
        for field in schema.types[name].fields
        if not is_any_number_meant(field) and (check := _field_check(schema, field.type))
    ]

    def check_message(value: object, path: Path, largest: float, report: _Report) -> None:
        for field, check in checks:
            check(getattr(value, field.attribute), (path, field.name), largest, report)

    return check_message if checks else None


def _field_check(schema: MessageSchema, kind: FieldType) -> _Check | None:
    match kind:
        case Nested(name=name):
            return _message_check(schema, name)
        case Primitive(name="float32" | "float64"):
            return _check_float
        case Array(element=Primitive(name="float32" | "float64")):
            return _check_floats
        case Array(element=Nested(name=name)) if (inner := _message_check(schema, name)) is not None:
            return _each(inner)
    return None


def _each(check: _Check) -> _Check:
    def check_elements(values: object, path: Path, largest: float, report: _Report) -> None:
        assert isinstance(values, list)
        for index, each in enumerate(values):
            check(each, (path, str(index)), largest, report)

    return check_elements


def _check_floats(values: object, path: Path, largest: float, report: _Report) -> None:
    assert isinstance(values, np.ndarray)
    if values.size and not (-largest <= float(values.min()) and float(values.max()) <= largest):  # NaN is unordered
        for index in np.flatnonzero(~(np.abs(values.astype(np.float64)) <= largest)):
            report((path, str(index)), float(values[index]))
