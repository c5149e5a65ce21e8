"""ROS 2 parameter values and descriptors as Python's own types: 1 is an integer, 1.0 a double."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import Any

from rosld.adapters.model import Descriptor, Operation, ParameterType, Range, Refused
from rosld.adapters.model.parameter import ParameterValue, shortened

_INT64 = range(-(2**63), 2**63)


class Tag(IntEnum):
    """rcl_interfaces/msg/ParameterType."""

    NOT_SET = 0
    BOOL = 1
    INTEGER = 2
    DOUBLE = 3
    STRING = 4
    BYTE_ARRAY = 5
    BOOL_ARRAY = 6
    INTEGER_ARRAY = 7
    DOUBLE_ARRAY = 8
    STRING_ARRAY = 9


_FIELDS: Mapping[Tag, str] = {tag: f"{tag.name.lower()}_value" for tag in Tag if tag is not Tag.NOT_SET}
_ARRAYS: Mapping[type, Tag] = {
    bool: Tag.BOOL_ARRAY,
    int: Tag.INTEGER_ARRAY,
    float: Tag.DOUBLE_ARRAY,
    str: Tag.STRING_ARRAY,
}
_SCALARS: Mapping[type, Tag] = {
    bool: Tag.BOOL,
    int: Tag.INTEGER,
    float: Tag.DOUBLE,
    str: Tag.STRING,
    bytes: Tag.BYTE_ARRAY,
}


def from_message(message: Any) -> ParameterValue | None:
    """Return the value of a rcl_interfaces/ParameterValue, or None if the parameter is declared but not set."""
    try:
        tag = Tag(message.type)
    except ValueError:
        return None
    if tag is Tag.NOT_SET:
        return None
    value = getattr(message, _FIELDS[tag])
    if tag is Tag.BYTE_ARRAY:
        return b"".join(each if isinstance(each, bytes) else bytes([int(each) & 0xFF]) for each in value)
    if tag in _ARRAYS.values():
        kind = next(kind for kind, each in _ARRAYS.items() if each is tag)
        return [kind(each) for each in value]
    return value  # type: ignore[no-any-return]


def to_fields(name: str, value: object, current: int | None = None) -> dict[str, object]:
    """Return the fields of a value's message; `current` is the parameter's tag, used for an empty list.

    Raises Refused, naming the parameter, for a value that ROS 2's parameters cannot have.
    """
    tag = _tag(name, value, current)
    if tag is Tag.BYTE_ARRAY and isinstance(value, bytes):
        return {"type": int(tag), _FIELDS[tag]: [bytes([each]) for each in value]}
    return {"type": int(tag), _FIELDS[tag]: value}


def _tag(name: str, value: object, current: int | None) -> Tag:
    if isinstance(value, list):
        return _array_tag(name, value, current)
    _check(name, value)
    return _SCALARS[type(value)]


def _array_tag(name: str, value: Sequence[object], current: int | None) -> Tag:
    if not value:
        arrays = {*_ARRAYS.values(), Tag.BYTE_ARRAY}
        return Tag(current) if current in arrays else Tag.STRING_ARRAY
    kinds = {type(each) for each in value}
    if len(kinds) > 1 or not kinds <= _ARRAYS.keys():
        words = " and ".join(sorted(kind.__name__ for kind in kinds))
        raise Refused(
            f"the parameter {name} cannot be set: an array of ROS 2 holds only bool, only int, only float or only "
            f"str, this one holds {words}"
        )
    for each in value:
        _check(name, each)
    return _ARRAYS[kinds.pop()]


def _check(name: str, value: object) -> None:
    if type(value) not in _SCALARS:
        raise Refused(f"the parameter {name} cannot be set: ROS 2 has no parameters of type {type(value).__name__}")
    if isinstance(value, int) and value not in _INT64:
        raise Refused(f"the parameter {name} cannot be {value}: ROS 2's integers have 64 bits")
    if isinstance(value, str):
        try:
            value.encode("utf-8")
        except UnicodeEncodeError as error:
            raise Refused(f"the parameter {name} cannot be set: its text is not valid Unicode") from error
        if "\0" in value:
            raise Refused(f"the parameter {name} cannot be set: its text contains a NUL, where ROS 2 would truncate it")


_READ = frozenset({Operation.GET_PARAMETER})
_WRITE = _READ | {Operation.SET_PARAMETER}
_TYPES: Mapping[int, ParameterType] = dict(zip(list(Tag)[1:], ParameterType, strict=True))  # both in ROS 2's order


def operations_on(descriptor: Descriptor | None) -> frozenset[Operation]:
    """Return the operations on a parameter: typed and read-only ones cannot be deleted."""
    if descriptor is not None and descriptor.read_only:
        return _READ
    return _WRITE if descriptor is not None and descriptor.type is not None else _WRITE | {Operation.DELETE_PARAMETER}


def descriptor_of(message: Any) -> Descriptor | None:
    """Return the declaration in a rcl_interfaces/ParameterDescriptor, or None for an undeclared parameter."""
    dynamic = bool(message.dynamic_typing)
    type = None if dynamic else _TYPES.get(message.type)
    descriptor = Descriptor(
        type,
        shortened(message.description),
        bool(message.read_only),
        dynamic,
        shortened(message.additional_constraints),
        _range(type, message),
    )
    return None if descriptor == Descriptor() else descriptor


def _range(type: ParameterType | None, message: Any) -> Range | None:
    """Return the range for values of the type; the ends may be in any order, the step may have any sign."""
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
