"""Path items: the operations of resources in `/openapi.json` (OpenAPI 3.1.1, 4.8.9), and the parts of that document."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from typing import TypeVar
from urllib.parse import quote

from msgspec import Struct, field

from rosld.server.http.fields import Link
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import BOOLEAN, TEXT, JsonSchema
from rosld.server.rest.formats import FORMATS, OFFERS

ANY_TYPE = "*/*"
BYTES = "application/octet-stream"


class QueryParameter(Struct, frozen=True):
    """A query parameter (4.8.12)."""

    name: str
    about: str
    schema: JsonSchema = field(default_factory=lambda: TEXT)
    required: bool = False

    @property
    def is_list(self) -> bool:
        """Whether the parameter may be repeated."""
        return self.schema.get("type") == "array"


FORMAT = QueryParameter(
    "format", "The requested representation; overrides Accept.", {"type": "string", "enum": [*FORMATS]}
)
FIELD = QueryParameter("field", "The path of one field, such as `pose.position.x`, whose bytes are returned.")
PAGE = QueryParameter("page", "The page of messages, counted from 0.", {"type": "integer", "minimum": 0})
DRY_RUN = QueryParameter(
    "dry-run", "Whether to only plan and check the write: returns 200 with the plan and changes nothing.", BOOLEAN
)
OF_EVERY_WRITE = (FORMAT, DRY_RUN)
"""Parameters of every write."""
FIELD_READS = (*OFFERS, BYTES, "text/plain")
"""Media types of a value with `FIELD`."""


_DONE = {"PUT": (200, 201, 204), "POST": (200, 201, 204), "PATCH": (200, 201, 204), "DELETE": (204,)}
"""Default statuses of success."""


class WriteMethod(Struct, frozen=True):
    """Request and response of a method that writes.

    `note` says what it does, `ends` when that is over and how to wait for it. `sends` is the schema of its JSON,
    `accepts` are its media types if they differ from the current ones of the resource. `done` are the statuses of
    success if they differ from the usual ones of the method, `shows` is the `application/json` of the response.
    """

    note: str | None = None
    sends: JsonSchema | None = None
    ends: str | None = None
    is_body_required: bool = True
    done: tuple[int, ...] | None = None
    shows: JsonSchema | None = None
    query: tuple[QueryParameter, ...] = ()
    accepts: tuple[str, ...] | None = None

    def statuses(self, method: str) -> tuple[int, ...]:
        """Return the statuses of success."""
        return self.done or _DONE[method]


USUAL_STATUSES = WriteMethod()
"""Default description of a method."""


class PathItem(Struct, frozen=True):
    """The operations of a URL, or of each URL that matches a template.

    `reads` are the media types of GET, `plain` is the schema of `application/json` among them (None: JSON-LD), `query`
    are the parameters of GET. `streams`: changes are available as an event stream. `methods` are the possible methods,
    if there are more than the current ones.
    """

    summary: str
    reads: tuple[str, ...] = OFFERS
    plain: JsonSchema | None = None
    query: tuple[QueryParameter, ...] = (FORMAT,)
    writes: Mapping[str, WriteMethod] = field(default_factory=dict)
    streams: bool = True
    has_shape: bool = False
    """Whether `?shape` returns the shape of writable content."""
    is_paged: bool = False
    """Whether it is a container that may be paged: GET then takes `page` and the preferences of LDP."""
    members: Mapping[str, str] = field(default_factory=dict)
    """URLs of the sources of JSON members, by member name: members with an unreadable source are hidden."""
    methods: frozenset[str] | None = None

    def write(self, method: str) -> WriteMethod:
        """Return the description of a method that writes."""
        return self.writes.get(method, USUAL_STATUSES)

    @property
    def is_document(self) -> bool:
        """Whether the resource has only RDF representations."""
        return self.plain is None and self.streams and self.reads == OFFERS

    @property
    def has_value(self) -> bool:
        """Whether there is a changing value for conditions."""
        return self.plain is not None and self.streams

    @property
    def shared_query(self) -> tuple[str, ...]:
        """Names of the parameters of GET that are shared with other URLs."""
        names = (
            *(("page",) if self.is_paged else ()),
            *(("shape",) if self.has_shape else ()),
            *(("until",) if self.has_value else ()),
            *(("offer", "after", "timeout", "rate") if self.streams else ()),
        )
        own = {each.name for each in self.query}
        return tuple(name for name in names if name not in own)


MAX_PART = 100_000
"""Maximum number of bytes of a part, in JSON."""
PART_QUERY = (
    QueryParameter(
        "below",
        "A path or URL prefix, such as `/topics/arm/`: only what begins with it, in parts of at most 100 kB.",
        {"type": "string", "pattern": "^(/|https?:)"},
    ),
    QueryParameter("part", "The number of the part, counted from 0.", {"type": "integer", "minimum": 0}),
)
PUNCTUATION = 6
"""Bytes between the members of an object."""
_MAX_DIGITS = 6
_T = TypeVar("_T")
_K = TypeVar("_K", bound=Hashable)


def cut_parts(members: Iterable[tuple[_T, int, Mapping[_K, int]]], room: int) -> Iterator[list[_T]]:
    """Split members into parts that fit, each with at least one.

    With each member come its size and the sizes of what it needs, which is in a part once.
    """
    part: list[_T] = []
    shared: set[_K] = set()
    size = 0
    for one, own, needed in members:
        more = own + sum(each for key, each in needed.items() if key not in shared)
        if part and size + more > room:
            yield part
            part, shared, size, more = [], set(), 0, own + sum(needed.values())
        part.append(one)
        shared.update(needed)
        size += more
    if part:
        yield part


class PartRequest(Struct, frozen=True):
    """A requested part: its number, among the parts of the paths that begin with `below`."""

    below: str
    number: int

    def url(self, url: str, number: int) -> str:
        """Return the URL of a part of the description at `url`."""
        return part_url(url, self.below, number)

    def links(self, url: str, count: int) -> Iterator[Link]:
        """Yield links from this part, of `count`, to its neighbours (RFC 8288)."""
        if self.number:
            yield Link(self.url(url, self.number - 1), "prev")
        if self.number + 1 < count:
            yield Link(self.url(url, self.number + 1), "next")

    def choose(self, parts: Sequence[bytes]) -> bytes:
        """Return the requested part. Raises a 404 Problem if there is none."""
        if not parts:
            raise Problem(404, f"No described path begins with {self.below}: send a shorter ?below=.")
        if self.number >= len(parts):
            raise Problem(404, f"?part={self.number} does not exist: the parts are 0 to {len(parts) - 1}.")
        return parts[self.number]


def part_url(url: str, below: str, number: int = 0) -> str:
    """Return the URL of a part of the description at `url`, which may have a query."""
    suffix = f"&part={number}" if number else ""
    return f"{url}{'&' if '?' in url else '?'}below={quote(below, safe='/')}{suffix}"


def parse_part(query: Mapping[str, str], base: str) -> PartRequest | None:
    """Return the part that a query requests, None for the whole document. Raises a 400 Problem.

    `below` is a path, or a URL below `base`.
    """
    if "below" not in query and "part" not in query:
        return None
    below, number = query.get("below", "/"), query.get("part", "0")
    if below.startswith(base):
        below = below[len(base) - 1 :]
    if not below.startswith("/"):
        raise Problem(400, f"?below={below[:100]} is not a path: begin it with a slash, such as /topics/.")
    if not (number.isascii() and number.isdigit() and len(number) <= _MAX_DIGITS):
        raise Problem(400, f"?part={number[:100]} is not a part number: send 0 or more.")
    return PartRequest(below, int(number))
