"""Parameter values between ROS 2's tagged messages and Python's own types, exactly: 1 is an integer, 1.0 a double."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import Protocol

from rosld.adapters.model import Refused
from rosld.adapters.model.parameter import ParameterValue

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


class ValueMessage(Protocol):
    """rcl_interfaces/msg/ParameterValue."""

    type: int


def from_message(message: ValueMessage) -> ParameterValue | None:
    """The value; None where the parameter is declared but not set."""
    try:
        tag = Tag(message.type)
    except ValueError:
        return None
    if tag is Tag.NOT_SET:
        return None
    value = getattr(message, _FIELDS[tag])
    if tag is Tag.BYTE_ARRAY:
        return b"".join(each if isinstance(each, bytes) else bytes([each]) for each in value)
    if tag in _ARRAYS.values():
        kind = next(kind for kind, each in _ARRAYS.items() if each is tag)
        return [kind(each) for each in value]
    return value  # type: ignore[no-any-return]


def to_fields(name: str, value: object, current: int | None = None) -> dict[str, object]:
    """The fields of the message of a value; `current` is the tag that the parameter has now, for an empty list.

    Raises Refused, naming the parameter, for what ROS 2's parameters cannot hold.
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
            raise Refused(f"the parameter {name} cannot be set: its text is no Unicode") from error
        if "\0" in value:
            raise Refused(f"the parameter {name} cannot be set: its text holds a NUL, where ROS 2 would cut it")
