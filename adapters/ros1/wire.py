"""Messages of actionlib and dynamic_reconfigure, which are the same everywhere: nobody's definitions are needed."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

from rosld.adapters.model import Encoding, MessageSchema, TypeRef, UnknownType
from rosld.adapters.model.codec import Reader
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.model.plain import message_of

_MAX_BYTES = 4 * 1024 * 1024
"""Size of a list of goals or of parameters that is refused, as each of its elements takes memory."""


@cache
def _schema(name: str) -> MessageSchema:
    schema = TypeLibrary(ros_version=1).find(TypeRef(name))
    if not isinstance(schema, MessageSchema):
        raise UnknownType(f"{name} is not a message type")
    return schema


def encode(name: str, values: Mapping[str, Any]) -> bytes:
    """Return the bytes of a message with these values; others are zero."""
    schema = _schema(name)
    return schema.codec.encode(message_of(schema, values), Encoding.ROS1)


def decode(name: str, data: bytes) -> Any:
    """Return a message. Raises ValueError."""
    if len(data) > _MAX_BYTES:
        raise ValueError(f"a {name} of {len(data)} bytes exceeds the limit of {_MAX_BYTES}")
    return _schema(name).codec.decode(data, Encoding.ROS1)


def read_after_header(name: str, data: bytes) -> tuple[Any, bytes]:
    """Return the message that follows a header, and the remaining bytes. Raises ValueError."""
    schema = _schema("actionlib_msgs/msg/GoalStatusArray")
    reader = Reader(data, Encoding.ROS1, schema.types, schema.codec.build)
    reader.message("std_msgs/msg/Header")
    return reader.message(name), reader.rest()
