"""Listing of recordings: `/bags/` in pages, filtered and sorted by its query."""

from __future__ import annotations

import math
import time
from collections.abc import Hashable, Mapping, Sequence
from fnmatch import fnmatchcase
from urllib.parse import parse_qsl, quote

from msgspec import Struct
from msgspec.structs import replace

from rosld.adapters.catalogue import SORTS, Catalogue, Row, Selection
from rosld.ontology.describe_graph import container_document
from rosld.server.auth.permissions import Permissions
from rosld.server.html.forms import Form
from rosld.server.html.page import Cell, Csrf, FilterField, MemberColumns, Notice, Page, SequenceLink
from rosld.server.html.site import Site
from rosld.server.http.problem import Problem
from rosld.server.resources.bags import BagBase
from rosld.server.resources.listings import time_cell
from rosld.server.resources.memento import read_time
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.paging import (
    LdpPage,
    PagePosition,
    last_page_size,
    last_position,
    page_of,
    page_query,
    parse_position,
    require_page,
)
from rosld.server.rest.path_item import QueryParameter
from rosld.server.rest.resource import Resource
from rosld.server.rest.state import State

PAGE = 100
"""Number of recordings on a page, unless the client prefers another."""
_SORTS = (*SORTS, *(f"-{key}" for key in SORTS))
FILTERS = (
    QueryParameter("topic", "Only recordings with this topic, or one that matches a glob."),
    QueryParameter("type", "Only recordings with messages of this type, such as `nav_msgs/msg/Odometry`."),
    QueryParameter("from", "Only recordings that last until this time (xsd:dateTime) or longer."),
    QueryParameter("to", "Only recordings that begin at this time or before."),
    QueryParameter("min_duration", "Only recordings of at least this many seconds.", {"type": "number", "minimum": 0}),
    QueryParameter("tag", "Only recordings with this tag."),
    QueryParameter("q", "Only recordings with these words in their name, topics, tags and events."),
    QueryParameter("sort", "The order; a leading `-` reverses it.", {"type": "string", "enum": [*_SORTS]}),
)
_MAX_WORDS = 20
_LABELS = {"q": "Words", "from": "From", "to": "To", "min_duration": "Seconds at least", "sort": "Order"}
_COLUMNS = ("start", "duration", "messages", "size", "tags", "problem")


class Listing(Struct, frozen=True):
    """A selection of recordings in an order, with its query string."""

    selection: Selection = Selection()
    sort: str = "name"
    query: str = ""


def read_listing(query: Mapping[str, str], catalogue: Catalogue, permissions: Permissions) -> Listing:
    """Return the listing that a query asks for, by topics that the agent may read. Raises a 400 Problem."""
    given = {each.name: query[each.name] for each in FILTERS if query.get(each.name)}
    text = "&".join(f"{name}={quote(value.encode('utf-8', 'replace'), safe='/:*')}" for name, value in given.items())
    sort = given.get("sort", "name")
    if sort not in _SORTS:
        raise Problem(400, f"?sort={sort[:40]} is not one of {', '.join(_SORTS)}.")
    topics = searched = None
    if not permissions.is_unrestricted and given.keys() & {"topic", "type", "q"}:
        searched = topics = frozenset(filter(permissions.may_read_topic, catalogue.topic_names()))
    if "topic" in given:
        names = catalogue.topic_names() if topics is None else topics
        topics = frozenset(name for name in names if fnmatchcase(name, given["topic"]))
    elif "type" not in given:
        topics = None
    words = tuple(given.get("q", "").split())
    if len(words) > _MAX_WORDS:
        raise Problem(400, f"?q= has {len(words)} words: the maximum is {_MAX_WORDS}.")
    selection = Selection(
        topics=topics,
        types=frozenset({given["type"]}) if "type" in given else None,
        from_ns=read_time(given["from"], time.time_ns()) if "from" in given else None,
        to_ns=read_time(given["to"], time.time_ns()) if "to" in given else None,
        min_ns=_nanoseconds(given["min_duration"]) if "min_duration" in given else None,
        tags=(given["tag"],) if "tag" in given else (),
        words=words,
        searched=searched,
    )
    return Listing(selection, sort, text)


def _nanoseconds(text: str) -> int:
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if not 0 <= seconds < 1e9:
        raise Problem(400, f"?min_duration={text[:40]} is not a number of seconds.")
    return round(seconds * 1e9)


class ListedBags(BagBase):
    """Base class of the container of recordings: whole, or a page of a selection.

    The history, and recordings in progress or waiting, are on its first page if nothing is selected.
    """

    _listing = Listing()
    _place: PagePosition | None = None

    @property
    def variant_key(self) -> Hashable:
        return self._place, self._listing.query

    @property
    def query(self) -> str:
        page = () if self._place is None else (page_query(self._place.token),)
        return "&".join((*((self._listing.query,) if self._listing.query else ()), *page))

    @property
    def _sequence(self) -> str:
        return f"{self.url}?{self._listing.query}" if self._listing.query else self.url

    async def select_variant(self, exchange: Exchange) -> Resource:
        """Return the selected page or selection; redirect to the first of many pages (303)."""
        if exchange.method not in ("GET", "HEAD"):
            return self
        token = exchange.query.get("page")
        found = self.variant(
            _listing=read_listing(exchange.query, self.recordings.catalogue, exchange.permissions),
            _place=None if token is None else parse_position(token),
        )
        if token is None:
            require_page(exchange, self.url, found._count(), PAGE)
        return found

    async def state(self) -> State:
        page, rows = (None, self._rows(0, -1)) if self._place is None else self._page(self._place)
        own = self._own_names() if self._place is None or self._place.after == 0 else ()
        members = tuple(map(self.space.bag, (*own, *(row.name for row in rows))))
        versions = tuple(row.version for row in rows)
        version = members, versions, tuple(self.session.graph.topics)  # the form on the page lists the topics

        def make() -> State:
            document = container_document(self.url, members, "Recordings")
            if page is None:
                return State(lambda: document, part=self._listing.query and "selected")
            return State(lambda: page.add_to(document), part=page.part, headers=page.headers(self.links))

        return self.states.get_or_make(self._sequence if page is None else page.url, version, make)

    def ldp_page(self, place: PagePosition) -> LdpPage:
        """Return the page at a position."""
        return self._page(place)[0]

    def navigation_links(self) -> tuple[SequenceLink, ...]:
        return () if self._place is None else self.ldp_page(self._place).neighbours()

    def listing(self) -> MemberColumns:
        rows = self._rows(0, -1) if self._place is None else self._page(self._place)[1]
        by_url = {self.space.bag(row.name): row for row in rows}
        return MemberColumns(
            _COLUMNS,
            {url: self._cells(row) for url, row in by_url.items()},
            self._count(),
            {url: row.name for url, row in by_url.items()},
            frozenset(url for url, row in by_url.items() if not row.is_readable),
            is_sorted=True,
        )

    def page(
        self, site: Site, state: State, forms: Sequence[Form], csrf: Csrf, notices: Sequence[Notice]
    ) -> Page | bytes:
        """Return its page with a form of filters."""
        page, given = super().page(site, state, forms, csrf, notices), dict(parse_qsl(self._listing.query))
        fields = tuple(
            FilterField(
                each.name,
                _LABELS.get(each.name, each.name.capitalize()),
                given.get(each.name, ""),
                _SORTS if each.name == "sort" else (),
                "number" if each.name == "min_duration" else "text",
            )
            for each in FILTERS
        )
        return replace(page, filters=fields) if isinstance(page, Page) else page

    def _cells(self, row: Row) -> tuple[Cell, ...]:
        problem = row.problem or ("its file has vanished" if row.is_missing else "")
        seconds = f"{(row.end_ns - row.start_ns) / 1e9:,.1f} s" if row.count else ""
        tags = ", ".join(self.recordings.catalogue.tags(row.id))
        start = time_cell(row.start_ns if row.count else None)
        return start, seconds, f"{row.count:,}", f"{row.size / 1e6:,.1f} MB", tags, problem

    def _own_names(self) -> tuple[str, ...]:
        """Return the names of recordings that are not catalogued."""
        if not self._listing.selection.is_everything:
            return ()
        history = self.recordings.history
        own = (history.recording.name,) if history.is_enabled else ()
        return tuple(dict.fromkeys((*own, *self.recordings.running, *self.recordings.armed)))

    def _count(self) -> int:
        return len(self._own_names()) + self.recordings.catalogue.number_of(self._listing.selection)

    def _rows(self, start: int, limit: int) -> list[Row]:
        return list(self.recordings.catalogue.rows(self._listing.selection, self._listing.sort, start, limit))

    def _page(self, place: PagePosition) -> tuple[LdpPage, list[Row]]:
        """Return a page and its catalogued recordings; a position is a number of recordings."""
        after = place.after if isinstance(place.after, int) else 0
        count, own, limit = self._count(), len(self._own_names()), place.limit
        keys = range(after + 1, min(after + limit + 1, count) + 1)
        before = range(after, max(0, after - limit - 1), -1)
        last = last_position(limit, count, range(count, count - last_page_size(count, limit) - 1, -1))
        rows = self._rows(max(after - own, 0), limit - own if after == 0 else limit)
        return page_of(self._sequence, place, keys, before, last), rows
