"""Pages of large containers (LDP Paging 1.0): where one begins, which are its neighbours, how that is told. Pure.

A page is named by the number of the member before its first, and members are ordered by when they were made. So
whoever follows `next` meets every member that was there all the while exactly once, whatever comes and goes meanwhile,
and the members made meanwhile come last.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from pyoxigraph import NamedNode, Triple

from rosld.ontology.triples import about
from rosld.ontology.vocab import ldp, rdf, xhv
from rosld.server.html import Step
from rosld.server.http.link import Link, uri
from rosld.server.http.prefer import Preferences
from rosld.server.http.problem import Problem

MOST = 1000
"""Members of one page; a container with more comes in pages."""
_TOKEN = re.compile(r"(0|[1-9][0-9]{0,17})(?:-([1-9][0-9]{0,3}))?")
_COUNT = re.compile(r"0*([1-9][0-9]{0,8})")


@dataclass(frozen=True, slots=True)
class Place:
    """The members made after number `after`, of which a page tells `most`."""

    after: int = 0
    most: int = MOST

    @property
    def token(self) -> str:
        """What stands for it in `?page=`."""
        return str(self.after) if self.most == MOST else f"{self.after}-{self.most}"


@dataclass(frozen=True, slots=True)
class Page:
    """A page of the container at URL `container`: its own token and those of its neighbours, None where it has none."""

    container: str
    token: str
    first: str
    prev: str | None = None
    next: str | None = None
    last: str | None = None

    @property
    def url(self) -> str:
        """Its URL."""
        return page_url(self.container, self.token)

    def steps(self) -> tuple[Step, ...]:
        """The neighbours: first, prev, next and last, as far as they are known and there."""
        tokens = {"first": self.first, "prev": self.prev, "next": self.next, "last": self.last}
        return tuple(Step(rel, page_url(self.container, token)) for rel, token in tokens.items() if token is not None)

    def links(self, etag: str | None = None) -> tuple[Link, ...]:
        """The links of every answer with it, beside those of the container: that it is a page, its neighbours, and the
        container it is a page of, with the container's entity tag (`"x"` or `x`), so that a change is noticed."""
        noted = () if etag is None else (("etag", etag.removeprefix('"').removesuffix('"')),)
        return (
            Link(ldp.Page.value, "type"),
            *(Link(step.url, step.rel) for step in self.steps()),
            Link(self.container, "canonical", attributes=noted),
        )

    def triples(self) -> list[Triple]:
        """The same in RDF."""
        relations = {"first": xhv.first, "prev": xhv.prev, "next": xhv.next, "last": xhv.last}
        return about(
            NamedNode(self.url),
            (rdf.type, ldp.Page),
            (ldp.pageSequence, NamedNode(self.container)),
            *((relations[step.rel], NamedNode(step.url)) for step in self.steps()),
        )


def page_url(container: str, token: str) -> str:
    """The URL of a page of a container."""
    return f"{container}?page={token}"


def read_place(token: str) -> Place:
    """The place that `?page=` names; a 404 Problem for what names none."""
    found = _TOKEN.fullmatch(token)
    if found is None or int(found[2] or 1) > MOST:
        raise Problem(404, f"?page={token[:100]} is no page of this container: follow the links from ?page=0.")
    return Place(int(found[1]), int(found[2] or MOST))


def page_of(container: str, place: Place, numbers: Sequence[int]) -> Page:
    """The page at a place, where `numbers` are those of the members after it: one more than it tells, if there are.

    So the last page has no `next`, though it be full.
    """
    more = len(numbers) > place.most
    after = Place(numbers[place.most - 1], place.most) if more else None
    return Page(container, place.token, Place(0, place.most).token, next=None if after is None else after.token)


def most_asked(preferences: Preferences) -> int | None:
    """The members of a page that a request prefers: max-member-count of return=representation, None where there is
    none, at most `MOST`."""
    if not preferences.representation:
        return None
    parameters = dict(reversed(preferences.named["return"].parameters))
    found = _COUNT.fullmatch(parameters.get("max-member-count", ""))
    return None if found is None else min(MOST, int(found[1]))


def first_page(container: str, count: int, preferences: Preferences) -> Problem | None:
    """The 303 to the first page of a container of `count` members, None where it is told at once.

    It comes in pages where it has more members than `MOST`, or than the request prefers.
    """
    most = most_asked(preferences) or MOST
    if count <= most:
        return None
    first = page_url(container, Place(0, most).token)
    return Problem(
        303,
        f"Its {count} members come in pages; the first is {first}",
        title="See Other",
        headers={"Location": uri(first), "Vary": "Accept, Prefer"},
    )
