"""Mementos (RFC 7089): `?at=` are those of a recorded resource, `?timegate` is its TimeGate, `?timemap` lists them."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Hashable, Sequence
from datetime import datetime, timezone
from email.utils import format_datetime, parsedate_to_datetime
from functools import partial
from typing import TypeAlias, TypeVar
from urllib.parse import quote

from msgspec.structs import replace
from starlette.responses import Response

from rosld.adapters.base import FOR_EVER, MessageFilter
from rosld.adapters.model import RosError, Sample
from rosld.ontology.describe_views import time_map_document
from rosld.ontology.literals import date_time, date_time_nanoseconds
from rosld.ontology.urls import Space
from rosld.server.auth.permissions import Permissions
from rosld.server.history.history import History
from rosld.server.http.fields import Link, render_links
from rosld.server.http.negotiation import choose_offer
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.affordance_service import Snapshot
from rosld.server.hypermedia.catalogue import Getter, ParameterSource, Property, TopicSource, source_url
from rosld.server.hypermedia.conditions import url_of
from rosld.server.hypermedia.source_reader import decode_value
from rosld.server.hypermedia.value import Reading
from rosld.server.resources.accepted_shape import CommandResource
from rosld.server.resources.base import Services
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import OFFERS
from rosld.server.rest.path_item import QueryParameter
from rosld.server.rest.resource import Motion, Resource
from rosld.server.rest.responses import resource_headers
from rosld.server.rest.state import State

LINK_FORMAT = "application/link-format"
VARY = "Accept, Accept-Datetime"
SETTLED_NS = 3_000_000_000
"""Age in ns from which the history is complete and no longer changes."""
TIMEMAP = (
    QueryParameter("timemap", "The list of its mementos (RFC 7089), from number `start`."),
    QueryParameter("start", "The number of the first memento that `timemap` lists."),
    QueryParameter("timegate", "Redirects to the memento at the time in Accept-Datetime, by default the last one."),
)
PAST = (QueryParameter("at", "The resource as it was at this time (xsd:dateTime), from the history."), *TIMEMAP)
"""Query parameters for past states of a resource."""
_PAGE = 1000
_SECOND = 1_000_000_000
_DATE = "Tue, 31 Jan 2030 12:00:00 GMT"
_T = TypeVar("_T")
MementoPage: TypeAlias = Callable[[], Awaitable[tuple[Sequence[int], str | None]]]
"""Returns the times of mementos in ns, and the URL of the next TimeMap, or None for the last."""


def is_recorded(history: History, topic: str) -> bool:
    """Whether a topic has mementos."""
    return history.is_enabled and topic in history.writer.types


def timegate_links(url: str) -> tuple[Link, ...]:
    """Return the links of an original resource and of its mementos (RFC 7089 2.2)."""
    timemap = Link(f"{url}?timemap", "timemap", type=LINK_FORMAT)
    return (Link(url, "original"), Link(f"{url}?timegate", "timegate"), timemap)


def memento_url(url: str, time_ns: int) -> str:
    """Return the URL of the memento of a resource at a time."""
    return f"{url}?at={date_time(0, time_ns)}"


def memento_datetime(time_ns: int) -> str:
    """Return a time in the format of `Memento-Datetime` and of links to mementos, which has whole seconds."""
    return format_datetime(datetime.fromtimestamp(time_ns // _SECOND, timezone.utc), usegmt=True)


def wanted_datetime(exchange: Exchange) -> str | None:
    """Return the Accept-Datetime of a request to a TimeGate: `?timegate`, or GET of the resource itself.

    HEAD of the resource is about its present state: memento-client finds a TimeGate only by a link of a response that
    does not vary by Accept-Datetime itself.
    """
    wanted = exchange.headers.get("accept-datetime")
    if "timegate" in exchange.query:
        return wanted or format_datetime(datetime.now(timezone.utc), usegmt=True)
    return wanted if exchange.method == "GET" else None


async def present(now: Resource, exchange: Exchange) -> Resource:
    """Return the resource, for HEAD with Accept-Datetime as a representation that does not vary by it."""
    if exchange.method != "HEAD" or "accept-datetime" not in exchange.headers:
        return now
    await now.prepare()

    async def state() -> State:
        found = await now.state()
        return replace(found, headers={**found.headers, "vary": "Accept"}, renderings={}, redactions={})

    return Memento(now, now.kind, "", state)


def parse_accept_datetime(text: str) -> int:
    """Return the end of the second that Accept-Datetime names, in ns. Raises a 400 Problem."""
    try:
        at = parsedate_to_datetime(text).astimezone(timezone.utc)
    except (ValueError, TypeError, OverflowError) as error:
        raise Problem(400, f"Accept-Datetime: {text[:60]!r} is not a date such as {_DATE}.") from error
    return int(at.timestamp()) * _SECOND + _SECOND - 1


def found(location: str, links: Sequence[Link]) -> Problem:
    """Return a redirection (302) from a TimeGate to a memento (RFC 7089 4.1.1)."""
    headers = {"Location": location, "Vary": VARY, "Link": render_links(links)}
    return Problem(302, f"It is at {location}", title="Found", headers=headers)


async def read_history(read: Callable[[], _T]) -> _T:
    """Read the history off the loop. Raises a 503 Problem if it cannot be read."""
    try:
        return await asyncio.to_thread(read)
    except (OSError, ValueError, KeyError) as error:
        raise Problem(503, f"The history cannot be read at the moment: {error}.") from error


async def negotiate_topic(space: Space, history: History, topic: str, accept_datetime: str) -> Problem:
    """Return a redirection (302) to the memento of a topic at a time, or to the first one (RFC 7089 4.5.3).

    Raises Problems.
    """
    wanted, url = parse_accept_datetime(accept_datetime), space.topic(topic)
    settled = time.time_ns() - SETTLED_NS
    only = frozenset({topic})

    def look() -> tuple[Sample | None, Sample | None, Sample | None]:
        page = history.recording.select(MessageFilter(only, to_ns=settled), 1)
        first = page.messages[0].sample if page.messages else None
        at = history.writer.latest_at(topic, min(wanted, settled))
        return at or first, first, history.writer.latest_at(topic, settled)

    at, first, last = await read_history(look)
    if at is None or first is None or last is None:
        raise Problem(
            404, f"There is no memento of {topic} yet: messages become mementos after {SETTLED_NS // _SECOND} s."
        )
    ends = [("first memento", first), ("last memento", last), ("memento", at)]
    links = [_memento(url, rel, each.received_ns) for rel, each in ends]
    return found(memento_url(url, at.received_ns), (*timegate_links(url), *links))


class Memento(Resource):
    """A read-only, unchanging resource for the state of another at a time."""

    is_cacheable = False

    def __init__(
        self,
        now: Resource,
        kind: str,
        text: str,
        state: Callable[[], Awaitable[State]],
        get: Callable[[Resource, Exchange], Awaitable[Response | Motion | None]] | None = None,
    ) -> None:
        """`text` is the time in the query, `state` reads the past state, `get` a part of it."""
        super().__init__(now.space, now.url)
        self.kind = kind
        self.title = now.title
        self.links = tuple(dict.fromkeys((*now.links, *timegate_links(now.url))))
        self._now = now
        self._text = text
        self._state = state
        self._get = get

    @property
    def variant_key(self) -> Hashable:
        return self._text

    @property
    def query(self) -> str:
        return f"at={quote(self._text, safe=':')}"

    @property
    def conforms_to(self) -> Sequence[str]:
        return self._now.conforms_to

    @property
    def constrained_by(self) -> str | None:
        return self._now.constrained_by

    async def state(self) -> State:
        return await self._state()

    def redact(self, state: State, permissions: Permissions) -> State:
        return self._now.redact(state, permissions)

    async def custom_get(self, exchange: Exchange) -> Response | Motion | None:
        return None if self._get is None else await self._get(self, exchange)


class TimeMap(Resource):
    """The mementos of a resource, or a page of them."""

    kind = "TimeMap"
    shape = "TimeMap"
    is_cacheable = False

    def __init__(self, space: Space, original: str, name: str, page: MementoPage, start: int = 0) -> None:
        super().__init__(space, _time_map_url(original, start))
        self.title = f"Mementos of {name}"
        self._original = original
        self._page = page

    async def state(self) -> State:
        times, after = await self._page()
        mementos = [(memento_url(self._original, each), each) for each in times]
        return State(lambda: time_map_document(self.url, self._original, mementos, after))

    async def custom_get(self, exchange: Exchange) -> Response | None:
        """Return the TimeMap as links (RFC 6690), the default format."""
        return _time_map_response(self, exchange, self._original, *await self._page())


def time_map_of(
    space: Space, history: History, original: str, name: str, topics: frozenset[str], exchange: Exchange
) -> TimeMap:
    """Return the requested TimeMap of a resource derived from topics: a memento per message, a thousand per page.

    `?start` is the number of the first message in the history. Raises a 400 Problem.
    """
    start = exchange.query_integer("start", 0, 0, FOR_EVER)

    async def page() -> tuple[Sequence[int], str | None]:
        if not topics:
            return [], None
        settled = time.time_ns() - SETTLED_NS
        recording = history.recording
        wanted = MessageFilter(topics, to_ns=settled, start=max(start, recording.first))
        found = await read_history(lambda: recording.select(wanted, _PAGE))
        times = dict.fromkeys(each.sample.received_ns for each in found.messages)
        return list(times), None if found.next is None else _time_map_url(original, found.next)

    return TimeMap(space, original, name, page, start)


def _time_map_response(
    resource: Resource, exchange: Exchange, original: str, times: Sequence[int], after: str | None
) -> Response | None:
    """Return a TimeMap as links to mementos at `times` (ns) and to the TimeMap `after`; None if RDF is preferred."""
    if "format" in exchange.query or choose_offer(exchange.accept, (LINK_FORMAT, *OFFERS)) != LINK_FORMAT:
        return None
    ends = (("from", memento_datetime(times[0])), ("until", memento_datetime(times[-1]))) if times else ()
    rels = ["memento"] * len(times)
    if times and after is None:
        rels[-1] = "last memento"
    links = [
        *timegate_links(original)[:2],
        Link(resource.url, "self", type=LINK_FORMAT, attributes=ends),
        *(_memento(original, rel, each) for rel, each in zip(rels, times, strict=True)),
    ]
    if after is not None:
        links.append(Link(after, "timemap", type=LINK_FORMAT))
    headers = {**resource_headers(resource), "vary": "Accept", "cache-control": "no-cache"}
    return Response(",\n".join(map(str, links)) + "\n", media_type=LINK_FORMAT, headers=headers)


def _memento(url: str, rel: str, time_ns: int) -> Link:
    return Link(memento_url(url, time_ns), rel, attributes=(("datetime", memento_datetime(time_ns)),))


def _time_map_url(original: str, start: int) -> str:
    return f"{original}?timemap&start={start}" if start else f"{original}?timemap"


def read_time(text: str, now_ns: int) -> int:
    """Return a time in ns: an xsd:dateTime, or seconds before now with a minus. Raises a 400 Problem.

    The result is clamped to the times that messages can have.
    """
    return max(-FOR_EVER, min(_nanoseconds(text, now_ns), FOR_EVER))


def _nanoseconds(text: str, now_ns: int) -> int:
    try:
        if text.startswith("-") and text.count("-") == 1:
            return now_ns + round(float(text) * 1e9)
        exact = date_time_nanoseconds(text.replace("z", "Z"))
        if exact is not None:
            return exact
        found = datetime.fromisoformat(f"{text[:-1]}+00:00" if text.endswith(("Z", "z")) else text.replace(" ", "+"))
        aware = found if found.tzinfo is not None else found.replace(tzinfo=timezone.utc)
        return int(aware.replace(microsecond=0).timestamp()) * 10**9 + aware.microsecond * 1000
    except (ValueError, OverflowError) as error:
        words = f"{text[:60]!r} is neither a time such as 2030-01-31T12:00:00Z nor seconds before now such as -60."
        raise Problem(400, words) from error


_NOT_KEPT = "Nothing is recorded: rosld serve --history records topics."


class PastReadings:
    """Readings of properties at a time in the past."""

    def __init__(self, services: Services, at_ns: int) -> None:
        self._session = services.session
        self._affordances = services.affordances
        self._history = services.history
        self._at_ns = at_ns

    async def snapshot(self, properties: Sequence[Property]) -> Snapshot:
        """Return the snapshot of these properties."""
        readings = [await self._reading(each) for each in properties]
        return self._affordances.snapshot(await self._affordances.tree(), readings)

    async def _reading(self, property: Property) -> Reading:
        recorded = _recorded_topic(self._history, property)
        about = tuple(source_url(each, self._session.space) for each in property.readers)
        unreadable = partial(Reading, property.name, None, about=about)
        if recorded is None:
            return unreadable(_unknown(property))
        sample = await read_history(lambda: self._history.writer.latest_at(recorded, self._at_ns))
        if sample is None:
            return unreadable(f"no message of {recorded} was recorded before that time")
        try:
            schema = await self._session.schemas.message(sample.schema)
        except RosError as error:
            return unreadable(f"the message of {recorded} cannot be read: {error.sentence}")
        found = decode_value(recorded, sample, schema, property.name)
        return Reading(property.name, found.value, found.failure, found.read_ns, about=about if found.failure else ())


class TimeGate(CommandResource):
    """Base class of properties and complex resources, which have mementos and a TimeGate (RFC 7089)."""

    def __init__(self, services: Services, name: str) -> None:
        super().__init__(services, url_of(name, services.space))
        self.name = name
        self.title = name if name != "/" else "Resources"
        self.affordances = services.affordances
        history = self.history = services.history
        self.links = (*self._own_links(), *(timegate_links(self.url) if history.is_enabled else ()))
        self._headers = {"vary": VARY} if history.is_enabled else {}
        """Headers of the current state, which prevent its reuse by caches for past times."""

    def _own_links(self) -> tuple[Link, ...]:
        return type(self).links

    async def past_state(self, readings: PastReadings) -> State:
        """Return the state for past readings. Raises a 404 Problem if the resource has no past."""
        raise NotImplementedError

    async def recorded_properties(self) -> Sequence[Property]:
        """Return the properties whose topics determine past states."""
        raise NotImplementedError

    async def get_part(self, resource: Resource, exchange: Exchange) -> Response | None:
        """Return a requested part of the state of this resource, or of a memento."""
        return None

    async def select_variant(self, exchange: Exchange) -> Resource:
        """Return the state at `?at=TIME` or Accept-Datetime, or the `?timemap`."""
        if asks_for_time_map(self.history, exchange):
            topics = _recorded_topics(self.history, await self.recorded_properties())
            return time_map_of(self.space, self.history, self.url, self.name, topics, exchange)
        requested = requested_time(self.history, self.url, exchange)
        if requested is None:
            found = await super().select_variant(exchange)
            return await present(found, exchange) if self.history.is_enabled else found
        at_ns, text = requested
        await self.prepare()
        return Memento(self, "Resource as it was", text, partial(self._state_at, at_ns), self.get_part)

    async def _state_at(self, at_ns: int) -> State:
        """Return a past state, with the headers of a memento if it can no longer change."""
        state = await self.past_state(PastReadings(self.services, at_ns))
        is_settled = at_ns < time.time_ns() - SETTLED_NS
        headers = {"memento-datetime": memento_datetime(at_ns)} if is_settled else {}
        return replace(
            state,
            headers={**headers, "vary": VARY},
            received_ns=None,
            max_age=0,
            token=None,
            renderings={},
            redactions={},
        )


def requested_time(history: History, url: str, exchange: Exchange) -> tuple[int, str] | None:
    """Return the time in `?at=` and its text, or None for the current state. Raises Problems: 302, 400, 404."""
    wanted = wanted_datetime(exchange)
    if exchange.method not in ("GET", "HEAD") or ("at" not in exchange.query and wanted is None):
        return None
    if "at" not in exchange.query:
        if wanted is None or (not history.is_enabled and "timegate" not in exchange.query):
            return None
        if not history.is_enabled:
            raise Problem(404, _NOT_KEPT)
        at_ns = min(parse_accept_datetime(wanted), time.time_ns() - SETTLED_NS)
        raise found(memento_url(url, at_ns), timegate_links(url))
    if not history.is_enabled:
        raise Problem(404, _NOT_KEPT)
    text = exchange.query["at"]
    return read_time(text, time.time_ns()), text


def asks_for_time_map(history: History, exchange: Exchange) -> bool:
    """Whether a request is for the TimeMap. Raises a 404 Problem if nothing is recorded."""
    if exchange.method not in ("GET", "HEAD") or "timemap" not in exchange.query:
        return False
    if not history.is_enabled:
        raise Problem(404, _NOT_KEPT)
    return True


def _recorded_topic(history: History, property: Property) -> str | None:
    """Return the recorded topic of a property, or None if there is none."""
    topics = (each.name for each in property.readers if isinstance(each, TopicSource))
    return next((each for each in topics if is_recorded(history, each)), None)


def _recorded_topics(history: History, properties: Sequence[Property]) -> frozenset[str]:
    found = (_recorded_topic(history, each) for each in properties)
    return frozenset(each for each in found if each is not None)


def _unknown(property: Property) -> str:
    """Return the reason why the past of a property is unknown."""
    kinds = {Getter: "the service", ParameterSource: "the parameter", TopicSource: "the topic"}
    sources = [f"{kinds.get(type(each), 'the action')} {each.name}" for each in property.readers]
    return f"its state at that time is unknown: {' and '.join(sources) or 'its source'} is not recorded"
