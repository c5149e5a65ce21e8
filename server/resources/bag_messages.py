"""The messages of a recording: pages, single messages, and the messages at a moment."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from functools import partial
from urllib.parse import quote

import orjson
from starlette.responses import Response

from rosld.adapters.base import MessageFilter, MessagePage, RecordedMessage, Recording
from rosld.adapters.model import NotFound, RosError
from rosld.ontology.describe_bags import bag_messages_document, bag_moment_document
from rosld.ontology.document import Document
from rosld.ontology.geometry import is_on_earth
from rosld.ontology.literals import date_time
from rosld.server.html.page import SequenceLink
from rosld.server.http.fields import Link
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import ANYTHING
from rosld.server.resources.bag_selection import (
    PARAMETERS,
    BagSelection,
    DecodedRecord,
    Detail,
    detail_of,
    learn_type,
    record_document,
    selection_of,
    topics_of,
)
from rosld.server.resources.bags import BagBase
from rosld.server.resources.base import Services
from rosld.server.resources.memento import read_time
from rosld.server.resources.messages import (
    cloud_is_preferred,
    cloud_response,
    decode,
    explicit_picture_type,
    field_response,
    geojson_is_preferred,
    geojson_response,
    lift_sample,
    picture_response,
    require_picture,
)
from rosld.server.resources.tables import TABLE_FORMAT, TABLE_READS
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.path_item import FIELD, FIELD_READS, FORMAT, PathItem, QueryParameter
from rosld.server.rest.resource import BASIC_CONTAINER, RDF_SOURCE, RESOURCE, Resource
from rosld.server.rest.ros_problems import problem_of
from rosld.server.rest.state import State

PAGE = 100
"""Number of messages on one page of `/bags/B/messages/`."""

_PAGE = QueryParameter("page", "The page of messages, counted from 0.", {"type": "integer", "minimum": 0})


class BagMessages(BagBase):
    """The messages of a recording: a container in pages (`?page=N` from 0; without it, links only)."""

    kind = "Messages"
    shape = "Container"
    is_cacheable = False
    links = (RESOURCE, RDF_SOURCE, BASIC_CONTAINER)
    number: int | None = None

    def __init__(self, services: Services, recording: Recording) -> None:
        super().__init__(services, services.space.bag_messages(recording.name))
        self.recording = recording
        about = f"The messages of {self.recording.name}"
        self.item = PathItem(about, TABLE_READS, query=(TABLE_FORMAT, _PAGE, *PARAMETERS))

    async def state(self) -> State:
        recording, space, page = self.recording, self.space, self.number
        version = recording.first, recording.count
        return self.states.get_or_make(
            self.url, version, lambda: State(lambda: bag_messages_document(recording, space, page, PAGE))
        )

    def navigation_links(self) -> tuple[SequenceLink, ...]:
        base = self.space.bag_messages(self.recording.name)
        first, last = _pages(self.recording)
        if self.number is None:
            places = {"first": first, "last": last}
        else:
            places = {"first": first, "prev": self.number - 1, "next": self.number + 1, "last": last}
        return tuple(SequenceLink(rel, f"{base}?page={at}") for rel, at in places.items() if first <= at <= last)

    async def select_variant(self, exchange: Exchange) -> Resource:
        """Return the page selected by `?page=` or a filter. Raises a 404 Problem if there is none."""
        wanted = exchange.query.get("page")
        if wanted is None:
            return selection_of(self.services, self.recording, exchange) or self
        first, last = _pages(self.recording)
        if not (wanted.isascii() and wanted.isdigit()) or int(wanted) > last:
            raise Problem(404, f"?page={wanted}: the pages of {self.recording.name} are {first} to {last}.")
        if int(wanted) < first:
            raise Problem(410, f"?page={wanted}: the oldest messages were removed, the pages are {first} to {last}.")
        return self.variant(url=f"{self.url}?page={int(wanted)}", number=int(wanted))


class BagMessage(BagBase):
    """One message of a recording."""

    kind = "Recorded message"
    shape = "Record"

    def __init__(self, services: Services, recording: Recording, index: int) -> None:
        super().__init__(services, services.space.bag_message(recording.name, index))
        self.recording = recording
        self.index = index
        self.title = f"{recording.name}, message {index}"
        self.links = (*Resource.links, *(Link(step.url, step.rel) for step in self.navigation_links()))
        self.item = PathItem(f"A message of {self.recording.name}", FIELD_READS, ANYTHING, (FORMAT, FIELD))

    def navigation_links(self) -> tuple[SequenceLink, ...]:
        """Return the messages before and after, first and last (RFC 8288)."""
        first, last = self.recording.first, self.recording.first + self.recording.count - 1
        places = {"first": first, "prev": self.index - 1, "next": self.index + 1, "last": last}
        links = ((rel, self.space.bag_message(self.recording.name, at)) for rel, at in places.items())
        there = {rel for rel, at in places.items() if first <= at <= last}
        return tuple(SequenceLink(rel, url) for rel, url in links if rel in there)

    async def message(self) -> RecordedMessage:
        """Return the message, read off the loop. Raises a 404 Problem if there is none."""
        try:
            message = await asyncio.to_thread(self.recording.message, self.index)
        except NotFound as error:
            raise Problem(410 if self.index < self.recording.first else 404, error.sentence) from error
        await learn_type(self.session.schemas, self.recording, message)
        return message

    async def state(self) -> State:
        known = self.states.find(self.url, 0)
        if known is not None:
            return known
        message = await self.message()
        recording = self.recording
        decoded = await decode(self.session.schemas, message.sample)

        def plain() -> bytes:
            if decoded.schema is None or decoded.message is None:
                raise Problem(406, f"The message cannot be read: {decoded.reason}.")
            return lift_sample(self.space, self.session.lifting, decoded).lifter.json(decoded.message, self.url)

        describe = partial(record_document, self.session, recording, DecodedRecord(message, decoded))
        shapes = () if decoded.schema is None else self.space.shapes_of(decoded.schema)
        return self.states.put(self.url, 0, State(describe, plain, shapes=shapes))

    async def custom_get(self, exchange: Exchange) -> Response | None:
        """Return the bytes of one field (`?field=PATH`), or the message's picture, points or GeoJSON if preferred."""
        if cloud_is_preferred(exchange, is_cloud=False):
            sample = (await self.message()).sample
            return await cloud_response(self, self.session.schemas, self.services.pictures, self.url, sample, exchange)
        if geojson_is_preferred(exchange):
            sample = (await self.message()).sample
            if is_on_earth(sample.schema.name):
                return await geojson_response(
                    self, self.session.schemas, sample, exchange, self.services.pictures.instance_id
                )
        wanted = explicit_picture_type(exchange)
        if wanted is not None:
            message = await self.message()
            require_picture(message.topic, (message.sample.schema,))
            return await picture_response(
                self, self.session.schemas, self.services.pictures, self.url, message.sample, exchange, wanted
            )
        if "field" not in exchange.query:
            return None
        return await field_response(self.session.schemas, (await self.message()).sample, exchange.query["field"])


def _pages(recording: Recording) -> tuple[int, int]:
    """Return the first and the last page of a recording's messages."""
    return recording.first // PAGE, max(0, (recording.first + recording.count - 1) // PAGE)


_TIME = QueryParameter("time", "The moment: an xsd:dateTime, or seconds before now as `-60`. Default: the end.")
_TOPIC = QueryParameter("topic", "The name of a topic, or a glob.")


class BagMoment(BagSelection):
    """The newest message of each topic at a time."""

    kind = "Moment of a recording"

    def __init__(
        self, services: Services, recording: Recording, at_ns: int, topics: Sequence[str], query: str, detail: Detail
    ) -> None:
        self._at_ns = at_ns
        self._topics = topics
        self._own = services.space.bag_moment(recording.name) + (f"?{query}" if query else "")
        super().__init__(services, recording, MessageFilter(), 0, query, detail)
        self.title = f"{recording.name} at {date_time(0, at_ns)}"
        self.item = PathItem(f"{self.recording.name} at one moment", query=(FORMAT, _TIME, _TOPIC))

    @property
    def conforms_to(self) -> Sequence[str]:
        return (self.space.document_shape("Moment"), self.space.document_shape("Record"))

    async def select_variant(self, exchange: Exchange) -> Resource:
        """Return the moment at the time and for the topics in the query. Raises Problems."""
        query = exchange.query
        given = {name: query[name] for name in ("time", "topic") if name in query}
        at_ns = read_time(given["time"], time.time_ns()) if "time" in given else self.recording.end_ns
        names = topics_of(self.recording, given["topic"]) if "topic" in given else self.recording.topics.keys()
        text = "&".join(f"{name}={quote(value, safe='/:.-*')}" for name, value in given.items())
        return BagMoment(self.services, self.recording, at_ns, sorted(names), text, detail_of(exchange))

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
        return bag_moment_document(self.recording, self.space, self.url, self._at_ns, messages)

    def _json(self, records: Sequence[DecodedRecord]) -> bytes:
        messages = [self._json_of(one) for one in records]
        return orjson.dumps({"time": date_time(0, self._at_ns), "messages": messages})


def bag_moment(services: Services, recording: Recording) -> BagMoment:
    """Return the moment of a recording's end, whose variants are other moments."""
    return BagMoment(services, recording, recording.end_ns, sorted(recording.topics), "", Detail.RDF)
