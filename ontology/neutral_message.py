"""Messages that let a robot stand still, and headers with a given time. Pure."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from rosld.adapters.model import Array, FieldType, Message, MessageSchema, Nested, Primitive

HEADER = "std_msgs/msg/Header"
TWISTS = frozenset(
    f"geometry_msgs/msg/{name}"
    for name in ("Twist", "TwistStamped", "TwistWithCovariance", "TwistWithCovarianceStamped")
) | {"ackermann_msgs/msg/AckermannDrive", "ackermann_msgs/msg/AckermannDriveStamped"}
"""Types of velocities: their zero is standstill."""
COMMANDS = TWISTS - {f"geometry_msgs/msg/TwistWithCovariance{stamped}" for stamped in ("", "Stamped")}
"""Types of velocities that command: a covariance belongs to measurements."""
_TEXTS = frozenset({"string", "wstring"})


def with_zeros(schema: MessageSchema, message: Message) -> Message:
    """Return the message with every number 0 and every boolean false; headers and strings are unchanged."""
    return _zeroed(schema, schema.ref.name, message)


def _zeroed(schema: MessageSchema, name: str, message: Message) -> Message:
    fields = schema.types[name].fields
    values = {one.attribute: _zero(schema, one.type, getattr(message, one.attribute)) for one in fields}
    return schema.codec.build(name, values)


def _zero(schema: MessageSchema, kind: FieldType, value: object) -> object:
    match kind:
        case Nested(name=name):
            return value if name == HEADER else _zeroed(schema, name, _as_message(value))
        case Primitive(name="bool"):
            return False
        case Primitive(name=name):
            return value if name in _TEXTS else 0.0 if isinstance(value, float) else 0
        case Array(element=Primitive(name=name)) if name in _TEXTS:
            return value
        case Array() if isinstance(value, np.ndarray):
            return np.zeros_like(value)
        case Array(element=element):
            assert isinstance(value, list)
            return [_zero(schema, element, each) for each in value]
    raise AssertionError(f"no field is a {kind}")


def is_zero(schema: MessageSchema, message: Message) -> bool:
    """Whether a message is all zero: numbers 0, booleans false, texts empty; headers do not count."""
    return _is_zero(schema, Nested(schema.ref.name), message)


def _is_zero(schema: MessageSchema, kind: FieldType, value: object) -> bool:
    match kind:
        case Nested(name=name):
            fields = () if name == HEADER else schema.types[name].fields
            return all(_is_zero(schema, one.type, getattr(value, one.attribute)) for one in fields)
        case Array(element=element) if isinstance(value, list):
            return all(_is_zero(schema, element, each) for each in value)
        case Array() if isinstance(value, np.ndarray):
            return not np.any(value)
    return not value


def has_header(schema: MessageSchema) -> bool:
    """Whether the message begins with a header, as stamped messages do."""
    first = schema.type.fields[:1]
    return bool(first) and first[0].type == Nested(HEADER)


def is_unstamped(schema: MessageSchema, message: Message) -> bool:
    """Whether the message has a header with time 0, which means that it is not set."""
    return has_header(schema) and not any(_stamp(schema, message).values())


def with_stamp(schema: MessageSchema, message: Message, now_ns: int) -> Message:
    """Return the message with the header time `now_ns` (nanoseconds after the epoch); unchanged without a header."""
    if not has_header(schema):
        return message
    (field, *_), header = schema.type.fields, _header(schema, message)
    time = schema.types[_stamp_type(schema)]
    seconds, rest = divmod(now_ns, 1_000_000_000)
    parts = dict(zip((part.attribute for part in time.fields), (seconds, rest), strict=True))
    stamp = schema.codec.build(time.name, parts)
    header_fields = {one.attribute: getattr(header, one.attribute) for one in schema.types[HEADER].fields}
    new = schema.codec.build(HEADER, {**header_fields, "stamp": stamp})
    others = {one.attribute: getattr(message, one.attribute) for one in schema.type.fields}
    return schema.codec.build(schema.ref.name, {**others, field.attribute: new})


def _stamp_type(schema: MessageSchema) -> str:
    kind = next(one.type for one in schema.types[HEADER].fields if one.name == "stamp")
    assert isinstance(kind, Nested)
    return kind.name


def _stamp(schema: MessageSchema, message: Message) -> Mapping[str, object]:
    stamp = getattr(_header(schema, message), "stamp")  # noqa: B009
    return {one.attribute: getattr(stamp, one.attribute) for one in schema.types[_stamp_type(schema)].fields}


def _header(schema: MessageSchema, message: Message) -> object:
    return getattr(message, schema.type.fields[0].attribute)


def _as_message(value: object) -> Message:
    assert hasattr(value, "__msgtype__")
    return value
