"""Parts of a large description: what it tells of paths below one (`?below=`), cut to a size (`?part=`). Pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from urllib.parse import quote

from rosld.server.http.fields import Link
from rosld.server.http.problem import Problem
from rosld.server.rest.path_item import QueryParameter

MAX_PART = 100_000
"""Bytes of a part, in JSON."""
PART_QUERY = (
    QueryParameter(
        "below",
        "A path, such as `/topics/arm/`: only what begins with it, in parts of 100 kB at the most.",
        {"type": "string", "pattern": "^/"},
    ),
    QueryParameter("part", "The number of a part, from 0.", {"type": "integer", "minimum": 0, "maximum": 999_999}),
)
_MAX_DIGITS = 6


@dataclass(frozen=True, slots=True)
class PartRequest:
    """Which part is asked for: the one of this number, of what is told of paths that begin with `below`."""

    below: str
    number: int

    def url(self, url: str, number: int) -> str:
        """The URL of a part of the description at `url`."""
        return part_url(url, self.below, number)

    def links(self, url: str, count: int) -> Iterator[Link]:
        """Links from this part, of `count`, to its neighbours (RFC 8288)."""
        if self.number:
            yield Link(self.url(url, self.number - 1), "prev")
        if self.number + 1 < count:
            yield Link(self.url(url, self.number + 1), "next")

    def choose(self, parts: Sequence[bytes]) -> bytes:
        """The part that is asked for. Raises a 404 Problem where there is none."""
        if not parts:
            raise Problem(
                404, f"Nothing that is described here begins with {self.below}: send ?below= with a shorter one."
            )
        if self.number >= len(parts):
            raise Problem(404, f"?part={self.number}: there are {len(parts)} parts, from 0 to {len(parts) - 1}.")
        return parts[self.number]


def part_url(url: str, below: str, number: int = 0) -> str:
    """The URL of a part of the description at `url`, which may have a query."""
    suffix = f"&part={number}" if number else ""
    return f"{url}{'&' if '?' in url else '?'}below={quote(below, safe='/')}{suffix}"


def parse_part(query: Mapping[str, str]) -> PartRequest | None:
    """The part that a query asks for, None where it asks for the whole. Raises a 400 Problem."""
    if "below" not in query and "part" not in query:
        return None
    below, number = query.get("below", "/"), query.get("part", "0")
    if not below.startswith("/"):
        raise Problem(400, f"?below={below[:100]} is no path: begin it with a slash, such as /topics/.")
    if not (number.isascii() and number.isdigit() and len(number) <= _MAX_DIGITS):
        raise Problem(400, f"?part={number[:100]} is no number of a part: send one from 0.")
    return PartRequest(below, int(number))
