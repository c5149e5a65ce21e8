"""`/bags/B/ldes`: the messages of a recording as a Linked Data Event Stream, in pages of a search tree (TREE).

A page has a hundred messages, or links to a hundred pages, by number; a full page never changes.
"""

from __future__ import annotations

import asyncio
import re
from collections.abc import Hashable, Iterator, Sequence
from typing import NamedTuple

from rosld.adapters.base import MessageFilter, Recording
from rosld.ontology.describe_bags import StreamLink, StreamProfile, event_stream_document, observation_triples
from rosld.ontology.document import Document
from rosld.ontology.observations import Role, observed_fields
from rosld.ontology.urls import Space
from rosld.server.http.conditional import digest
from rosld.server.http.fields import Link
from rosld.server.http.negotiation import PROFILE_QUERY, VARY_PROFILE, choose_profile
from rosld.server.http.problem import Problem
from rosld.server.resources.bag_selection import DecodedRecord, decode_records, record_document
from rosld.server.resources.bags import BagBase
from rosld.server.resources.base import Services
from rosld.server.resources.messages import lift_sample
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.path_item import FORMAT, PathItem, QueryParameter
from rosld.server.rest.resource import RDF_SOURCE, RESOURCE, Resource
from rosld.server.rest.state import State

MEMBERS = 100
"""Number of messages, or of links to pages, on a page."""
_YEAR = 365 * 24 * 3600
_SHORT = 2
_NAME = re.compile(r"[0-9a-f]+-[0-9]{1,2}-[0-9]{1,15}", re.ASCII)
_PROFILES = {"ros": StreamProfile.RECORD.value, "sosa": StreamProfile.OBSERVATION.value}
PROFILE = QueryParameter(
    PROFILE_QUERY, "The profile of the members; overrides Accept-Profile.", {"type": "string", "enum": [*_PROFILES]}
)


class PageNumber(NamedTuple):
    """The page `number` of a level: of messages on level 0, of links to pages of the level below on the others."""

    level: int
    number: int

    @property
    def size(self) -> int:
        """The number of messages below a full page of this level."""
        return int(MEMBERS ** (self.level + 1))

    @property
    def start(self) -> int:
        """The number of the first message."""
        return self.number * self.size

    @property
    def end(self) -> int:
        """The number after the last message."""
        return self.start + self.size

    def within(self, first: int, beyond: int) -> Iterator[PageNumber]:
        """Yield the pages of the level below with messages from `first` to `beyond` (exclusive)."""
        return pages_between(self.level - 1, max(self.start, first), min(self.end, beyond))


def pages_between(level: int, first: int, beyond: int) -> Iterator[PageNumber]:
    """Yield the pages of a level with messages from `first` to `beyond` (exclusive)."""
    size = MEMBERS ** (level + 1)
    return (PageNumber(level, number) for number in range(first // size, -(-beyond // size)))


def top_level(first: int, beyond: int) -> int:
    """Return the lowest level at which one page of links leads to all pages."""
    level = 0
    while -(-beyond // MEMBERS ** (level + 1)) - first // MEMBERS ** (level + 1) > MEMBERS:
        level += 1
    return level


class EventStreamResource(BagBase):
    """An event stream (`page` is None), or one of its pages."""

    kind = "Event stream"
    _profile = StreamProfile.RECORD
    _suffix = ""

    def __init__(self, services: Services, recording: Recording, page: PageNumber | None = None) -> None:
        super().__init__(services, _url(services.space, recording, page))
        self.recording = recording
        self._page = page
        self.shape = "EventStream" if page is None else "StreamPage"
        self.title = f"Messages of {recording.name}"
        self.item = PathItem(f"The messages of {self.recording.name} as an event stream", query=(FORMAT, PROFILE))

    @property
    def variant_key(self) -> Hashable:
        return self._profile

    async def select_variant(self, exchange: Exchange) -> Resource:
        """Return the stream in the preferred profile; a profile in the query is part of the URLs of all pages.

        Raises a 406 Problem for an unknown profile.
        """
        requested = exchange.query.get(PROFILE_QUERY)
        found = choose_profile(_PROFILES, exchange.header("accept-profile"), exchange.prefer, requested)
        if requested is not None and found is None:
            raise Problem(406, f"?{PROFILE_QUERY}={requested[:60]} is unknown; choose from {', '.join(_PROFILES)}.")
        name = next((name for name, known in _PROFILES.items() if known == found), None)
        suffix = "" if requested is None or name is None else f"?{PROFILE_QUERY}={name}"
        profile = StreamProfile(found) if found else StreamProfile.RECORD
        links = (RESOURCE, RDF_SOURCE, Link(profile.value, "profile"))
        return self.variant(url=self.url + suffix, links=links, _profile=profile, _suffix=suffix)

    async def state(self) -> State:
        recording, page = self.recording, self._page
        first, beyond, settled = recording.first, recording.first + recording.count, recording.settled
        is_immutable = page is not None and first <= page.start and page.end <= max(settled, 0)
        is_immutable = is_immutable or (page is not None and settled == beyond and self._is_finished)
        version = "immutable" if is_immutable else (recording.identity, first, beyond, settled)
        key = f"{self.url} {self._profile.name}"
        known = self.states.find(key, version)
        if known is not None:
            return known
        members = await self._members(page) if page is not None and page.level == 0 else ()
        document = event_stream_document(
            _url(self.space, recording) + self._suffix,
            self.url,
            self._profile,
            await asyncio.to_thread(self._links, first, beyond, settled),
            members,
            self.space.document_shape("Record") if self._profile is StreamProfile.RECORD else None,
        )
        age = f"max-age={_YEAR}, immutable" if is_immutable else f"max-age={_SHORT}"
        headers = {"cache-control": age, "vary": VARY_PROFILE, "content-profile": f"<{self._profile.value}>"}
        token = digest(f"{key} {version}".encode())
        return self.states.put(key, version, State(lambda: document, token=token, headers=headers, is_long=True))

    @property
    def _is_finished(self) -> bool:
        return self.recording is not self.recordings.history.recording

    def _links(self, first: int, beyond: int, settled: int) -> list[StreamLink]:
        if self._page is None:
            pages = pages_between(top_level(first, beyond), first, beyond)
        elif self._page.level:
            pages = self._page.within(first, beyond)
        else:
            return []
        return [self._link(each, first, settled) for each in pages]

    def _link(self, page: PageNumber, first: int, settled: int) -> StreamLink:
        url = _url(self.space, self.recording, page) + self._suffix
        if page.end > settled and not self._is_finished:
            return StreamLink(url)
        times = self.recording.times_between(max(page.start, first), page.end)
        return StreamLink(url) if times is None else StreamLink(url, *times)

    async def _members(self, page: PageNumber) -> Sequence[Document]:
        """Return all messages of a page; large ones are read and lifted in batches."""
        found: list[Document] = []
        start: int | None = page.start
        while start is not None:
            wanted = MessageFilter(start=max(start, self.recording.first), end=page.end)
            some = await asyncio.to_thread(self.recording.select, wanted, MEMBERS)
            records = await decode_records(self.session.schemas, self.recording, some.messages)
            found += await asyncio.to_thread(list, map(self._member, records))
            start = some.next
        return found

    def _member(self, one: DecodedRecord) -> Document:
        space, lifting = self.space, self.session.lifting
        document = record_document(self.session, self.recording, one)
        if self._profile is StreamProfile.RECORD or one.decoded.message is None:
            return document.joined() if document.parts else Document(document.url, tuple(document.all_triples()))
        lifted = lift_sample(space, lifting, one.decoded).triples(document)
        schema = one.decoded.schema
        fields = () if schema is None else observed_fields(schema.ref.name, Role.SENSOR, schema)
        own = observation_triples(document.url, one.message, space, lifted, fields)
        return Document(document.url, (*own, *lifted))


def event_stream_page(services: Services, recording: Recording, name: str) -> EventStreamResource:
    """Return the page of this name. Raises 404 and 410 Problems."""
    identity, *numbers = name.split("-")
    if not _NAME.fullmatch(name):
        raise Problem(404, f"{name[:60]} is not a page of the stream: {_url(services.space, recording)} links to them.")
    if identity != recording.identity:
        raise Problem(410, f"This was a page of an earlier recording named {recording.name}, which was deleted.")
    page = PageNumber(*map(int, numbers))
    beyond = recording.first + recording.count
    if page.level > top_level(0, beyond) or page.start >= beyond:
        raise Problem(404, f"{recording.name} has no messages from {page.start} on: {beyond} is the next.")
    if page.end <= recording.first:
        raise Problem(410, f"The messages of this page were removed: the oldest is {recording.first}.")
    return EventStreamResource(services, recording, page)


def _url(space: Space, recording: Recording, page: PageNumber | None = None) -> str:
    if page is None:
        return space.bag_stream(recording.name)
    return space.bag_stream_page(recording.name, f"{recording.identity}-{page.level}-{page.number}")
