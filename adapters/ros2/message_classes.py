"""rclpy's message classes by the names of types, and conversion between messages and bytes."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from functools import cache
from typing import Any, cast

from rosld.adapters.model import UnknownType


def class_problem(type: str) -> str | None:
    """Return why messages of a type cannot be read or sent here, or None."""
    try:
        message_class(type)
    except UnknownType as error:
        return error.sentence
    return None


def request_of(type: str, data: bytes) -> object:
    """Return the request of a service type from its bytes. Raises UnknownType, ValueError."""
    return _deserialize(message_class(type).Request, data)


def deserialize(type: str, data: bytes) -> object:
    """Return a message from its bytes. Raises UnknownType, ValueError."""
    return _deserialize(message_class(type), data)


def serialize(message: object, type: str, half: str | None = None) -> bytes:
    """Return the bytes of a message of a type, or of a half ("Request" or "Response") of a service."""
    return bytes(importlib.import_module("rclpy.serialization").serialize_message(message))


def make_message(type: str, values: Mapping[str, object], half: str | None = None) -> object:
    """Return an object of a type's class, or of its part `half` ("Request"), with these values. Raises UnknownType."""
    kind = message_class(type)
    return (getattr(kind, half) if half else kind)(**values)


def _deserialize(kind: Any, data: bytes) -> object:
    try:
        return cast(object, importlib.import_module("rclpy.serialization").deserialize_message(data, kind))
    except Exception as error:
        raise ValueError(f"cannot decode {len(data)} bytes as {kind.__name__}: {error}") from error


@cache
def message_class(type: str) -> Any:
    """Return the Python class of a type, with its type support. Raises UnknownType with the missing part."""
    package, _, rest = type.partition("/")
    kind, _, name = rest.partition("/")
    if not (package.isidentifier() and kind in ("msg", "srv", "action") and name.isidentifier()):
        raise UnknownType(f"{type!r} is not a type name")
    try:
        found = _within(importlib.import_module(f"{package}.{kind}"), kind, name)
        importlib.import_module("rclpy.type_support").check_for_type_support(found)
        return found
    except ModuleNotFoundError as error:
        raise UnknownType(
            f"unknown type {type}: its package {package} is not installed; source the workspace that contains it "
            "before starting rosld"
        ) from error
    except AttributeError as error:
        raise UnknownType(f"unknown type {type}: the installed package {package} does not contain it") from error
    except Exception as error:
        raise UnknownType(f"the type {type} cannot be used: {error}") from error


_DERIVED = {
    "_SendGoal_Event": ("Impl", "SendGoalService", "Event"),
    "_GetResult_Event": ("Impl", "GetResultService", "Event"),
    "_SendGoal": ("Impl", "SendGoalService"),
    "_GetResult": ("Impl", "GetResultService"),
    "_FeedbackMessage": ("Impl", "FeedbackMessage"),
    "_Goal": ("Goal",),
    "_Result": ("Result",),
    "_Feedback": ("Feedback",),
}


def _within(module: Any, kind: str, name: str) -> Any:
    """Return a class in a module of types; a derived type's class is nested in that of its service or action."""
    derived = _DERIVED if kind == "action" else {"_Event": ("Event",)} if kind == "srv" else {}
    for end, steps in derived.items():
        if name.endswith(end):
            found = getattr(module, name.removesuffix(end))
            for step in steps:
                found = getattr(found, step)
            return found
    return getattr(module, name)
