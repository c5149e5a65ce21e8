"""Responses: bytes, files with ranges, and the header fields of a resource."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from io import FileIO
from pathlib import Path
from typing import TypeAlias, TypeVar
from urllib.parse import quote

from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from rosld.server.http.conditional import ETag, Span, frame_parts, select_ranges
from rosld.server.http.fields import Link, quote_string, render_links, require_field_value
from rosld.server.http.negotiation import parse_media_type
from rosld.server.http.problem import Problem
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import OFFER_TYPE
from rosld.server.rest.resource import CONFORMS_TO, LDP, Resource
from rosld.server.runtime.tasks import end_tasks


class RawResponse(Response):
    """A response with a prepared header list."""

    def __init__(self, status: int, body: bytes, headers: list[tuple[bytes, bytes]]) -> None:
        self.status_code = status
        self.body = body
        self.background = None
        self.raw_headers = headers


def no_content() -> RawResponse:
    """Return a 204 (RFC 9110 15.3.5)."""
    return RawResponse(204, b"", [])


def bytes_response(
    exchange: Exchange, data: bytes, media_type: str, etag: ETag, more: Iterable[tuple[str, str]] = ()
) -> RawResponse:
    """Return the response to a GET with bytes: 200, 304, or 412 (RFC 9110 13.1).

    `more` are further headers.
    """
    fixed_headers = {"etag": str(etag), "vary": "Accept", "cache-control": "no-cache", **dict(more)}
    headers = [(name.encode("latin-1"), value.encode("latin-1")) for name, value in fixed_headers.items()]
    if exchange.check_preconditions(etag):
        return RawResponse(304, b"", headers)
    content = [(b"content-type", media_type.encode("latin-1")), (b"content-length", b"%d" % len(data))]
    return RawResponse(200, data, [*content, *headers])


def offer_url(url: str) -> str:
    """Return the URL of the offer of the resource at a URL."""
    return f"{url}{'&' if '?' in url else '?'}offer"


ACCEPT_FIELDS = {"PUT": "Accept-Put", "POST": "Accept-Post", "PATCH": "Accept-Patch"}


def resource_headers(
    resource: Resource, methods: frozenset[str] | None = None, shapes: Sequence[str] = ()
) -> dict[str, str]:
    """Return the headers of every response about a resource: Allow, Link, and Accept-*.

    `methods` are the current ones, if known better than by the resource without its state; `shapes` are those of its
    state in addition to that of its class.
    """
    methods = (resource.methods() if methods is None else methods) - resource.withheld
    links = (*resource.links, *(Link(url, CONFORMS_TO) for url in (*resource.conforms_to, *shapes)))
    if resource.constrained_by is not None:
        links = (*links, Link(resource.constrained_by, f"{LDP}constrainedBy"))
    if resource.links_offer:
        links = (*links, Link(offer_url(resource.url), "service-desc", OFFER_TYPE))  # RFC 8631
    headers = {"allow": ", ".join(sorted(methods))}
    if links:
        headers["link"] = rendered(links)
    for method, accepted in resource.accepts.items():
        if method in methods:
            headers[ACCEPT_FIELDS[method].lower()] = ", ".join(accepted)
    return headers


rendered = lru_cache(maxsize=4096)(render_links)
"""Cached `render_links`, for links that recur between requests."""


CHUNK = 128 * 1024
"""Bytes per read; smaller answers are read at once."""
READ_TIMEOUT = 60.0
"""Seconds without progress after which a reader counts as disconnected."""
UNKNOWN = "application/octet-stream"
"""Media type of a body without a Content-Type (RFC 9110 8.3)."""
CONTENT_SECURITY_POLICY = (
    "sandbox; default-src 'none'; img-src 'self' data:; media-src 'self' data:; "
    "style-src 'self' 'unsafe-inline'; font-src 'self' data:"
)
_ATTACHED = frozenset({"application/pdf"})
"""Media types that browsers refuse to show in a sandbox, and so are offered for download."""
_PLAIN_NAME = frozenset("!#$&+-.^_`|~ ()[]{},;=@'")

Piece: TypeAlias = "bytes | Span"
_T = TypeVar("_T")


def exact_media_type(stated: str | None) -> str:
    """Return the Content-Type of a body to be stored, unchanged. Raises a 415 Problem if it is invalid.

    Parameters are retained, with any charset: the server does not read such a body.
    """
    if stated is None:
        return UNKNOWN
    try:
        parse_media_type(stated)
        return require_field_value(stated.strip(" \t"))
    except ValueError as error:
        raise Problem(415, f"Content-Type: {error}.") from error


async def file_response(
    path: Path,
    size: int,
    media_type: str,
    etag: str,
    *,
    headers: Mapping[str, str],
    name: str | None = None,
    range_: str | None = None,
    if_range: str | None = None,
    head: bool = False,
) -> Response:
    """Return the response to a GET (or HEAD) of the file at `path` of `size` bytes.

    `headers` (lower-case names) are added to its own. The response is 200 with the file, or 206 with the ranges of
    Range if If-Range matches. `etag` is quoted; If-Match and If-None-Match are checked before (RFC 9110 13.2.2). `name`
    is the file name for downloads. The file is opened here, off the loop, and is sent completely even if it is removed
    afterwards. Raises a 416 Problem and FileNotFoundError.
    """
    spans = None if head else select_ranges(range_, if_range, etag, size)
    pieces: list[Piece]
    added = {"content-type": media_type}
    if spans is None:
        pieces = [Span(0, size)]
    elif len(spans) == 1:
        pieces = [spans[0]]
        added["content-range"] = spans[0].content_range(size)
    else:
        frame = frame_parts(spans, size, media_type)
        pieces = [each for pair in zip(frame.heads, spans, strict=True) for each in pair] + [frame.tail]
        added["content-type"] = frame.content_type
    length = sum(map(len, pieces))
    added |= {"content-length": str(length), "etag": etag, **_fixed_headers(media_type, name)}
    status, encoded = 200 if spans is None else 206, _encode({"cache-control": "no-cache", **headers, **added})
    if head:
        return RawResponse(status, b"", encoded)
    if length <= CHUNK:
        return RawResponse(status, await asyncio.to_thread(_whole, path, pieces), encoded)
    return _FileStream(status, encoded, await asyncio.to_thread(FileIO, path), pieces)


def file_stream(headers: list[tuple[bytes, bytes]], file: FileIO, size: int) -> Response:
    """Return a 200 with the contents of an open file, which is closed after sending."""
    return _FileStream(200, headers, file, [Span(0, size)])


async def cancel_on_disconnect(receive: Receive, work: Coroutine[object, object, _T]) -> _T:
    """Return the result of work, or cancel it and raise a Problem (which nobody reads) if the client disconnects."""
    working, listening = asyncio.ensure_future(work), asyncio.ensure_future(_wait_disconnect(receive))
    try:
        await asyncio.wait({working, listening}, return_when=asyncio.FIRST_COMPLETED)
        if not working.done():
            raise Problem(503, "The client has gone.")
        return working.result()
    finally:
        await end_tasks((working, listening))


class _FileStream(Response):
    """A response that reads its file as fast as the client receives it, and closes it at the end."""

    def __init__(self, status: int, headers: list[tuple[bytes, bytes]], file: FileIO, pieces: Sequence[Piece]) -> None:
        self.status_code = status
        self.body = b""
        self.background = None
        self.raw_headers = headers
        self._file = file
        self._pieces = pieces
        self._reading: asyncio.Future[bytes] | None = None
        self._sent = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        working = asyncio.ensure_future(self._send(send))
        listening = asyncio.ensure_future(_wait_disconnect(receive))
        try:
            while not working.done() and not listening.done():
                sent = self._sent
                await asyncio.wait({working, listening}, timeout=READ_TIMEOUT, return_when=asyncio.FIRST_COMPLETED)
                if self._sent == sent:
                    break
        finally:
            await end_tasks((working, listening))
            self._close()
        if not working.cancelled():
            working.result()

    async def _send(self, send: Send) -> None:
        await send({"type": "http.response.start", "status": self.status_code, "headers": self.raw_headers})
        for part in _parts(self._pieces):
            data = part if isinstance(part, bytes) else await self._read(part)
            await send({"type": "http.response.body", "body": data, "more_body": True})
            self._sent += 1
        await send({"type": "http.response.body", "body": b"", "more_body": False})

    async def _read(self, span: Span) -> bytes:
        self._reading = asyncio.get_running_loop().run_in_executor(None, _bytes, self._file, span)
        return await asyncio.shield(self._reading)

    def _close(self) -> None:
        """Close the file, but not while a thread reads it."""
        if self._reading is None or self._reading.done():
            self._file.close()
        else:
            self._reading.add_done_callback(lambda _: self._file.close())


async def _wait_disconnect(receive: Receive) -> None:
    """Wait until the client has disconnected."""
    while (await receive())["type"] != "http.disconnect":
        pass


def _parts(pieces: Iterable[Piece]) -> Iterator[Piece]:
    """Yield the pieces, with long spans split into chunks."""
    for piece in pieces:
        if isinstance(piece, bytes):
            yield piece
        else:
            for start in range(piece.start, piece.stop, CHUNK):
                yield Span(start, min(start + CHUNK, piece.stop))


def _bytes(file: FileIO, span: Span) -> bytes:
    """Return exactly these bytes of a file."""
    file.seek(span.start)
    parts: list[bytes] = []
    missing = len(span)
    while missing:
        data = file.read(missing)
        if not data:
            raise OSError(f"the file is {missing} bytes shorter than announced")
        parts.append(data)
        missing -= len(data)
    return parts[0] if len(parts) == 1 else b"".join(parts)


def _whole(path: Path, pieces: Iterable[Piece]) -> bytes:
    with FileIO(path) as file:
        return b"".join(piece if isinstance(piece, bytes) else _bytes(file, piece) for piece in pieces)


def _fixed_headers(media_type: str, name: str | None) -> dict[str, str]:
    """Return the headers of every response with a file or a part of it."""
    return {
        "accept-ranges": "bytes",
        "x-content-type-options": "nosniff",
        "content-security-policy": CONTENT_SECURITY_POLICY,
        "content-disposition": _disposition(media_type, name),
    }


def _disposition(media_type: str, name: str | None) -> str:
    """Return the Content-Disposition (RFC 6266): shown inline if browsers can, and saved under its name."""
    essence = media_type.partition(";")[0].strip(" \t").lower()
    kind = "attachment" if essence in _ATTACHED else "inline"
    if not name:
        return kind
    plain = "".join(char if char.isascii() and (char.isalnum() or char in _PLAIN_NAME) else "_" for char in name)
    extended = "" if plain == name else f"; filename*=UTF-8''{quote(name, safe='', errors='replace')}"
    return f"{kind}; filename={quote_string(plain)}{extended}"


def _encode(headers: Mapping[str, str]) -> list[tuple[bytes, bytes]]:
    return [(name.encode("ascii"), require_field_value(value).encode("ascii")) for name, value in headers.items()]
