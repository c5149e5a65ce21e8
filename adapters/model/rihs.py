"""RIHS01, the hash of types in ROS 2 (REP 2011, "Type Version Hash"). No I/O.

It is the SHA-256 of a JSON description of the type and of all it nests: names and types of fields, but neither
constants nor defaults. Services and actions are described with the types that ROS derives from them.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping

from rosld.adapters.model.schema import (
    BOUNDED_STRINGS,
    DUMMY,
    PRIMITIVES,
    Array,
    Field,
    FieldType,
    MessageType,
    Nested,
    Primitive,
)

_NESTED = 1
_ARRAY, _BOUNDED_SEQUENCE, _SEQUENCE = 48, 96, 144
_DUMMY = Field(DUMMY, Primitive("uint8"), DUMMY)

_TIME = "builtin_interfaces/msg/Time"
_INFO = "service_msgs/msg/ServiceEventInfo"
_UUID = "unique_identifier_msgs/msg/UUID"


def _layout(name: str, **fields: FieldType) -> MessageType:
    return MessageType(name, tuple(Field(field, kind, field) for field, kind in fields.items()))


_DERIVED = {
    each.name: each
    for each in (
        _layout(_TIME, sec=Primitive("int32"), nanosec=Primitive("uint32")),
        _layout(_UUID, uuid=Array(Primitive("uint8"), length=16)),
        _layout(
            _INFO,
            event_type=Primitive("uint8"),
            stamp=Nested(_TIME),
            client_gid=Array(Primitive("char"), length=16),
            sequence_number=Primitive("int64"),
        ),
    )
}


def message_hash(name: str, types: Mapping[str, MessageType]) -> str:
    """Return the hash of a message type; `types` is closed.

    Raises KeyError naming a missing type, RecursionError naming a type that contains itself.
    """
    nested: dict[str, MessageType] = {}
    _collect_nested(name, types, nested)
    described = {
        "type_description": describe_type(types[name]),
        "referenced_type_descriptions": [describe_type(nested[each]) for each in sorted(nested) if each != name],
    }
    return f"RIHS01_{hashlib.sha256(json.dumps(described).encode()).hexdigest()}"


def service_hash(name: str, types: Mapping[str, MessageType]) -> str:
    """Return the hash of a service type; `types` contains its two messages and all that they nest."""
    return message_hash(name, {**_DERIVED, **types, **_service(name)})


def action_hash(name: str, types: Mapping[str, MessageType]) -> str:
    """Return the hash of an action type; `types` contains its three messages and all that they nest."""
    goal, result, feedback = (Nested(f"{name}_{part}") for part in ("Goal", "Result", "Feedback"))
    send, get, message = f"{name}_SendGoal", f"{name}_GetResult", f"{name}_FeedbackMessage"
    layouts = (
        _layout(f"{send}_Request", goal_id=Nested(_UUID), goal=goal),
        _layout(f"{send}_Response", accepted=Primitive("bool"), stamp=Nested(_TIME)),
        _layout(f"{get}_Request", goal_id=Nested(_UUID)),
        _layout(f"{get}_Response", status=Primitive("int8"), result=result),
        _layout(message, goal_id=Nested(_UUID), feedback=feedback),
        _layout(
            name,
            goal=goal,
            result=result,
            feedback=feedback,
            send_goal_service=Nested(send),
            get_result_service=Nested(get),
            feedback_message=Nested(message),
        ),
    )
    return message_hash(
        name, {**_DERIVED, **types, **_service(send), **_service(get), **{each.name: each for each in layouts}}
    )


def _service(name: str) -> Mapping[str, MessageType]:
    """Return a service as a type of its messages, and the type of its events."""
    request, response, event = (Nested(f"{name}_{part}") for part in ("Request", "Response", "Event"))
    whole = _layout(name, request_message=request, response_message=response, event_message=event)
    events = _layout(event.name, info=Nested(_INFO), request=Array(request, bound=1), response=Array(response, bound=1))
    return {name: whole, events.name: events}


def _collect_nested(
    name: str, types: Mapping[str, MessageType], nested: dict[str, MessageType], above: tuple[str, ...] = ()
) -> None:
    """Add the types that a type nests to `nested`."""
    if name in above:
        raise RecursionError(f"{name} is nested in itself")
    for field in types[name].fields:
        kind = field.type.element if isinstance(field.type, Array) else field.type
        if isinstance(kind, Nested) and (kind.name not in nested or kind.name in (*above, name)):
            nested[kind.name] = types[kind.name]
            _collect_nested(kind.name, types, nested, (*above, name))


def describe_type(kind: MessageType) -> dict[str, object]:
    return {"type_name": kind.name, "fields": [_field(field) for field in kind.fields or (_DUMMY,)]}


def _field(field: Field) -> dict[str, object]:
    kind, step, capacity = field.type, 0, 0
    if isinstance(kind, Array):
        step = _ARRAY if kind.length is not None else _SEQUENCE if kind.bound is None else _BOUNDED_SEQUENCE
        capacity = kind.length or kind.bound or 0
        kind = kind.element
    bound = kind.bound or 0 if isinstance(kind, Primitive) else 0
    return {
        "name": field.name,
        "type": {
            "type_id": step + _id(kind),
            "capacity": capacity,
            "string_capacity": bound,
            "nested_type_name": kind.name if isinstance(kind, Nested) else "",
        },
    }


def _id(kind: Primitive | Nested) -> int:
    if isinstance(kind, Nested):
        return _NESTED
    return (BOUNDED_STRINGS if kind.bound and kind.name in BOUNDED_STRINGS else PRIMITIVES)[kind.name]
