"""Brief values: values shortened to a line for long lists, and the latest values of topics and properties.

Omissions are visible: `"...": "more"` in an object, `"..."` at the end of an array or a string. The header of a message
is always omitted.
"""

from __future__ import annotations

from typing import NamedTuple, cast

from rosld.adapters.model import (
    OCTETS,
    STRINGS,
    Array,
    Field,
    FieldType,
    Message,
    MessageSchema,
    Nested,
    ParameterValue,
    Primitive,
    Sample,
)
from rosld.ontology.literals import json_string
from rosld.ontology.parameters import parameter_json
from rosld.server.hypermedia.source_reader import decode_value
from rosld.server.hypermedia.value import MessageValue, StoredValue, Value, scalar_json
from rosld.server.pictures.picture_cache import can_draw
from rosld.server.robot.live_topics import LiveTopics
from rosld.server.robot.schemas import Schemas
from rosld.server.robot.topic_view import TopicView

MAX_CHARACTERS = 200
"""Maximum number of characters of a brief value."""
MORE = "..."
_MARK = f'"{MORE}":"more"'
_MAX_STRING = 60
_MAX_ELEMENTS = 8
"""Maximum number of elements of an array of scalars that is shown; longer ones are covariances, scans and images."""
_HEADERS = frozenset({"std_msgs/msg/Header", "roslib/msg/Header"})


def brief_json(value: Value, limit: int = MAX_CHARACTERS) -> str:
    """Return the value as plain JSON of about `limit` characters. Raises ValueError for a value nested too deeply."""
    if isinstance(value, StoredValue):
        return _parameter_text(value.value, limit)
    return _members(value.schema, value.fields, value.message, limit) or f"{{{_MARK}}}"


def _members(schema: MessageSchema, fields: tuple[Field, ...], message: Message, room: int) -> str | None:
    """Return the object of the leading fields that fit; None if none does."""
    shown = [field for field in fields if not (isinstance(field.type, Nested) and field.type.name in _HEADERS)] or list(
        fields
    )
    parts: list[str] = []
    left = room - len(_MARK) - 2
    for field in shown:
        text = _of(schema, field.type, getattr(message, field.attribute), left - len(field.name) - 4)
        if text is not None:
            parts.append(f'"{field.name}":{text}')
            left -= len(parts[-1]) + 1
    return _fitting(_object(parts, is_whole=len(parts) == len(shown)), room) if parts or not shown else None


def _object(parts: list[str], *, is_whole: bool) -> str:
    return "{" + ",".join(parts if is_whole else [*parts, _MARK]) + "}"


def _of(schema: MessageSchema, kind: FieldType, value: object, room: int) -> str | None:
    """Return a field's value; None if it does not fit."""
    if isinstance(kind, Nested):
        return _members(schema, schema.types[kind.name].fields, cast(Message, value), room)
    if isinstance(kind, Primitive):
        return _fitting(_scalar(kind, value), room)
    if isinstance(kind.element, Nested):
        return _messages(schema, kind.element, cast("list[Message]", value), room)
    return _scalars(kind, cast("list[object]", value), room)


def _messages(schema: MessageSchema, kind: Nested, values: list[Message], room: int) -> str | None:
    """Return as many elements as fit; None if not even the first does."""
    parts: list[str] = []
    left = room - 8
    for value in values:
        text = _members(schema, schema.types[kind.name].fields, value, left)
        if text is None:
            break
        parts.append(text)
        left -= len(text) + 1
    if values and not parts:
        return None
    return _fitting("[" + ",".join(parts if len(parts) == len(values) else [*parts, f'"{MORE}"']) + "]", room)


def _scalars(kind: Array, values: list[object], room: int) -> str | None:
    """Return all elements, or None for octets and for arrays that are too long."""
    element = cast(Primitive, kind.element)
    if element.name in OCTETS or len(values) > _MAX_ELEMENTS:
        return None
    return _fitting(f"[{','.join(_scalar(element, each) for each in values)}]", room)


def _scalar(kind: Primitive, value: object) -> str:
    return _string(cast(str, value)) if kind.name in STRINGS else scalar_json(kind, value).decode()


def _string(value: str) -> str:
    return json_string(value if len(value) <= _MAX_STRING else value[:_MAX_STRING] + MORE)


def _fitting(text: str, room: int) -> str | None:
    return text if len(text) <= room else None


def _parameter_text(value: ParameterValue, room: int) -> str:
    """Return the value of a parameter if it fits; a long string is shortened."""
    text = _string(value) if isinstance(value, str) else parameter_json(value).decode()
    return text if len(text) <= room else f'"{MORE}"'


class LatestPicture(NamedTuple):
    """The latest message of a type that can be drawn, and its number."""

    type_name: str
    sequence: int


class LatestValue(NamedTuple):
    """A value as brief plain JSON (None if it cannot be read), and the rate of a topic once that is known.

    `picture` is the message that can be drawn, or None.
    """

    json: str | None
    rate: float | None = None
    picture: LatestPicture | None = None


class LatestValues:
    """The latest values of a robot's subscribed topics, computed once per message."""

    def __init__(self, topics: LiveTopics, schemas: Schemas) -> None:
        self._topics = topics
        self._schemas = schemas
        self._written: dict[str, tuple[TopicView, LatestValue]] = {}

    def of_topic(self, name: str) -> LatestValue | None:
        """Return the latest value of a subscribed topic; None for all others."""
        view = self._topics.peek(name)
        if view is None:
            self._written.pop(name, None)
            return None
        known = self._written.get(name)
        if known is not None and known[0] is view:
            return known[1]
        value = self._decode(name, view)
        found = LatestValue(
            None if value is None else brief_json(value), view.rate or None, _picture_of(value, view.newest)
        )
        self._written[name] = (view, found)
        return found

    def _decode(self, name: str, view: TopicView) -> Value | None:
        newest = view.newest
        schema = None if newest is None else self._schemas.find_cached(newest.schema)
        if newest is None or not isinstance(schema, MessageSchema):
            return None
        return decode_value(name, newest, schema, "").value


def _picture_of(value: Value | None, newest: Sample | None) -> LatestPicture | None:
    if newest is None or not isinstance(value, MessageValue) or not can_draw(value.schema.ref.name):
        return None
    from rosld.server.pictures.picture import is_drawable  # Pillow, as in `PictureCache`

    is_seen = is_drawable(value.schema, value.message)
    return LatestPicture(value.schema.ref.name, newest.sequence) if is_seen else None
