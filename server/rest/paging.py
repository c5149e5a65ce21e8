"""Pages of containers, and the selection of a container's parts by preferences (LDP 7.2)."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Hashable, Sequence
from typing import TypeAlias
from urllib.parse import quote, unquote, urlsplit

from msgspec import Struct
from msgspec.structs import replace
from pyoxigraph import NamedNode, Triple

from rosld.ontology.document import Document
from rosld.ontology.triples import text, triples_about
from rosld.ontology.vocab import ldp, rdf, rdfs, xhv
from rosld.server.html.page import SequenceLink
from rosld.server.http.conditional import digest
from rosld.server.http.fields import Link, render_links, to_uri
from rosld.server.http.negotiation import Preferences, preference_applied
from rosld.server.http.problem import Problem
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.resource import BASIC_CONTAINER, RDF_SOURCE, RESOURCE, Resource

_CONTAINMENT = f"{ldp.iri}PreferContainment"
_MEMBERSHIP = f"{ldp.iri}PreferMembership"
_MINIMAL = f"{ldp.iri}PreferMinimalContainer"
_EMPTY = f"{ldp.iri}PreferEmptyContainer"
"""Name of the minimal container in drafts of LDP."""
_KNOWN = frozenset({_CONTAINMENT, _MEMBERSHIP, _MINIMAL})


class ContainerParts(Struct, frozen=True):
    """Parts in a representation of a container. `applied`: a preference selected them, which the response states."""

    containment: bool = True
    membership: bool = True
    minimal: bool = True
    applied: bool = False

    @property
    def all(self) -> bool:
        """Whether nothing is left out."""
        return self.containment and self.membership and self.minimal

    @property
    def variant(self) -> str:
        """Short name of the omitted parts, empty if there are none: different representations need different ETags."""
        held = ((self.containment, "c"), (self.membership, "m"), (self.minimal, "s"))
        return "".join(letter for is_held, letter in held if not is_held)

    @property
    def preference_applied(self) -> str | None:
        """Value of Preference-Applied (RFC 7240 3), None if no preference was applied."""
        return preference_applied("return=representation") if self.applied else None


ALL_PARTS = ContainerParts()


def select_parts(preferences: Preferences) -> ContainerParts:
    """Return the parts that `include` and `omit` of return=representation select (LDP 7.2.2).

    Omitted parts are left out. With an inclusion, members and membership must be included explicitly; the other
    statements of the container remain unless omitted by name, because they define the membership triples. Contradicting
    hints (which 7.2.2.3 leaves open) and unknown ones are ignored.
    """
    include, omit = _hints(preferences.include), _hints(preferences.omit)
    include, omit = include - omit, omit - include
    if not include and not omit:
        return ContainerParts(applied=True) if preferences.representation else ALL_PARTS
    return ContainerParts(
        containment=_is_wanted(_CONTAINMENT, include, omit),
        membership=_is_wanted(_MEMBERSHIP, include, omit),
        minimal=_MINIMAL not in omit,
        applied=True,
    )


def _hints(uris: frozenset[str]) -> frozenset[str]:
    return frozenset(_MINIMAL if uri == _EMPTY else uri for uri in uris) & _KNOWN


def _is_wanted(hint: str, include: frozenset[str], omit: frozenset[str]) -> bool:
    return hint in include if include else hint not in omit


MAX_PAGE_SIZE = 1000
"""Maximum number of members on a page; larger containers are paged."""
Key: TypeAlias = "int | str"
"""Sort key of members: a number, or a name as in URLs (for a container with its slash)."""
_TOKEN = re.compile(r"(0|[1-9][0-9]{0,17})(?:-([1-9][0-9]{0,3}))?")
_NAMED = re.compile(r"([1-9][0-9]{0,3})?:([!-~]{1,4096})")
_COUNT = re.compile(r"0*([1-9][0-9]{0,8})")


class PagePosition(Struct, frozen=True):
    """Position of a page: `limit` members after the number or name `after`; 0 is before all of them."""

    after: Key = 0
    limit: int = MAX_PAGE_SIZE

    @property
    def token(self) -> str:
        """Value of `?page=`."""
        limit = "" if self.limit == MAX_PAGE_SIZE else str(self.limit)
        if isinstance(self.after, str):
            return f"{limit}:{self.after}"
        return f"{self.after}-{limit}" if limit else str(self.after)


class LdpPage(Struct, frozen=True):
    """A page of the container at URL `container`: its own token and those of its neighbours, None for missing ones."""

    container: str
    token: str
    first: str
    prev: str | None = None
    next: str | None = None
    last: str | None = None

    @property
    def url(self) -> str:
        """URL of the page."""
        return page_url(self.container, self.token)

    def neighbours(self) -> tuple[SequenceLink, ...]:
        """Return the known neighbours: first, prev, next and last."""
        tokens = {"first": self.first, "prev": self.prev, "next": self.next, "last": self.last}
        return tuple(
            SequenceLink(rel, page_url(self.container, token)) for rel, token in tokens.items() if token is not None
        )

    def links(self, etag: str | None = None) -> tuple[Link, ...]:
        """Return the links of a page: its type, its neighbours, and its container.

        The link to the container has its entity tag (`"x"` or `x`), so that clients notice changes between pages.
        """
        noted = () if etag is None else (("etag", etag.removeprefix('"').removesuffix('"')),)
        return (
            Link(ldp.Page.value, "type"),
            *(Link(step.url, step.rel) for step in self.neighbours()),
            Link(self.container, "canonical", attributes=noted),
        )

    def add_to(self, document: Document) -> Document:
        """Return a document of the members on this page with the triples of the page."""
        return replace(document, triples=(*document.triples, *self.triples()))

    @property
    def part(self) -> str:
        """Short name of the page, for ETags."""
        return f"p{digest(self.token.encode())}"

    def headers(self, links: Sequence[Link]) -> dict[str, str]:
        """Return the headers of the page of a container that has these links."""
        return {"link": render_links([*links, *self.links()]), "vary": "Accept, Prefer"}

    def triples(self) -> list[Triple]:
        """Return the triples of the page."""
        relations = {"first": xhv.first, "prev": xhv.prev, "next": xhv.next, "last": xhv.last}
        return triples_about(
            NamedNode(self.url),
            (rdf.type, ldp.Page),
            (rdfs.label, text(f"Page of {unquote(urlsplit(self.container).path)}")),
            (ldp.pageSequence, NamedNode(self.container)),
            *((relations[step.rel], NamedNode(step.url)) for step in self.neighbours()),
        )


class PagedContainer(Resource):
    """Base of containers that come in pages if they have many members."""

    links: tuple[Link, ...] = (RESOURCE, RDF_SOURCE, BASIC_CONTAINER)
    _place: PagePosition | None = None
    """Position of the requested page, or None for the whole container."""

    def ldp_page(self, place: PagePosition) -> LdpPage | None:
        """Return the page at a position, or None without a container."""
        raise NotImplementedError

    @property
    def variant_key(self) -> Hashable:
        return self._place

    @property
    def query(self) -> str:
        return "" if self._place is None else page_query(self._place.token)

    def navigation_links(self) -> tuple[SequenceLink, ...]:
        page = None if self._place is None else self.ldp_page(self._place)
        return () if page is None else page.neighbours()


def require_page(exchange: Exchange, container: str, count: int, most: int = MAX_PAGE_SIZE) -> None:
    """Raise the 303 to the first page if the response must be paged, which has at most `most` members."""
    query = exchange.request.scope["query_string"].decode("latin-1")
    first = redirect_to_first(container, count, exchange.prefer, query, most)
    if first is not None:
        raise first


def page_url(container: str, token: str) -> str:
    """Return the URL of a page of a container, whose own URL may have a query."""
    return f"{container}{'&' if '?' in container else '?'}{page_query(token)}"


def page_query(token: str) -> str:
    """Return the query string of a page."""
    return f"page={quote(token, safe=':/')}"


def parse_position(token: str) -> PagePosition:
    """Return the position among numbered members in `?page=`. Raises a 404 Problem for an invalid one."""
    found = _TOKEN.fullmatch(token)
    if found is None or int(found[2] or 1) > MAX_PAGE_SIZE:
        raise _no_page(token)
    return PagePosition(int(found[1]), int(found[2] or MAX_PAGE_SIZE))


def parse_named_position(token: str) -> PagePosition:
    """Return the position among members ordered by name in `?page=`. Raises a 404 Problem for an invalid one."""
    found = _NAMED.fullmatch(token)
    if found is None:
        place = parse_position(token)
        if place.after != 0:
            raise _no_page(token)
        return place
    if int(found[1] or 1) > MAX_PAGE_SIZE:
        raise _no_page(token)
    return PagePosition(found[2], int(found[1] or MAX_PAGE_SIZE))


def _no_page(token: str) -> Problem:
    return Problem(404, f"?page={token[:100]} is not a page of this container: follow the links from ?page=0.")


def page_of_names(container: str, place: PagePosition, names: Sequence[str]) -> tuple[LdpPage, Sequence[str]]:
    """Return the page at a position, and its part of `names`, the sorted names of all members."""
    start = bisect_right(names, place.after) if isinstance(place.after, str) else 0
    limit = place.limit
    found, before = names[start : start + limit + 1], names[max(0, start - limit - 1) : start]
    last = last_position(limit, len(names), names[: -last_page_size(len(names), limit) - 2 : -1])
    return page_of(container, place, found, before[::-1], last), found[:limit]


def page_of(
    container: str,
    place: PagePosition,
    keys: Sequence[Key],
    before: Sequence[Key] = (),
    last: PagePosition | None = None,
) -> LdpPage:
    """Return the page at a position; `keys` are those of the following members, one more than a page if possible.

    The additional key shows whether there is a `next` page. `before` are the preceding keys in reverse order, one more
    than a page if possible, so that the previous page ends where this one begins; if there is less than a page, the
    previous one is the first. `last` is the position of the last page, if known.
    """
    next_ = PagePosition(keys[place.limit - 1], place.limit) if len(keys) > place.limit else None
    prev = PagePosition(before[place.limit] if len(before) > place.limit else 0, place.limit) if before else None
    final = last if next_ is not None else place
    return LdpPage(
        container,
        place.token,
        PagePosition(0, place.limit).token,
        None if prev is None else prev.token,
        None if next_ is None else next_.token,
        None if final is None else final.token,
    )


def last_page_size(count: int, limit: int) -> int:
    """Return the number of members on the last page of `count`, counted from the first page."""
    return (count - 1) % limit + 1 if count else 0


def last_position(limit: int, count: int, latest: Sequence[Key]) -> PagePosition:
    """Return the position of the last page of `count` members.

    `latest` are the keys of the last members in reverse order, one more than on that page if possible.
    """
    left = last_page_size(count, limit)
    return PagePosition(latest[left] if len(latest) > left else 0, limit)


def requested_page_size(preferences: Preferences) -> int | None:
    """Return max-member-count of return=representation, at most `MAX_PAGE_SIZE`, or None."""
    if not preferences.representation:
        return None
    parameters = dict(reversed(preferences.named["return"].parameters))
    found = _COUNT.fullmatch(parameters.get("max-member-count", ""))
    return None if found is None else min(MAX_PAGE_SIZE, int(found[1]))


def redirect_to_first(
    container: str, count: int, preferences: Preferences, query: str = "", most: int = MAX_PAGE_SIZE
) -> Problem | None:
    """Return the 303 to the first page of a container of `count` members, None if it needs no paging.

    It is paged if it has more members than `most`, or than the request prefers. The other parameters in
    `query` (such as `format=ttl`) are retained.
    """
    limit = requested_page_size(preferences) or most
    if count <= limit:
        return None
    first = page_url(container, PagePosition(0, limit).token) + (f"&{query}" if query else "")
    return Problem(
        303,
        f"It has {count} members, listed in pages; the first is {first}",
        title="See Other",
        headers={"Location": to_uri(first), "Vary": "Accept, Prefer"},
    )
