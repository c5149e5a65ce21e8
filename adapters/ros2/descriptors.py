"""Descriptors of parameters: rcl_interfaces/msg/ParameterDescriptor, as any node may have filled it. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Protocol

from rosld.adapters.model import Descriptor, Operation, ParameterType, Range
from rosld.adapters.ros2.values import Tag

_LONGEST = 4096
"""The characters that are kept of a text."""

_READ = frozenset({Operation.GET_PARAMETER})
_WRITE = _READ | {Operation.SET_PARAMETER}
_TYPES: Mapping[int, ParameterType] = {
    Tag.BOOL: ParameterType.BOOLEAN,
    Tag.INTEGER: ParameterType.INTEGER,
    Tag.DOUBLE: ParameterType.DOUBLE,
    Tag.STRING: ParameterType.STRING,
    Tag.BYTE_ARRAY: ParameterType.BYTE_ARRAY,
    Tag.BOOL_ARRAY: ParameterType.BOOLEAN_ARRAY,
    Tag.INTEGER_ARRAY: ParameterType.INTEGER_ARRAY,
    Tag.DOUBLE_ARRAY: ParameterType.DOUBLE_ARRAY,
    Tag.STRING_ARRAY: ParameterType.STRING_ARRAY,
}


def operations_on(descriptor: Descriptor | None) -> frozenset[Operation]:
    """What may be done with a parameter: a node keeps what it declared with a type, and what it declared read-only."""
    if descriptor is not None and descriptor.read_only:
        return _READ
    return _WRITE if descriptor is not None and descriptor.type is not None else _WRITE | {Operation.DELETE_PARAMETER}


class RangeMessage(Protocol):
    """rcl_interfaces/msg/IntegerRange or FloatingPointRange."""

    from_value: float
    to_value: float
    step: float


class DescriptorMessage(Protocol):
    """rcl_interfaces/msg/ParameterDescriptor."""

    type: int
    description: str
    additional_constraints: str
    read_only: bool
    dynamic_typing: bool
    integer_range: Sequence[RangeMessage]
    floating_point_range: Sequence[RangeMessage]


def descriptor_of(message: DescriptorMessage) -> Descriptor | None:
    """What a message declares; None where that is nothing, as of a parameter that a node never declared."""
    dynamic = bool(message.dynamic_typing)
    type = None if dynamic else _TYPES.get(message.type)
    found = Descriptor(
        type,
        _text(message.description),
        bool(message.read_only),
        dynamic,
        _text(message.additional_constraints),
        _range(type, message),
    )
    return None if found == Descriptor() else found


def _text(text: str) -> str:
    short = text if len(text) <= _LONGEST else text[: _LONGEST - 1] + "…"
    return short.encode("utf-8", "replace").decode()


def _range(type: ParameterType | None, message: DescriptorMessage) -> Range | None:
    """The range that is about values of the type; the ends may come in either order, the step with either sign."""
    if type is ParameterType.INTEGER:
        ranges = message.integer_range
    elif type is ParameterType.DOUBLE:
        ranges = message.floating_point_range
    else:
        return None
    if not len(ranges):
        return None
    ends, step = (ranges[0].from_value, ranges[0].to_value), abs(ranges[0].step)
    if any(map(math.isnan, ends)):
        return None
    return Range(min(ends), max(ends), step if step > 0 and math.isfinite(step) else None)
