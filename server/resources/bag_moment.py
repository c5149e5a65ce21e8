"""`/bags/B/at?time=`: all topics of a recording as they were at one moment."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from urllib.parse import quote

import orjson

from rosld.adapters.base import MessageFilter, MessagePage, RecordedMessage, Recording
from rosld.adapters.model import RosError
from rosld.ontology.describe_bags import bag_moment_document
from rosld.ontology.document import Document
from rosld.ontology.literals import date_time
from rosld.server.html.page import SequenceLink
from rosld.server.hypermedia.message_schemas import MessageSchemas
from rosld.server.resources.bag_selection import BagSelection, Detail, detail_of, topics_of
from rosld.server.resources.recorded_messages import DecodedRecord
from rosld.server.resources.series import read_time
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.path_item import FORMAT, PathItem, QueryParameter
from rosld.server.rest.resource import Resource
from rosld.server.rest.ros_problems import problem_of
from rosld.server.robot.session import Session

_TIME = QueryParameter("time", "When: an xsd:dateTime, or seconds before now as `-60`. Default: as it ended.")
_TOPIC = QueryParameter("topic", "This topic alone, or those that a glob fits.")


class BagMoment(BagSelection):
    """The newest message of each topic at a time."""

    kind = "Moment of a recording"

    def __init__(
        self, session: Session, recording: Recording, at_ns: int, topics: Sequence[str], query: str, detail: Detail
    ) -> None:
        self._at_ns = at_ns
        self._topics = topics
        self._own = session.space.bag_moment(recording.name) + (f"?{query}" if query else "")
        super().__init__(session, recording, MessageFilter(), 0, query, detail)
        self.title = f"{recording.name} at {date_time(0, at_ns)}"

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        return PathItem(f"{self.recording.name} at one moment", query=(FORMAT, _TIME, _TOPIC))

    @property
    def conforms_to(self) -> Sequence[str]:
        return (self.session.space.document_shape("Moment"), self.session.space.document_shape("Record"))

    async def select_variant(self, exchange: Exchange) -> Resource:
        """At the time that the query names, of the topics that it names. Raises Problems."""
        query = exchange.query
        given = {name: query[name] for name in ("time", "topic") if name in query}
        at_ns = read_time(given["time"], time.time_ns()) if "time" in given else self.recording.end_ns
        names = topics_of(self.recording, given["topic"]) if "topic" in given else self.recording.topics.keys()
        text = "&".join(f"{name}={quote(value, safe='/:.-*')}" for name, value in given.items())
        return BagMoment(self.session, self.recording, at_ns, sorted(names), text, detail_of(exchange))

    def navigation_links(self) -> tuple[SequenceLink, ...]:
        return ()

    def _page_url(self, start: int) -> str:
        return self._own

    async def _read(self) -> MessagePage:
        if self._page is None:
            try:
                self._page = MessagePage(await asyncio.to_thread(self._latest), None)
            except RosError as error:
                raise problem_of(error) from error
        return self._page

    def _latest(self) -> list[RecordedMessage]:
        found = (self.recording.latest_at(topic, self._at_ns) for topic in self._topics)
        return [each for each in found if each is not None]

    def _describe(self, messages: Sequence[RecordedMessage]) -> Document:
        return bag_moment_document(self.recording, self.session.space, self.url, self._at_ns, messages)

    def _json(self, records: Sequence[DecodedRecord]) -> bytes:
        messages = [self._json_of(one) for one in records]
        return orjson.dumps({"time": date_time(0, self._at_ns), "messages": messages})


def bag_moment(session: Session, recording: Recording) -> BagMoment:
    """The moment at which a recording ended, which requests ask others of."""
    return BagMoment(session, recording, recording.end_ns, sorted(recording.topics), "", Detail.RDF)
