"""Mapping of names to URLs and back. Pure.

Each segment of a ROS name is one percent-encoded segment of the path (UTF-8). Three segments cannot be in a URL
unchanged: the empty one (it would look like the slash of a container) and `.` and `..` (clients remove them, and `%2E`
too: RFC 3986 5.2.4, WHATWG URL "dot segments"). They are prefixed with `~`, and so is every segment that looks like one
of these: `~`, `~.`, `~..`, `~~`, ... So `/a//b` is `a/~/b`, and no two names share a URL.
"""

from __future__ import annotations

import re
from functools import lru_cache
from typing import NamedTuple
from urllib.parse import quote, unquote_to_bytes, urlsplit

from msgspec import Struct

from rosld.adapters.model import Schema, TypeRef, halves_of, names

TYPES = "https://w3id.org/rosld/types/"

_PLAIN = re.compile(r"[A-Za-z0-9_-]+")
_ESCAPED = re.compile(r"~*\.{0,2}")
_MALFORMED = re.compile(r"%(?![0-9A-Fa-f]{2}).{0,2}", re.DOTALL)


@lru_cache(maxsize=8192)
def encode_segment(segment: str) -> str:
    """Encode a segment for a path. Raises ValueError for lone surrogates, which UTF-8 cannot encode."""
    text = "~" + segment if _ESCAPED.fullmatch(segment) else segment
    try:
        return quote(text, safe="")
    except UnicodeEncodeError as error:
        raise ValueError(f"{segment!r} contains a lone surrogate, which URLs cannot contain") from error


def decode_segment(raw: str) -> str:
    """Return the segment written as `raw`: the inverse of `encode_segment`.

    Raises ValueError for a malformed escape, for bytes that are not UTF-8, and for an empty or dot segment.
    """
    if _PLAIN.fullmatch(raw):
        return raw
    if malformed := _MALFORMED.search(raw):
        raise ValueError(f"malformed percent-escape {malformed[0]!r} in {raw!r}: write '%25' for a percent sign")
    try:
        text = unquote_to_bytes(raw).decode()
    except UnicodeDecodeError as error:
        raise ValueError(f"{raw!r} is not percent-encoded UTF-8: {error.reason} at byte {error.start}") from error
    if not _ESCAPED.fullmatch(text):
        return text
    if not text.startswith("~"):
        raise ValueError(f"a path segment cannot be {text!r}: write '~{text}' where a name has such a segment")
    return text[1:]


class Location(NamedTuple):
    """The target of a path: `kind` is its first segment (`topics`; empty for `/`), `segments` the other ones, decoded.

    `is_container`: the path ends in a slash. `/` itself is a container of the empty kind.
    """

    kind: str
    segments: tuple[str, ...]
    is_container: bool

    @property
    def name(self) -> str:
        """The global ROS name (`/camera/image_raw`), or the namespace of a container.

        Raises ValueError if a segment contains a slash (`%2F`), which no ROS name does.
        """
        for segment in self.segments:
            if "/" in segment:
                raise ValueError(
                    f"the segment {segment!r} contains a slash: write each part of a ROS name as its own segment"
                )
        return names.join(self.segments)


def locate(raw_path: str | bytes) -> Location:
    """Return the location of a path (below the base, with leading slash, percent-encoded).

    Raises ValueError with the malformed segment.
    """
    try:
        path = raw_path.decode() if isinstance(raw_path, bytes) else raw_path
    except UnicodeDecodeError as error:
        raise ValueError(f"the path {raw_path!r} is not UTF-8: {error.reason} at byte {error.start}") from error
    if not path.startswith("/"):
        raise ValueError(f"the path {path!r} must begin with '/'")
    kind, *rest = path[1:].split("/")
    if not rest:
        return Location(decode_segment(kind) if kind else "", (), not kind)
    is_container = rest[-1] == ""
    segments = rest[:-1] if is_container else rest
    return Location(decode_segment(kind), tuple(map(decode_segment, segments)), is_container)


class Space(Struct, frozen=True):
    """The URLs of one server. `base` ends in a slash; `types` is the namespace of the classes of message types.

    Every method raises ValueError for names that are not global ROS names or contain lone surrogates.
    """

    base: str
    types: str = TYPES

    def __post_init__(self) -> None:
        parts = urlsplit(self.base)
        if not (parts.scheme and parts.netloc and self.base.endswith("/")) or parts.query or parts.fragment:
            raise ValueError(f"the base {self.base!r} must be an absolute URL that ends in '/', such as 'http://host/'")

    @property
    def path(self) -> str:
        """The path of the base: `/`, or the path prefix of a proxy."""
        return urlsplit(self.base).path

    def absolute(self, reference: str) -> str:
        """Return the absolute URL of a reference: a URL of this space is unchanged, others are paths below the base."""
        if reference.startswith(self.base):
            return reference
        return self.base + reference.removeprefix(self.path).removeprefix("/")

    def location(self, url: str) -> Location | None:
        """Return the location of a URL of this space, ignoring query and fragment; None for other URLs."""
        if not url.startswith(self.base):
            return None
        path = url[len(self.base) - 1 :].partition("#")[0].partition("?")[0]
        try:
            return locate(path)
        except ValueError:
            return None

    def url(self, kind: str, segments: tuple[str, ...]) -> str:
        """Return the URL of a leaf: `kind` and the segments below it."""
        return self.base + "/".join((kind, *map(encode_segment, segments)))

    def container(self, kind: str, namespace: tuple[str, ...] = ()) -> str:
        """Return the URL of the container of a namespace: `topics/` and its segments, ending in a slash."""
        return self.url(kind, namespace) + "/"

    def _leaf_url(self, kind: str, name: str) -> str:
        if not name.startswith("/"):
            raise ValueError(f"{name!r} is not a global ROS name: it must begin with '/'")
        # Not names.segments: as a leaf, "/" is one empty segment, so that it never shares the URL of the container.
        return self.url(kind, tuple(name[1:].split("/")))

    def node(self, name: str) -> str:
        """Return the URL of a node: `nodes/talker` for `/talker`."""
        return self._leaf_url("nodes", name)

    def topic(self, name: str) -> str:
        """Return the URL of a topic: `topics/camera/image_raw` for `/camera/image_raw`."""
        return self._leaf_url("topics", name)

    def service(self, name: str) -> str:
        """Return the URL of a service: `services/aircraft/start` for `/aircraft/start`."""
        return self._leaf_url("services", name)

    def parameter(self, name: str, node: str | None = None) -> str:
        """Return the URL of a parameter; if it belongs to a node (ROS 2), its whole name is one segment below that."""
        if node is None:
            return self._leaf_url("parameters", name)
        return self._leaf_url("parameters", node) + "/" + encode_segment(name)

    def type(self, ref: TypeRef | str) -> str:
        """Return the URL of a type: `types/geometry_msgs/msg/Twist`; a hash selects that variant."""
        name, hash = (ref, None) if isinstance(ref, str) else (ref.name, ref.hash)
        return self.url("types", tuple(name.split("/"))) + (f"?hash={quote(hash, safe='')}" if hash else "")

    def shape(self, name: str) -> str:
        """Return the URL of the SHACL shape of a type."""
        return self.url("shapes", tuple(name.split("/")))

    def shapes_of(self, schema: Schema) -> tuple[str, ...]:
        """Return the URLs of the SHACL shapes of the messages of a type."""
        return tuple(self.shape(half.ref.name) for half in halves_of(schema))

    def document_shape(self, name: str) -> str:
        """Return the URL of the SHACL shape of documents about a class: `shapes/documents#Topic` for `Topic`."""
        return f"{self.base}shapes/documents#{name}"

    def call(self, id: str) -> str:
        """Return the URL of a call of a service."""
        return self.url("calls", (id,))

    def action(self, name: str) -> str:
        """Return the URL of an action: `actions/aircraft/fly` for `/aircraft/fly`."""
        return self._leaf_url("actions", name)

    def goal(self, id: str) -> str:
        """Return the URL of a goal of an action."""
        return self.url("goals", (id,))

    def hold(self, id: str) -> str:
        """Return the URL of a hold of a topic."""
        return self.url("holds", (id,))

    def fault(self, id: str) -> str:
        """Return the URL of a fault of the robot."""
        return self.url("faults", (id,))

    @property
    def stop(self) -> str:
        """Return the URL of the stop of the whole robot."""
        return f"{self.base}stop"

    def activity(self, id: str) -> str:
        """Return the URL of the receipt of a write."""
        return self.url("activity", (id,))

    def query(self, name: str) -> str:
        """Return the URL of a stored query."""
        return self.url("queries", (name,))

    def cockpit(self, name: str) -> str:
        """Return the URL of a cockpit: `cockpit/default`."""
        return self.url("cockpit", (name,))

    @property
    def frames(self) -> str:
        """The URL of the frames of the robot."""
        return self.base + "frames"

    def bag(self, name: str) -> str:
        """Return the URL of a recording, a container of its parts."""
        return self.container("bags", (name,))

    def bag_messages(self, name: str) -> str:
        """Return the URL of the messages of a recording."""
        return self.container("bags", (name, "messages"))

    def bag_message(self, name: str, index: int) -> str:
        """Return the URL of message `index` of a recording."""
        return self.url("bags", (name, "messages", str(index)))

    def bag_moment(self, name: str) -> str:
        """Return the URL of all topics of a recording at one moment."""
        return self.url("bags", (name, "at"))

    def bag_stream(self, name: str) -> str:
        """Return the URL of the messages of a recording as an event stream."""
        return self.url("bags", (name, "ldes"))

    def bag_stream_page(self, name: str, page: str) -> str:
        """Return the URL of a page of that stream."""
        return self.url("bags", (name, "ldes", page))

    def class_of(self, name: str) -> str:
        """Return the class of a message or service type: an IRI in the namespace of types, not of this server."""
        return self.types + "/".join(map(encode_segment, name.split("/")))

    def type_of(self, iri: str) -> str | None:
        """Return the type whose class is an IRI; None for all other IRIs."""
        if not iri.startswith(self.types):
            return None
        return "/".join(decode_segment(each) for each in iri[len(self.types) :].split("/"))

    def property_of(self, name: str, field: str) -> str:
        """Return the property of a field (or a constant) of a type."""
        return f"{self.class_of(name)}#{quote(field, safe='')}"

    def fragment(self, document: str, *parts: str) -> str:
        """Return a node within a document: `#from/talker`; parts are encoded and joined by slashes."""
        return f"{document}#" + "/".join(quote(part, safe="") for part in parts)
