"""Requests that reach the application, compared to h11 on the same bytes: no byte of a body is ever a request."""

from __future__ import annotations

import asyncio
from typing import TypeAlias, cast

import h11
import pytest
import uvicorn
from hypothesis import given, settings
from hypothesis import strategies as st
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response
from starlette.types import Receive, Scope, Send
from uvicorn.server import ServerState

from rosld.server.http.origin import check_host, origin_policy
from rosld.server.http.problem import Problem
from rosld.server.http.problem_details import render
from rosld.server.serving.connection import BoundedConfig, Connection

Seen: TypeAlias = list[tuple[bytes, bytes, bytes]]
"""Method, target and body of each whole request."""
MAX_TURNS = 200
SITE = origin_policy("http://a/", "a", 80)


class Wire(asyncio.Transport):
    """A transport that records sent data."""

    def __init__(self) -> None:
        super().__init__()
        self.sent = b""
        self._is_closing = False

    def write(self, data: bytes | bytearray | memoryview) -> None:
        self.sent += bytes(data)

    def is_closing(self) -> bool:
        return self._is_closing

    def close(self) -> None:
        self._is_closing = True

    def write_eof(self) -> None:
        pass

    def pause_reading(self) -> None:
        pass

    def resume_reading(self) -> None:
        pass


async def read_by_rosld(pieces: list[bytes]) -> tuple[Seen, bool]:
    """Return the requests that reach the application from pieces of a connection, and whether one was rejected."""
    seen: Seen = []
    refusals: list[Problem] = []

    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        request = Request(scope, receive)
        try:
            body = await request.body()
        except ClientDisconnect:
            return
        try:
            check_host(SITE, request.headers.getlist("host"))
        except Problem as problem:
            refusals.append(problem)
        if refusals:  # h11 stops after a head without a Host, unlike rosld's application
            await render(refusals[0]).response()(scope, receive, send)
            return
        query = scope["query_string"]
        seen.append((scope["method"].encode(), scope["raw_path"] + (b"?" + query if query else b""), body))
        await Response("read")(scope, receive, send)

    config = BoundedConfig(app, http=Connection, ws="none", lifespan="off", log_config=None)
    config.load()
    state, wire = ServerState(), Wire()
    connection = Connection(cast("uvicorn.Config", config), state, {})
    connection.connection_made(wire)
    for piece in pieces:
        if wire.is_closing():
            break
        connection.data_received(piece)
        for _ in range(3):
            await asyncio.sleep(0)
    for _ in range(MAX_TURNS):
        if not state.tasks:
            break
        await asyncio.sleep(0)
    is_refused = wire.is_closing() or b"HTTP/1.1 4" in wire.sent or b"HTTP/1.1 5" in wire.sent
    connection.connection_lost(None)
    await asyncio.gather(*state.tasks)
    return seen, is_refused


def read_by_h11(data: bytes) -> Seen:
    """Return the same by h11, up to a rejected request. Empty lines before a request are ignored (RFC 9112 2.2)."""
    seen: Seen = []
    while data := data.lstrip(b"\r\n"):
        connection = h11.Connection(h11.SERVER)
        connection.receive_data(data)
        try:
            request, body = connection.next_event(), b""
            while isinstance(event := connection.next_event(), h11.Data):
                body += bytes(event.data)
        except h11.RemoteProtocolError:
            break
        if not isinstance(request, h11.Request) or not isinstance(event, h11.EndOfMessage):
            break
        seen.append((request.method, request.target, body))
        if connection.their_state is h11.MUST_CLOSE:
            break
        data = connection.trailing_data[0]
    return seen


SMUGGLED = b"DELETE /smuggled HTTP/1.1\r\nHost: a\r\n\r\n"
UPGRADES = st.sampled_from(
    [
        b"",
        b"Connection: Upgrade\r\nUpgrade: h2c\r\n",
        b"Connection: Upgrade, HTTP2-Settings\r\nUpgrade: h2c\r\nHTTP2-Settings: AAMAAABk\r\n",
        b"connection: keep-alive\r\nConnection: upgrade\r\nupgrade: websocket\r\n",
        b"Upgrade: websocket\r\nConnection: x\r\nConnection: upgrade, keep-alive\r\n",
        b"Upgrade: h2c, websocket\r\nConnection: upgrade\r\nSec-WebSocket-Key: x\r\nSec-WebSocket-Version: 13\r\n",
        b"Upgrade: h2c\r\n",
        b"Connection: upgrade\r\n",
        b"Connection: close, upgrade\r\nUpgrade: TLS/1.0\r\n",
        b"Expect: 100-continue\r\nConnection: upgrade\r\nUpgrade: h2c\r\n",
    ]
)
BODIES = st.sampled_from([b"", b"abc", SMUGGLED, b"\r\n", b"0\r\n\r\n", b"x" * 300])


@st.composite
def chunks(draw: st.DrawFn) -> bytes:
    """Return a body in chunks, possibly with extensions and trailers."""
    extension = draw(st.sampled_from([b"", b"", b";a=b", b";a"]))
    pieces = draw(st.lists(BODIES.filter(bool), max_size=3))
    trailers = draw(st.sampled_from([b"", b"", b"A: b\r\n", b"Connection: upgrade\r\nUpgrade: h2c\r\n"]))
    return b"".join(b"%x%b\r\n%b\r\n" % (len(each), extension, each) for each in pieces) + b"0\r\n" + trailers + b"\r\n"


@st.composite
def requests(draw: st.DrawFn) -> bytes:
    """Return a request, usually a valid one."""
    method = draw(st.sampled_from([b"GET", b"PUT", b"POST", b"DELETE", b"PATCH", b"OPTIONS", b"HEAD"]))
    target = draw(st.sampled_from([b"/", b"/a/b?c=d", b"/%20", b"/a//b"]))
    version = draw(st.sampled_from([b"1.1"] * 9 + [b"1.0"]))
    upgrade = draw(UPGRADES)
    body = draw(BODIES)
    framing = draw(
        st.one_of(
            st.just(b"\r\n"),
            st.just(b"Content-Length: %d\r\n\r\n%b" % (len(body), body)),
            chunks().map(lambda chunked: b"Transfer-Encoding: chunked\r\n\r\n" + chunked),
            st.sampled_from([b"gzip, chunked", b"chunked, gzip", b"identity", b"xchunked", b"Chunked"]).map(
                lambda coding: b"Transfer-Encoding: " + coding + b"\r\n\r\n" + SMUGGLED
            ),
            st.just(b"Content-Length: 3\r\nContent-Length: 4\r\n\r\nabcd"),
            st.just(b"Content-Length: 40\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n" + SMUGGLED),
        )
    )
    return b"%b %b HTTP/%b\r\nHost: a\r\n%b%b" % (method, target, version, upgrade, framing)


DAMAGE = [b"", b"\r\n", b"\n", b"\r", b" ", b"\t", b"0", b":", b"\x00", b"\xff", b";", b"Upgrade"]


@st.composite
def streams(draw: st.DrawFn) -> list[bytes]:
    """Return several requests in sequence, occasionally damaged, in pieces."""
    data = b"".join(draw(st.lists(requests(), min_size=1, max_size=4)))
    for _ in range(draw(st.sampled_from([0, 0, 1, 2]))):
        at = draw(st.integers(0, len(data)))
        put = draw(st.sampled_from(DAMAGE))
        data = data[:at] + put + data[at + draw(st.integers(0, 2)) :]
    cuts = sorted(draw(st.lists(st.integers(0, len(data)), max_size=5)))
    return [data[start:end] for start, end in zip([0, *cuts], [*cuts, len(data)], strict=True) if start < end]


@pytest.mark.slow
@settings(deadline=None)
@given(streams())
def test_the_application_sees_the_requests_that_h11_reads(pieces: list[bytes]) -> None:
    expected = read_by_h11(b"".join(pieces))
    seen, is_refused = asyncio.run(read_by_rosld(pieces))
    assert seen == expected[: len(seen)]
    assert is_refused or len(seen) == len(expected)
