"""Latest values of topics that are subscribed to, in brief, for listings; no subscription is made for them."""

from __future__ import annotations

from typing import NamedTuple

from rosld.adapters.model import MessageSchema, Sample
from rosld.server.hypermedia.brief_value import brief_json
from rosld.server.hypermedia.source_reader import decode_value
from rosld.server.hypermedia.value import MessageValue, Value
from rosld.server.pictures.form import can_draw
from rosld.server.robot.live_topics import LiveTopics
from rosld.server.robot.schemas import Schemas
from rosld.server.robot.topic_view import TopicView


class LatestPicture(NamedTuple):
    """A message that can be drawn: the type of messages, and the number of this one."""

    type_name: str
    sequence: int


class LatestValue(NamedTuple):
    """A value as brief plain JSON (None: there is none that can be read), and the rate of a topic once it is known.

    `picture` is what there is to be seen of it; None of what is no picture, or none that is drawn.
    """

    json: str | None
    rate: float | None = None
    picture: LatestPicture | None = None


class LatestValues:
    """The values of the topics of one robot that are subscribed to, written once a message."""

    def __init__(self, topics: LiveTopics, schemas: Schemas) -> None:
        self._topics = topics
        self._schemas = schemas
        self._written: dict[str, tuple[TopicView, LatestValue]] = {}

    def of_topic(self, name: str) -> LatestValue | None:
        """The latest value of a topic that is subscribed to; None of all others."""
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
    """What there is to be seen of the newest message of a topic."""
    if newest is None or not isinstance(value, MessageValue) or not can_draw(value.schema.ref.name):
        return None
    from rosld.server.pictures.picture import is_drawable  # Pillow, as in `PictureCache`

    is_seen = is_drawable(value.schema, value.message)
    return LatestPicture(value.schema.ref.name, newest.sequence) if is_seen else None
