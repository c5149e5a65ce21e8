"""multipart/form-data (RFC 7578): bodies of several parts, each with a media type of its own. Pure."""

from __future__ import annotations

import re
from typing import NamedTuple

from rosld.server.http import media
from rosld.server.http.media import MediaType

MULTIPART = "multipart/form-data"
_BOUNDARY = re.compile(r"[0-9A-Za-z'()+_,./:=? -]{0,69}[0-9A-Za-z'()+_,./:=?-]")
_DELIMITED = re.compile(rb"[ \t]*\r\n")
_LONGEST_HEAD = 16 * 1024
_MAX_PARTS = 1000
_PLAIN_CODINGS = ("", "7bit", "8bit", "binary")


class Part(NamedTuple):
    """One part: what it says it is (None where it says nothing), and its bytes."""

    media_type: MediaType | None
    body: bytes


def split_parts(body: bytes, boundary: str | None) -> tuple[Part, ...]:
    """The parts of a body in order, cut at `boundary`: what its Content-Type says it is (RFC 2046 5.1).

    Raises ValueError naming what is wrong.
    """
    if boundary is None or not _BOUNDARY.fullmatch(boundary):
        raise ValueError(f"boundary={boundary!r} cuts no multipart body: 1 to 70 characters of RFC 2046 5.1.1 do")
    _, *pieces = (b"\r\n" + body).split(b"\r\n--" + boundary.encode("ascii"), _MAX_PARTS + 1)
    if len(pieces) > _MAX_PARTS:
        raise ValueError(f"the body has more than {_MAX_PARTS} parts")
    found: list[Part] = []
    for piece in pieces:
        if piece.startswith(b"--"):
            return tuple(found)
        begin = _DELIMITED.match(piece)
        if begin is None:
            raise ValueError(f"part {len(found) + 1} does not begin on a line of its own")
        found.append(_part(piece[begin.end() :], len(found) + 1))
    raise ValueError(f"the body does not end in --{boundary}--")


def _part(piece: bytes, number: int) -> Part:
    head, blank, body = (b"\r\n" + piece).partition(b"\r\n\r\n")
    if not blank or len(head) > _LONGEST_HEAD:
        raise ValueError(f"part {number} has no blank line that ends its header fields")
    fields: dict[str, str] = {}
    for line in head.split(b"\r\n"):
        name, _, value = line.decode("latin-1").partition(":")
        fields.setdefault(name.strip().lower(), value.strip())
    coding = fields.get("content-transfer-encoding", "")
    if coding.lower() not in _PLAIN_CODINGS:
        raise ValueError(f"part {number} is in {coding[:100]!r}: send its bytes as they are (RFC 7578 4.7)")
    stated = fields.get("content-type")
    try:
        return Part(None if stated is None else media.parse(stated), body)
    except ValueError as error:
        raise ValueError(f"part {number}: {error}") from error
