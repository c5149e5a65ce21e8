"""Latest values: what is at hand of topics, in brief, for lists of them. Nothing is subscribed to for it."""

from __future__ import annotations

from typing import NamedTuple

from rosld.adapters.model import MessageSchema
from rosld.server.hypermedia.brief_value import brief_json
from rosld.server.hypermedia.source_reader import decode_value
from rosld.server.robot.live_topics import LiveTopics
from rosld.server.robot.schemas import Schemas
from rosld.server.robot.topic_view import TopicView


class LatestValue(NamedTuple):
    """A value as brief plain JSON (None: there is none that can be read), and the rate of a topic once it is known."""

    json: str | None
    rate: float | None = None


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
        found = LatestValue(self._write(name, view), view.rate or None)
        self._written[name] = (view, found)
        return found

    def _write(self, name: str, view: TopicView) -> str | None:
        newest = view.newest
        schema = None if newest is None else self._schemas.find_cached(newest.schema)
        if newest is None or not isinstance(schema, MessageSchema):
            return None
        value = decode_value(name, newest, schema, "").value
        return None if value is None else brief_json(value)
