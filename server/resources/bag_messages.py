"""The messages of a recording, in pages and one by one."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

from starlette.responses import Response

from rosld.adapters.base import RecordedMessage, Recording
from rosld.adapters.model import NotFound
from rosld.ontology.describe_bags import bag_messages_document
from rosld.ontology.document import Document
from rosld.server.html.page import SequenceLink
from rosld.server.http.fields import Link
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import ANYTHING
from rosld.server.hypermedia.message_schemas import MessageSchemas
from rosld.server.pictures.picture_cache import PictureCache
from rosld.server.resources.bag_selection import PARAMETERS, selection_of
from rosld.server.resources.messages import decode, field_response, lift_sample
from rosld.server.resources.pictures import explicit_picture_type, picture_response, require_picture
from rosld.server.resources.point_clouds import cloud_is_preferred, cloud_response
from rosld.server.resources.recorded_messages import DecodedRecord, learn_type, record_document
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.path_item import FIELD, FIELD_READS, FORMAT, PathItem, QueryParameter
from rosld.server.rest.resource import BASIC_CONTAINER, RDF_SOURCE, RESOURCE, Resource
from rosld.server.rest.state import State
from rosld.server.robot.session import Session
from rosld.server.runtime.version_cache import VersionCache

PAGE = 100
"""Messages on one page of `/bags/B/messages/`."""

_PAGE = QueryParameter("page", "A page of messages, from 0.", {"type": "integer", "minimum": 0})


class BagMessages(Resource):
    """The messages of a recording: a container in pages (`?page=N` from 0; without it, links only)."""

    kind = "Messages"
    is_cacheable = False
    links = (RESOURCE, RDF_SOURCE, BASIC_CONTAINER)

    def __init__(
        self, session: Session, states: VersionCache[State], recording: Recording, page: int | None = None
    ) -> None:
        base = session.space.bag_messages(recording.name)
        super().__init__(base if page is None else f"{base}?page={page}")
        self.session = session
        self.states = states
        self.recording = recording
        self.number = page

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        return PathItem(f"The messages of {self.recording.name}", query=(FORMAT, _PAGE, *PARAMETERS))

    @property
    def conforms_to(self) -> Sequence[str]:
        return (self.session.space.document_shape("Container"),)

    async def state(self) -> State:
        recording, space, page = self.recording, self.session.space, self.number
        version = recording.first, recording.count
        return self.states.get_or_make(
            self.url, version, lambda: State(lambda: bag_messages_document(recording, space, page, PAGE))
        )

    def navigation_links(self) -> tuple[SequenceLink, ...]:
        base = self.session.space.bag_messages(self.recording.name)
        first, last = _pages(self.recording)
        if self.number is None:
            places = {"first": first, "last": last}
        else:
            places = {"first": first, "prev": self.number - 1, "next": self.number + 1, "last": last}
        return tuple(SequenceLink(rel, f"{base}?page={at}") for rel, at in places.items() if first <= at <= last)

    async def select_variant(self, exchange: Exchange) -> Resource:
        """The page that `?page=`, or a filter, asks for; a 404 Problem where there is none."""
        wanted = exchange.query.get("page")
        if wanted is None:
            return selection_of(self.session, self.recording, exchange) or self
        first, last = _pages(self.recording)
        if not (wanted.isascii() and wanted.isdigit()) or int(wanted) > last:
            raise Problem(404, f"?page={wanted}: the pages of {self.recording.name} are {first} to {last}.")
        if int(wanted) < first:
            raise Problem(410, f"?page={wanted}: the oldest messages were removed, the pages are {first} to {last}.")
        return BagMessages(self.session, self.states, self.recording, int(wanted))


class BagMessage(Resource):
    """One message of a recording."""

    kind = "Recorded message"
    is_cacheable = False

    def __init__(
        self, session: Session, states: VersionCache[State], pictures: PictureCache, recording: Recording, index: int
    ) -> None:
        super().__init__(session.space.bag_message(recording.name, index))
        self.session = session
        self.states = states
        self.pictures = pictures
        self.recording = recording
        self.index = index
        self.title = f"{recording.name}, message {index}"
        self.links = (*Resource.links, *(Link(step.url, step.rel) for step in self.navigation_links()))

    def navigation_links(self) -> tuple[SequenceLink, ...]:
        """The messages before and after, first and last (RFC 8288)."""
        first, last = self.recording.first, self.recording.first + self.recording.count - 1
        places = {"first": first, "prev": self.index - 1, "next": self.index + 1, "last": last}
        links = ((rel, self.session.space.bag_message(self.recording.name, at)) for rel, at in places.items())
        there = {rel for rel, at in places.items() if first <= at <= last}
        return tuple(SequenceLink(rel, url) for rel, url in links if rel in there)

    async def message(self) -> RecordedMessage:
        """The message, read off the loop; a 404 Problem where there is none."""
        try:
            message = await asyncio.to_thread(self.recording.message, self.index)
        except NotFound as error:
            raise Problem(410 if self.index < self.recording.first else 404, error.sentence) from error
        await learn_type(self.session.schemas, self.recording, message)
        return message

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        return PathItem(f"A message of {self.recording.name}", FIELD_READS, ANYTHING, (FORMAT, FIELD))

    @property
    def conforms_to(self) -> Sequence[str]:
        return (self.session.space.document_shape("Record"),)

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
            return lift_sample(self.session.space, self.session.lifting, decoded).lifter.json(decoded.message, self.url)

        def describe() -> Document:
            return record_document(
                self.session.space,
                self.session.lifting,
                recording,
                DecodedRecord(message, decoded),
                simulated_time=self.session.graph.simulated_time,
            )

        shapes = () if decoded.schema is None else self.session.space.shapes_of(decoded.schema)
        return self.states.put(self.url, 0, State(describe, plain, shapes=shapes))

    async def custom_get(self, exchange: Exchange) -> Response | None:
        """`?field=PATH`: the bytes of one field; or its picture or points, where that is preferred."""
        if cloud_is_preferred(exchange, is_cloud=False):
            sample = (await self.message()).sample
            return await cloud_response(self, self.session.schemas, self.pictures, self.url, sample, exchange)
        wanted = explicit_picture_type(exchange)
        if wanted is not None:
            message = await self.message()
            require_picture(message.topic, (message.sample.schema,))
            return await picture_response(
                self, self.session.schemas, self.pictures, self.url, message.sample, exchange, wanted
            )
        if "field" not in exchange.query:
            return None
        return await field_response(self.session.schemas, (await self.message()).sample, exchange.query["field"])


def _pages(recording: Recording) -> tuple[int, int]:
    """The first and the last page of a recording's messages."""
    return recording.first // PAGE, max(0, (recording.first + recording.count - 1) // PAGE)
