"""Foxglove's WebSocket protocol (`foxglove.sdk.v1`, formerly `foxglove.websocket.v1`), for both sides of a connection.

JSON messages have an `op`; binary ones begin with an opcode and are little endian. No I/O.
"""

from __future__ import annotations

import base64
import binascii
import struct
from collections.abc import Mapping
from typing import Any, NamedTuple, TypeAlias

import orjson

from rosld.adapters.model.parameter import ParameterValue
from rosld.adapters.model.schema import Encoding

SUBPROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
MESSAGE_DATA, TIME, SERVICE_RESPONSE = 1, 2, 3
"""Opcodes of servers."""
CLIENT_MESSAGE_DATA, SERVICE_REQUEST = 1, 2
"""Opcodes of clients."""
INFO, WARNING, ERROR = 0, 1, 2
"""Levels of a status."""
SCHEMA_ENCODINGS: Mapping[Encoding, str] = {Encoding.ROS1: "ros1msg", Encoding.CDR: "ros2msg"}

Json: TypeAlias = "dict[str, Any]"
_DATA = struct.Struct("<BIQ")
_CLIENT_DATA = struct.Struct("<BI")
_TIME = struct.Struct("<BQ")
_CALL = struct.Struct("<BIII")


class ServiceMessage(NamedTuple):
    """A request to a service or its response."""

    service_id: int
    call_id: int
    encoding: str
    payload: bytes


def op(name: str, /, **fields: object) -> str:
    """Return a JSON message."""
    return orjson.dumps({"op": name, **fields}).decode()


def read_op(text: str | bytes) -> Json:
    """Return a JSON message. Raises ValueError if it is not an object with an `op`."""
    message = orjson.loads(text)
    if not isinstance(message, dict) or not isinstance(message.get("op"), str):
        raise ValueError("a message must be a JSON object with an `op`")
    return message


def message_data(subscription: int, time_ns: int, data: bytes) -> bytes:
    """Return a message of a channel for a client."""
    return _DATA.pack(MESSAGE_DATA, subscription, time_ns) + data


def read_message_data(data: bytes) -> tuple[int, int, bytes]:
    """Return subscription, time in ns, and message. Raises struct.error."""
    _, subscription, time_ns = _DATA.unpack_from(data)
    return subscription, time_ns, data[_DATA.size :]


def client_message_data(channel: int, data: bytes) -> bytes:
    """Return a message that a client publishes."""
    return _CLIENT_DATA.pack(CLIENT_MESSAGE_DATA, channel) + data


def read_client_message_data(data: bytes) -> tuple[int, bytes]:
    """Return channel and message. Raises struct.error."""
    return _CLIENT_DATA.unpack_from(data)[1], data[_CLIENT_DATA.size :]


def time_message(time_ns: int) -> bytes:
    """Return the time of a server."""
    return _TIME.pack(TIME, time_ns)


def service_message(opcode: int, message: ServiceMessage) -> bytes:
    """Return the request of a client, or the response of a server."""
    encoding = message.encoding.encode()
    return _CALL.pack(opcode, message.service_id, message.call_id, len(encoding)) + encoding + message.payload


def read_service_message(data: bytes) -> ServiceMessage:
    """Return a request or a response. Raises struct.error, or ValueError for an encoding that is not UTF-8."""
    _, service_id, call_id, length = _CALL.unpack_from(data)
    start = _CALL.size + length
    return ServiceMessage(service_id, call_id, data[_CALL.size : start].decode(), data[start:])


def parameter_entry(name: str, value: ParameterValue | None) -> Json:
    """Return the JSON of a parameter; None for a parameter to delete."""
    entry: Json = {"name": name}
    if value is None:
        return entry
    if isinstance(value, bytes):
        return entry | {"type": "byte_array", "value": base64.b64encode(value).decode()}
    if isinstance(value, float):
        entry["type"] = "float64"
    elif isinstance(value, list) and value and all(isinstance(each, float) for each in value):
        entry["type"] = "float64_array"
    return entry | {"value": value}


def read_parameter(entry: Json) -> tuple[str, ParameterValue | None]:
    """Return name and value of a parameter, None without a value. Raises KeyError, TypeError, ValueError."""
    name, value, kind = entry["name"], entry.get("value"), entry.get("type")
    if not isinstance(name, str):
        raise TypeError("the name of a parameter must be a string")
    if value is None:
        return name, None
    if kind == "byte_array":
        try:
            return name, base64.b64decode(value, validate=True)
        except binascii.Error as error:
            raise ValueError(f"the value of {name} is not base64") from error
    if kind == "float64":
        return name, float(value)
    return name, [float(each) for each in value] if kind == "float64_array" else value
