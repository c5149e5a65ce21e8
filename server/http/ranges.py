"""Byte ranges (RFC 9110 14): which parts of a representation a GET asks for, and how several are framed."""

from __future__ import annotations

import re
import secrets
from collections.abc import Sequence
from dataclasses import dataclass

from rosld.server.http import header_syntax
from rosld.server.http.problem import Problem

MAX_RANGES = 32
"""Ranges of one request. Nobody who reads a file needs more; a field with more is ignored (RFC 9110 14.2)."""
MIN_GAP = 128
"""Bytes between two ranges that are sent along: to frame another part would take as many (RFC 9110 15.3.7.2)."""
_NEXT = "\r\n"
_FIELD = re.compile(r"[ \t]*bytes[ \t]*=(.*)", re.IGNORECASE | re.DOTALL)
_SPEC = re.compile(r"([0-9]{0,20})[ \t]*-[ \t]*([0-9]{0,20})")


@dataclass(frozen=True, slots=True)
class Span:
    """Bytes `start` to `stop`, this one excluded, of a representation."""

    start: int
    stop: int

    def __len__(self) -> int:
        return self.stop - self.start

    def content_range(self, size: int) -> str:
        """The Content-Range of this part of `size` bytes (RFC 9110 14.4)."""
        return f"bytes {self.start}-{self.stop - 1}/{size}"


def parse_ranges(text: str | None, size: int) -> tuple[Span, ...] | None:
    """The spans of `size` bytes that a Range field asks for; None where all is to be sent (200).

    Fields in another unit than bytes, malformed ones, and those with more than `MAX_RANGES` ranges are ignored (RFC
    9110 14.2). Ranges that overlap or nearly touch become one, so that nothing is ever sent twice; the others keep the
    order in which they were asked for. Raises a 416 Problem where none of them can be satisfied (RFC 9110 15.5.17).
    """
    asked = _asked(text)
    if asked is None or size == 0:
        return None
    spans = [span for first, last in asked if (span := _span(first, last, size)) is not None]
    if not spans:
        raise Problem(
            416,
            f"There are {size} bytes, from 0 to {size - 1}: none of what Range asks for is among them.",
            headers={"Content-Range": f"bytes */{size}"},
        )
    return _coalesce(spans)


def is_unchanged(if_range: str | None, etag: str) -> bool:
    """Whether If-Range lets the ranges be sent: it is missing, or it is this very entity tag (RFC 9110 13.1.5).

    Weak tags never match. No date does, for a date in seconds is no strong validator.
    """
    return if_range is None or (if_range.strip(" \t") == etag and not etag.startswith("W/"))


def select_ranges(range_: str | None, if_range: str | None, etag: str, size: int) -> tuple[Span, ...] | None:
    """The spans that a GET is answered with (206), None for all (200); raises the 416 Problem of `parse_ranges`."""
    if range_ is None or not is_unchanged(if_range, etag):
        return None
    return parse_ranges(range_, size)


@dataclass(frozen=True, slots=True)
class MultipartFraming:
    """How several spans are sent as multipart/byteranges (RFC 9110 14.6): what stands before each and at the end."""

    boundary: str
    heads: tuple[bytes, ...]
    tail: bytes

    @property
    def content_type(self) -> str:
        """The media type of the whole."""
        return f"multipart/byteranges; boundary={self.boundary}"

    def length(self, spans: Sequence[Span]) -> int:
        """The bytes of the whole."""
        return sum(map(len, self.heads)) + sum(map(len, spans)) + len(self.tail)


def frame_parts(spans: Sequence[Span], size: int, media_type: str) -> MultipartFraming:
    """The frame of several spans of a representation, with a boundary that nobody can foresee.

    Raises ValueError for a media type that could end its header early.
    """
    boundary = secrets.token_hex(16)
    kind = header_syntax.require_field_value(media_type)
    heads = tuple(
        f"{_NEXT if number else ''}--{boundary}\r\n"
        f"Content-Type: {kind}\r\nContent-Range: {span.content_range(size)}\r\n\r\n".encode("ascii")
        for number, span in enumerate(spans)
    )
    return MultipartFraming(boundary, heads, f"\r\n--{boundary}--\r\n".encode("ascii"))


def _asked(text: str | None) -> list[tuple[int | None, int | None]] | None:
    """First and last position of each range, None for what is left out; None for a field that is to be ignored."""
    match = _FIELD.fullmatch(text or "")
    if match is None:
        return None
    asked: list[tuple[int | None, int | None]] = []
    for part in match[1].split(",", MAX_RANGES * 2):
        stripped = part.strip(" \t")
        if not stripped:
            continue
        spec = _SPEC.fullmatch(stripped)
        if spec is None or not (spec[1] or spec[2]) or len(asked) == MAX_RANGES:
            return None
        first, last = int(spec[1]) if spec[1] else None, int(spec[2]) if spec[2] else None
        if first is not None and last is not None and last < first:
            return None
        asked.append((first, last))
    return asked or None


def _span(first: int | None, last: int | None, size: int) -> Span | None:
    """The bytes that a range names, None where there are none (RFC 9110 14.1.2)."""
    if first is None:
        assert last is not None
        return Span(max(0, size - last), size) if last else None
    return Span(first, size if last is None else min(last + 1, size)) if first < size else None


def _coalesce(spans: Sequence[Span]) -> tuple[Span, ...]:
    """The spans with those that overlap or nearly touch joined, at the place of the first of them."""
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
