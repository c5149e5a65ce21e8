"""Request bodies: bounded reading (RFC 9110 8.4 to 8.6), charsets (8.3.2), and multipart/form-data (RFC 7578)."""

from __future__ import annotations

import asyncio
import re
import sys
import time
from collections.abc import AsyncIterator, Coroutine, Mapping
from typing import NamedTuple, Protocol

import anyio
from starlette.requests import ClientDisconnect
from starlette.types import Receive

from rosld.ontology.charsets import UTF_8, UnknownCharset, codec_of, decode, strip_encoding_declaration
from rosld.server.http.negotiation import MediaType, parse_media_type
from rosld.server.http.problem import Problem

TIMEOUT = 30.0
"""Seconds for a client to send its body."""
MIN_BYTES_PER_SECOND = 1024
"""Minimum average rate of a streamed body."""
LINGER_SECONDS = 2.0
"""Seconds of reading and discarding the rest of a body that is too large, so that the client gets the response."""


class IncomingRequest(Protocol):
    """The parts of a request that its body needs; Starlette's Request is one."""

    @property
    def headers(self) -> Mapping[str, str]:
        """Header fields by lower-case name."""
        ...

    @property
    def receive(self) -> Receive:
        """ASGI callable that receives the body."""
        ...


async def read_body(request: IncomingRequest, *, limit: int, timeout: float = TIMEOUT) -> bytes:
    """Return the body of a request, of at most `limit` bytes, sent within `timeout` seconds.

    Raises Problems: 413 too large (before reading if Content-Length says so), 415 compressed, 408 too slow, 400
    truncated or not of the length in Content-Length. A connection with an unread rest is closed.
    """
    headers = request.headers
    require_identity_coding(headers.get("content-encoding"))
    declared = parse_content_length(headers.get("content-length"))
    if declared is not None and declared > limit:
        await _drain(request)
        raise _too_large(limit)
    try:
        body = await _await_within(timeout, _collect(request.receive, limit))
    except _TooLarge:
        await _drain(request)
        raise _too_large(limit) from None
    except TimeoutError as error:
        raise Problem(408, f"The body did not arrive within {timeout:g} s.", headers=_CLOSE) from error
    except ClientDisconnect as error:
        raise Problem(400, "The connection ended before the body was complete.", headers=_CLOSE) from error
    if declared is not None and len(body) != declared:
        raise Problem(400, f"Content-Length says {declared} bytes, the body has {len(body)}.", headers=_CLOSE)
    return body


async def read_chunks(request: IncomingRequest, *, limit: int, timeout: float = TIMEOUT) -> AsyncIterator[bytes]:
    """Yield the body as it arrives, each chunk within `timeout` seconds. Raises the Problems of `read_body`.

    The whole body may take that time and another second for each `MIN_BYTES_PER_SECOND`, so that a slow trickle ends.
    """
    require_identity_coding(request.headers.get("content-encoding"))
    declared = parse_content_length(request.headers.get("content-length"))
    if declared is not None and declared > limit:
        await _drain(request)
        raise _too_large(limit)
    size, more, begun = 0, True, time.monotonic()
    while more:
        if time.monotonic() - begun > timeout + size / MIN_BYTES_PER_SECOND:
            words = f"The body arrived at less than {MIN_BYTES_PER_SECOND} bytes a second; {size} bytes were received."
            raise Problem(408, words, headers=_CLOSE)
        try:
            with anyio.fail_after(timeout):
                message = await request.receive()
        except TimeoutError as error:
            raise Problem(408, f"No data arrived for {timeout:g} s while reading the body.", headers=_CLOSE) from error
        if message["type"] != "http.request":
            raise Problem(400, "The connection ended before the body was complete.", headers=_CLOSE)
        chunk: bytes = message.get("body", b"")
        size += len(chunk)
        if size > limit:
            await _drain(request)
            raise _too_large(limit)
        if chunk:
            yield chunk
        more = message.get("more_body", False)
    if declared is not None and size != declared:
        raise Problem(400, f"Content-Length says {declared} bytes, the body has {size}.", headers=_CLOSE)


def require_identity_coding(coding: str | None) -> None:
    """Raise a 415 Problem for a compressed body, which could grow without limit (RFC 9110 15.5.16)."""
    if coding is not None and coding.strip().lower() not in ("", "identity"):
        raise Problem(
            415,
            f"Content-Encoding: {coding} is not supported. Send the body without it.",
            headers={"Accept-Encoding": "identity", **_CLOSE},
        )


def parse_content_length(text: str | None) -> int | None:
    """Return the number in Content-Length, None if it is missing. Raises a 400 Problem if it is not a number."""
    if text is None:
        return None
    if not (text.isascii() and text.isdigit() and len(text) < 20):
        raise Problem(400, f"Content-Length: {text[:100]!r} is not a number of bytes.", headers=_CLOSE)
    return int(text)


_CLOSE = {"Connection": "close"}


class _TooLarge(Exception):
    pass


async def _collect(receive: Receive, limit: int) -> bytes:
    chunks: list[bytes] = []
    size = 0
    more = True
    while more:
        message = await receive()
        if message["type"] != "http.request":
            raise ClientDisconnect
        chunk: bytes = message.get("body", b"")
        size += len(chunk)
        if size > limit:
            raise _TooLarge
        chunks.append(chunk)
        more = message.get("more_body", False)
    return chunks[0] if len(chunks) == 1 else b"".join(chunks)


async def _await_within(seconds: float, work: Coroutine[object, object, bytes]) -> bytes:
    """Await `work`; raise TimeoutError after `seconds`. A bare timer, because most bodies arrive with the head."""
    loop = asyncio.get_running_loop()
    task = asyncio.current_task(loop)
    assert task is not None
    expired: list[bool] = []

    def expire() -> None:
        expired.append(True)
        task.cancel()

    timer = loop.call_later(seconds, expire)
    try:
        return await work
    except asyncio.CancelledError:
        if not expired:
            raise
        if sys.version_info >= (3, 11):
            task.uncancel()
        raise TimeoutError from None
    finally:
        timer.cancel()


async def _drain(request: IncomingRequest) -> None:
    """Read and discard the rest of a body: closing the connection earlier would reset it and lose the response.

    A client that waits for 100 Continue gets its response at once.
    """
    if "expect" in request.headers:
        return
    with anyio.move_on_after(LINGER_SECONDS):
        while True:
            message = await request.receive()
            if message["type"] != "http.request" or not message.get("more_body", False):
                return


def _too_large(limit: int) -> Problem:
    return Problem(413, f"The body is larger than the limit of {limit} bytes.", headers=_CLOSE)


FORM = "application/x-www-form-urlencoded"


def codec_for(media_type: MediaType) -> str:
    """Return the Python codec of the charset of a media type, by default UTF-8.

    Parts of a multipart body have their own. A form is ASCII with percent-encoded octets, which excludes UTF-16. Raises
    a 415 Problem for an unsupported charset.
    """
    stated = media_type.parameter("charset")
    if stated is None or media_type.type == "multipart":
        return UTF_8
    try:
        found = codec_of(stated)
    except UnknownCharset as error:
        raise Problem(415, f"Content-Type: {media_type}: {error}.") from error
    if found.startswith("utf-16") and media_type.essence == FORM:
        raise Problem(
            415, f"Content-Type: {media_type}: the charset of a form must be a superset of ASCII, such as UTF-8."
        )
    return found


def to_utf8(data: bytes, media_type: MediaType) -> bytes:
    """Return a body in UTF-8. Raises Problems: 415 for unknown charsets, 400 for bytes outside the charset."""
    stated = media_type.parameter("charset")
    if stated is None:
        return data
    found, declares_another = codec_for(media_type), _is_xml(media_type)  # the field takes precedence (RFC 7303 3.2)
    if not data or (found == UTF_8 and not declares_another):
        return data
    try:
        text = decode(data, found)
    except UnicodeDecodeError as error:
        raise Problem(400, f"The body is not valid {stated}: {error.reason} at byte {error.start}.") from error
    return (strip_encoding_declaration(text) if declares_another else text).encode()


def _is_xml(media_type: MediaType) -> bool:
    return media_type.subtype == "xml" or media_type.subtype.endswith("+xml")


MULTIPART = "multipart/form-data"
_BOUNDARY = re.compile(r"[0-9A-Za-z'()+_,./:=? -]{0,69}[0-9A-Za-z'()+_,./:=?-]")
_DELIMITED = re.compile(rb"[ \t]*\r\n")
_LONGEST_HEAD = 16 * 1024
_MAX_PARTS = 1000
_PLAIN_CODINGS = ("", "7bit", "8bit", "binary")


class Part(NamedTuple):
    """One part: its stated media type, or None, and its bytes."""

    media_type: MediaType | None
    body: bytes


def split_parts(body: bytes, boundary: str | None) -> tuple[Part, ...]:
    """Return the parts of a multipart body in order; `boundary` is that of its Content-Type (RFC 2046 5.1).

    Raises ValueError naming the error.
    """
    if boundary is None or not _BOUNDARY.fullmatch(boundary):
        raise ValueError(
            f"boundary={boundary!r} is not a valid boundary: use 1 to 70 of the characters that RFC 2046 5.1.1 allows"
        )
    _, *pieces = (b"\r\n" + body).split(b"\r\n--" + boundary.encode("ascii"), _MAX_PARTS + 1)
    if len(pieces) > _MAX_PARTS:
        raise ValueError(f"the body has more than {_MAX_PARTS} parts")
    found: list[Part] = []
    for piece in pieces:
        if piece.startswith(b"--"):
            return tuple(found)
        begin = _DELIMITED.match(piece)
        if begin is None:
            raise ValueError(f"part {len(found) + 1} does not start on its own line")
        found.append(_parse_part(piece[begin.end() :], len(found) + 1))
    raise ValueError(f"the body does not end in --{boundary}--")


def _parse_part(piece: bytes, number: int) -> Part:
    head, blank, body = (b"\r\n" + piece).partition(b"\r\n\r\n")
    if not blank or len(head) > _LONGEST_HEAD:
        raise ValueError(f"part {number} has no blank line after its header fields")
    fields: dict[str, str] = {}
    for line in head.split(b"\r\n"):
        name, _, value = line.decode("latin-1").partition(":")
        fields.setdefault(name.strip().lower(), value.strip())
    coding = fields.get("content-transfer-encoding", "")
    if coding.lower() not in _PLAIN_CODINGS:
        raise ValueError(f"part {number} uses {coding[:100]!r}: send its bytes unencoded (RFC 7578 4.7)")
    stated = fields.get("content-type")
    try:
        return Part(None if stated is None else parse_media_type(stated), body)
    except ValueError as error:
        raise ValueError(f"part {number}: {error}") from error
