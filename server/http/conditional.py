"""Conditional requests (RFC 9110 13) and byte ranges (RFC 9110 14).

Entity tags are strong and have the form `"<boot>-<state>.<variant>"`: `<boot>-<state>` identifies the state of the
resource, `<variant>` the representation. If-None-Match of a read compares the whole tag; If-Match, and If-None-Match of
a write, compare only the state, so that a client that read Turtle can guard a write in JSON.
"""

from __future__ import annotations

import hashlib
import re
import secrets
from collections.abc import Sequence
from enum import Enum
from typing import Literal, TypeAlias

from msgspec import Struct

from rosld.server.http.fields import require_field_value
from rosld.server.http.problem import Problem

# Looser than RFC 9110 8.8.3: a tag with a space is not one of ours, so it matches nothing (412).
_OPAQUE = r'[^"\x00-\x08\x0a-\x1f\x7f]*'
_TAG = re.compile(rf'(W/)?"({_OPAQUE})"')
_LIST = re.compile(rf'[ \t,]*(?:W/)?"{_OPAQUE}"[ \t]*(?:,[ \t]*(?:(?:W/)?"{_OPAQUE}"[ \t]*)?)*')
_PART = re.compile(r"[0-9A-Za-z_+\-]+(?:\.[0-9A-Za-z_+\-]+)*")
_VARIANT = re.compile(r"[0-9A-Za-z_+\-]+")
_SAFE_METHODS = frozenset({"GET", "HEAD"})
_SECRET = secrets.token_bytes(32)


class ETag(Struct, frozen=True):
    """A strong entity tag: the state (`<boot>-<state>`) and the variant, which contains no dot.

    Raises ValueError for parts that could not be parsed again.
    """

    state: str
    variant: str

    def __post_init__(self) -> None:
        if not _PART.fullmatch(self.state) or not _VARIANT.fullmatch(self.variant):
            raise ValueError(f"{self.state!r} and {self.variant!r} do not form a valid entity tag")

    def __str__(self) -> str:
        return f'"{self.state}.{self.variant}"'


class ReceivedTag(Struct, frozen=True):
    """An entity tag sent by a client: its opaque text and whether it is weak."""

    opaque: str
    weak: bool = False

    @property
    def state(self) -> str:
        """State part, or the whole tag without a variant."""
        return self.opaque.rpartition(".")[0] or self.opaque


Tags: TypeAlias = "Literal['*'] | tuple[ReceivedTag, ...]"


class PreconditionResult(Enum):
    """Outcome of the preconditions; the value is the HTTP status, or 0 to proceed."""

    PROCEED = 0
    NOT_MODIFIED = 304
    PRECONDITION_FAILED = 412


def parse(text: str, name: str = "If-Match") -> Tags:
    """Return the tags of an If-Match or If-None-Match field, or "*".

    Raises a 400 Problem for a malformed list: an unreadable guard must not let the write through.
    """
    stripped = text.strip(" \t")
    if stripped == "*":
        return "*"
    if not _LIST.fullmatch(stripped):
        raise Problem(
            400,
            f'{name}: {text[:100]!r} is not a list of entity tags; an entity tag looks like "abc-1.ttl", with quotes',
        )
    return tuple(ReceivedTag(found[2], bool(found[1])) for found in _TAG.finditer(stripped))


def evaluate(
    method: str, current: ETag | None, *, if_match: str | None, if_none_match: str | None
) -> PreconditionResult:
    """Evaluate preconditions in the order of RFC 9110 13.2.2; `current` is None for a missing resource.

    If-Match uses the strong comparison (a weak tag never matches), If-None-Match the weak one. A write changes all
    representations, so that the tag of any of them is the current one (RFC 9110 13.1.2).
    """
    if if_match is not None and not _any_state(parse(if_match, "If-Match"), current):
        return PreconditionResult.PRECONDITION_FAILED
    if if_none_match is None:
        return PreconditionResult.PROCEED
    tags = parse(if_none_match, "If-None-Match")
    if method in _SAFE_METHODS:
        return PreconditionResult.NOT_MODIFIED if _any_tag(tags, current) else PreconditionResult.PROCEED
    return (
        PreconditionResult.PRECONDITION_FAILED if _any_state(tags, current, weakly=True) else PreconditionResult.PROCEED
    )


def check_preconditions(method: str, current: ETag | None, *, if_match: str | None, if_none_match: str | None) -> bool:
    """Evaluate preconditions as `evaluate` does, raising the 412 Problem; return whether to answer 304."""
    result = evaluate(method, current, if_match=if_match, if_none_match=if_none_match)
    if result is PreconditionResult.PRECONDITION_FAILED:
        raise Problem(
            412,
            "The resource is not in the state that the request requires; read it again.",
            headers={} if current is None else {"ETag": str(current)},
        )
    return result is PreconditionResult.NOT_MODIFIED


def require_if_match(if_match: str | None, why: str) -> str:
    """Return the required If-Match field. Raises a 428 Problem (RFC 6585 3) with `why` if it is missing."""
    if if_match is None:
        raise Problem(428, f"{why} Send If-Match with the ETag of the state that you read.")
    return if_match


def _any_state(tags: Tags, current: ETag | None, *, weakly: bool = False) -> bool:
    if current is None or isinstance(tags, str):
        return current is not None
    return any((weakly or not tag.weak) and tag.state == current.state for tag in tags)


def _any_tag(tags: Tags, current: ETag | None) -> bool:
    if current is None or isinstance(tags, str):
        return current is not None
    return any(f'"{tag.opaque}"' == str(current) for tag in tags)


def digest(data: bytes) -> str:
    """Return a short digest of these bytes, keyed so that nobody can use it to verify a guess of their content."""
    return hashlib.blake2b(data, digest_size=9, key=_SECRET).hexdigest()


MAX_RANGES = 32
"""Maximum number of ranges of a request: more are never needed, and the field is ignored (RFC 9110 14.2)."""
MIN_GAP = 128
"""Bytes between two ranges that are sent too: framing another part takes as many (RFC 9110 15.3.7.2)."""
_NEXT = "\r\n"
_FIELD = re.compile(r"[ \t]*bytes[ \t]*=(.*)", re.IGNORECASE | re.DOTALL)
_SPEC = re.compile(r"([0-9]{0,20})[ \t]*-[ \t]*([0-9]{0,20})")


class Span(Struct, frozen=True):
    """Bytes from `start` up to and excluding `stop` of a representation."""

    start: int
    stop: int

    def __len__(self) -> int:
        return self.stop - self.start

    def content_range(self, size: int) -> str:
        """Return the Content-Range of this part of `size` bytes (RFC 9110 14.4)."""
        return f"bytes {self.start}-{self.stop - 1}/{size}"


def parse_ranges(text: str | None, size: int) -> tuple[Span, ...] | None:
    """Return the spans of `size` bytes that a Range field requests, or None to send everything (200).

    Fields in another unit than bytes, malformed ones, and those with more than `MAX_RANGES` ranges are ignored (RFC
    9110 14.2). Ranges that overlap or nearly touch are joined, so that nothing is sent twice; the others keep their
    order. Raises a 416 Problem if no range can be satisfied (RFC 9110 15.5.17).
    """
    specs = _range_specs(text)
    if specs is None or size == 0:
        return None
    spans = [span for first, last in specs if (span := _span(first, last, size)) is not None]
    if not spans:
        raise Problem(
            416,
            f"Range is not satisfiable: the representation has {size} bytes, 0 to {size - 1}.",
            headers={"Content-Range": f"bytes */{size}"},
        )
    return _coalesce(spans)


def is_unchanged(if_range: str | None, etag: str) -> bool:
    """Whether If-Range permits a partial response: it is missing, or is this entity tag (RFC 9110 13.1.5).

    Weak tags and dates never match, because a date in seconds is not a strong validator.
    """
    return if_range is None or (if_range.strip(" \t") == etag and not etag.startswith("W/"))


def select_ranges(range_: str | None, if_range: str | None, etag: str, size: int) -> tuple[Span, ...] | None:
    """Return the spans to send (206), or None for everything (200). Raises the 416 Problem of `parse_ranges`."""
    if range_ is None or not is_unchanged(if_range, etag):
        return None
    return parse_ranges(range_, size)


class MultipartFraming(Struct, frozen=True):
    """Framing of several spans as multipart/byteranges (RFC 9110 14.6): the head of each part, and the tail."""

    boundary: str
    heads: tuple[bytes, ...]
    tail: bytes

    @property
    def content_type(self) -> str:
        """Media type of the multipart body."""
        return f"multipart/byteranges; boundary={self.boundary}"

    def length(self, spans: Sequence[Span]) -> int:
        """Return the number of bytes of the multipart body."""
        return sum(map(len, self.heads)) + sum(map(len, spans)) + len(self.tail)


def frame_parts(spans: Sequence[Span], size: int, media_type: str) -> MultipartFraming:
    """Return the framing of several spans, with an unpredictable boundary.

    Raises ValueError for a media type that could end its header early.
    """
    boundary = secrets.token_hex(16)
    kind = require_field_value(media_type)
    heads = tuple(
        f"{_NEXT if number else ''}--{boundary}\r\n"
        f"Content-Type: {kind}\r\nContent-Range: {span.content_range(size)}\r\n\r\n".encode("ascii")
        for number, span in enumerate(spans)
    )
    return MultipartFraming(boundary, heads, f"\r\n--{boundary}--\r\n".encode("ascii"))


def _range_specs(text: str | None) -> list[tuple[int | None, int | None]] | None:
    """Return the first and last position of each range, None for an omitted one; None for a field to ignore."""
    match = _FIELD.fullmatch(text or "")
    if match is None:
        return None
    specs: list[tuple[int | None, int | None]] = []
    for part in match[1].split(",", MAX_RANGES * 2):
        stripped = part.strip(" \t")
        if not stripped:
            continue
        spec = _SPEC.fullmatch(stripped)
        if spec is None or not (spec[1] or spec[2]) or len(specs) == MAX_RANGES:
            return None
        first, last = int(spec[1]) if spec[1] else None, int(spec[2]) if spec[2] else None
        if first is not None and last is not None and last < first:
            return None
        specs.append((first, last))
    return specs or None


def _span(first: int | None, last: int | None, size: int) -> Span | None:
    """Return the bytes of a range, None if there are none (RFC 9110 14.1.2)."""
    if first is None:
        assert last is not None
        return Span(max(0, size - last), size) if last else None
    return Span(first, size if last is None else min(last + 1, size)) if first < size else None


def _coalesce(spans: Sequence[Span]) -> tuple[Span, ...]:
    """Join spans that overlap or nearly touch, at the position of the first of them."""
    places = sorted(range(len(spans)), key=lambda place: (spans[place].start, spans[place].stop))
    joined: list[tuple[int, Span]] = []
    for place in places:
        span = spans[place]
        if joined and span.start <= joined[-1][1].stop + MIN_GAP:
            earlier, before = joined[-1]
            joined[-1] = (min(earlier, place), Span(before.start, max(before.stop, span.stop)))
        else:
            joined.append((place, span))
    return tuple(span for _, span in sorted(joined, key=lambda pair: pair[0]))
