"""Selections of recorded messages, lifted in batches; each as at its own URL."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Iterable, Mapping, Sequence
from enum import Enum
from fnmatch import fnmatchcase
from functools import partial
from urllib.parse import quote

import orjson
from msgspec import Struct
from msgspec.structs import replace
from pyoxigraph import NamedNode, Triple

from rosld.adapters.base import FOR_EVER, MessageFilter, MessagePage, RecordedMessage, Recording
from rosld.adapters.model import UnknownType
from rosld.ontology.describe_bags import bag_message_document, bag_selection_document
from rosld.ontology.document import Document
from rosld.ontology.literals import date_time
from rosld.ontology.triples import date_time_literal
from rosld.server.auth.permissions import Permissions
from rosld.server.html.page import Cell, MemberColumns, SequenceLink
from rosld.server.http.conditional import digest
from rosld.server.http.fields import Link
from rosld.server.http.problem import Problem
from rosld.server.resources.bags import BagBase
from rosld.server.resources.base import Services
from rosld.server.resources.memento import read_time
from rosld.server.resources.messages import DecodedSample, decode, lift_sample
from rosld.server.resources.tables import BagTable, wanted_table
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import FORMATS, HTML, JSON, OFFERS
from rosld.server.rest.path_item import QueryParameter
from rosld.server.rest.resource import RDF_SOURCE, RESOURCE
from rosld.server.rest.state import State
from rosld.server.robot.schemas import Schemas
from rosld.server.robot.session import Session


class DecodedRecord(Struct, frozen=True, eq=False):
    """A recorded message, decoded if possible."""

    message: RecordedMessage
    decoded: DecodedSample


async def learn_type(schemas: Schemas, recording: Recording, message: RecordedMessage) -> None:
    """Make the type of a recorded message known, as it was recorded, as far as it can be."""
    type = message.sample.schema
    if schemas.find_cached(type) is None:
        with contextlib.suppress(UnknownType):
            schemas.add(type, await asyncio.to_thread(recording.schema, type))


async def decode_records(
    schemas: Schemas, recording: Recording, messages: Iterable[RecordedMessage]
) -> Sequence[DecodedRecord]:
    """Decode recorded messages."""
    found: list[DecodedRecord] = []
    for message in messages:
        await learn_type(schemas, recording, message)
        found.append(DecodedRecord(message, await decode(schemas, message.sample)))
    return found


def record_document(session: Session, recording: Recording, one: DecodedRecord) -> Document:
    """Return the document of a recorded message."""
    space, lifting = session.space, session.lifting
    lifted = lift_sample(space, lifting, one.decoded) if one.decoded.message is not None else None
    document = bag_message_document(recording, one.message, space, lifted, unreadable=one.decoded.reason)
    return replace(document, simulated_time=session.graph.simulated_time)


def record_triples(session: Session, recording: Recording, records: Iterable[DecodedRecord]) -> list[Triple]:
    """Return the triples of recorded messages. Slow: call it in a thread."""
    return [triple for one in records for triple in record_document(session, recording, one).all_triples()]


LIMIT, MAX_LIMIT = 100, 1000
_MAX_TOPIC = 1000
PARAMETERS = (
    QueryParameter("topic", "Messages of this topic, or of the topics that match a glob such as `/camera/*`."),
    QueryParameter("from", "Recorded since: an xsd:dateTime, or seconds before now as `-60`."),
    QueryParameter("to", "Recorded until, in the same format."),
    QueryParameter("start", "The number of the first message of the page.", {"type": "integer", "minimum": 0}),
    QueryParameter(
        "limit",
        f"The maximum number of messages on a page (up to {MAX_LIMIT}) or in a table.",
        {"type": "integer", "minimum": 1},
    ),
)
_NAMES = tuple(parameter.name for parameter in PARAMETERS)


class Detail(Enum):
    """Detail of the messages on a page: URLs only, RDF, or JSON."""

    LIST = "list"
    RDF = "rdf"
    JSON = "json"


class BagSelection(BagBase):
    """A page of the messages of a recording that match a filter."""

    kind = "Messages"

    def __init__(
        self, services: Services, recording: Recording, wanted: MessageFilter, limit: int, query: str, detail: Detail
    ) -> None:
        self._base = services.space.bag_messages(recording.name)
        self._query = query
        self.start = wanted.start
        super().__init__(services, self._page_url(self.start))
        self.title = f"Messages of {recording.name}"
        self.recording = recording
        self.wanted = wanted
        self.limit = limit
        self._detail = detail
        self._page: MessagePage | None = None

    @property
    def conforms_to(self) -> Sequence[str]:
        return (self.space.document_shape("Container"), self.space.document_shape("Record"))

    async def prepare(self) -> None:
        """Read the page, because Link needs the position after it."""
        await self._read()
        self.links = (RESOURCE, RDF_SOURCE, *(Link(step.url, step.rel) for step in self.navigation_links()))

    async def state(self) -> State:
        page = await self._read()
        token = digest(f"{[each.index for each in page.messages]} {page.next}".encode())
        describe = partial(self._describe, page.messages)
        if self._detail is Detail.LIST:
            return State(describe, token=token)
        records = await decode_records(self.session.schemas, self.recording, page.messages)
        if self._detail is Detail.JSON:
            data = await asyncio.to_thread(self._json, records)
            return State(describe, lambda: data, token=token)
        lifted = await asyncio.to_thread(record_triples, self.session, self.recording, records)
        triples = (*describe().triples, *lifted)
        return State(lambda: Document(self.url, triples), token=token, is_long=True)

    def redact(self, state: State, permissions: Permissions) -> State:
        plain = state.plain

        def permitted() -> bytes:
            assert plain is not None
            members = orjson.loads(plain())
            members["messages"] = [each for each in members["messages"] if permissions.may_read(each["url"])]
            return orjson.dumps(members)

        return state.redact(permissions, plain=None if plain is None else permitted)

    def listing(self) -> MemberColumns | None:
        if self._page is None:
            return None
        space, name = self.space, self.recording.name
        cells: dict[str, tuple[Cell, ...]] = {
            space.bag_message(name, each.index): (
                NamedNode(space.topic(each.topic)),
                date_time_literal(each.sample.received_ns) or "",
            )
            for each in self._page.messages
        }
        return MemberColumns(("topic", "recorded"), cells)

    def navigation_links(self) -> tuple[SequenceLink, ...]:
        first = SequenceLink("first", self._page_url(0))
        after = None if self._page is None else self._page.next
        return (first,) if after is None else (first, SequenceLink("next", self._page_url(after)))

    def _describe(self, messages: Sequence[RecordedMessage]) -> Document:
        return bag_selection_document(self.recording, self.space, self.url, messages)

    async def _read(self) -> MessagePage:
        if self._page is None:
            self._page = await asyncio.to_thread(self.recording.select, self.wanted, self.limit)
        return self._page

    def _page_url(self, start: int) -> str:
        query = "&".join(part for part in (self._query, f"start={start}" if start else "") if part)
        return f"{self._base}?{query}" if query else f"{self._base}?start=0"

    def _json(self, records: Sequence[DecodedRecord]) -> bytes:
        after = next((step.url for step in self.navigation_links() if step.rel == "next"), None)
        return orjson.dumps({"messages": [self._json_of(one) for one in records], "next": after})

    def _json_of(self, one: DecodedRecord) -> dict[str, object]:
        message, decoded = one.message, one.decoded
        url = self.space.bag_message(self.recording.name, message.index)
        members: dict[str, object] = {
            "url": url,
            "index": message.index,
            "topic": message.topic,
            "time": date_time(0, message.sample.received_ns),
            **({"opening": True} if message.is_opening else {}),
        }
        if decoded.message is None:
            return members | {"unreadable": decoded.reason}
        return members | {
            "message": orjson.Fragment(
                lift_sample(self.space, self.session.lifting, decoded).lifter.json(decoded.message, url)
            )
        }


def selection_of(services: Services, recording: Recording, exchange: Exchange) -> BagSelection | BagTable | None:
    """Return the requested page or table, or None without a topic, time or number in the query. Raises Problems."""
    query = exchange.query
    given = {name: query[name] for name in _NAMES if name in query}
    table = wanted_table(exchange)
    if not given and table is None:
        return None
    now = time.time_ns()
    topics = topics_of(recording, given["topic"]) if "topic" in given else None
    since = read_time(given["from"], now) if "from" in given else 0
    until = read_time(given["to"], now) if "to" in given else FOR_EVER
    if since > until:
        raise Problem(400, f"?from={given['from'][:60]} is after ?to={given['to'][:60]}.")
    start = exchange.query_integer("start", 0, 0, FOR_EVER)
    usual, most = (LIMIT, MAX_LIMIT) if table is None else (FOR_EVER, FOR_EVER)
    limit = exchange.query_integer("limit", usual, 1, most)
    wanted = MessageFilter(topics, max(since, 0), until, max(start, recording.first))
    if start and start < recording.first:
        raise Problem(410, f"?start={start}: the oldest messages were removed, the first is {recording.first}.")
    if table is not None:
        return BagTable(services, recording, wanted, limit, _query(given), table)
    text = _query({name: value for name, value in given.items() if name != "start"})
    return BagSelection(services, recording, wanted, limit, text, detail_of(exchange))


def _query(given: Mapping[str, str]) -> str:
    return "&".join(f"{name}={quote(value, safe='/:.-*')}" for name, value in given.items())


def topics_of(recording: Recording, text: str) -> frozenset[str]:
    """Return the topics of a recording that match a name or a glob. Raises Problems: 400, 404."""
    if not text.startswith(("/", "*")) or len(text) > _MAX_TOPIC:
        raise Problem(400, f"?topic={text[:60]}: must begin with a slash or a star, such as /odom.")
    names = recording.topics
    found = frozenset({text} if text in names else {name for name in names if fnmatchcase(name, text)})
    if not found:
        few = ", ".join(sorted(names)[:10]) or "none"
        raise Problem(404, f"{recording.name} has no topic {text[:200]}; it has {few}{'...' * (len(names) > 10)}.")
    return found


def detail_of(exchange: Exchange) -> Detail:
    """Return the detail that the preferred representation needs."""
    chosen = exchange.preferred(FORMATS, OFFERS)
    return {HTML: Detail.LIST, JSON: Detail.JSON}.get(chosen or "", Detail.RDF)
