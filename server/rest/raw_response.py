"""Responses whose bytes are all rendered."""

from __future__ import annotations

from collections.abc import Iterable

from starlette.responses import Response

from rosld.server.http.conditional import ETag, check_preconditions
from rosld.server.rest.exchange import Exchange


class RawResponse(Response):
    """A response whose header list is ready."""

    def __init__(self, status: int, body: bytes, headers: list[tuple[bytes, bytes]]) -> None:
        self.status_code = status
        self.body = body
        self.background = None
        self.raw_headers = headers


def no_content() -> RawResponse:
    """204: it was done, and there is nothing more to say (RFC 9110 15.3.5)."""
    return RawResponse(204, b"", [])


def bytes_response(
    exchange: Exchange, data: bytes, media_type: str, etag: ETag, more: Iterable[tuple[str, str]] = ()
) -> RawResponse:
    """The answer to a GET with bytes that are at hand; 304 where they are known, 412 as RFC 9110 13.1 has it.

    `more` are headers beside those of the bytes themselves.
    """
    fixed_headers = {"etag": str(etag), "vary": "Accept", "cache-control": "no-cache", **dict(more)}
    headers = [(name.encode("latin-1"), value.encode("latin-1")) for name, value in fixed_headers.items()]
    if check_preconditions(
        "GET", etag, if_match=exchange.header("if-match"), if_none_match=exchange.header("if-none-match")
    ):
        return RawResponse(304, b"", headers)
    content = [(b"content-type", media_type.encode("latin-1")), (b"content-length", b"%d" % len(data))]
    return RawResponse(200, data, [*content, *headers])
