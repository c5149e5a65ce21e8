"""Requests to upgrade the protocol, on the real server: unsupported ones are ignored (RFC 9110 7.8)."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import TypeAlias

import pytest
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from rosld.server.serving.connection import ConnectionBounds
from tests.server.http.listening import listening

Seen: TypeAlias = list[tuple[str, str, bytes]]
"""Method, target and body of the requests that reached the application."""

pytestmark = pytest.mark.slow

SETTINGS = b"HTTP2-Settings: AAEAAEAAAAIAAAABAAMAAABkAAQBAAAAAAUAAEAA\r\n"
H2C = b"Connection: Upgrade, HTTP2-Settings\r\n" + SETTINGS + b"Upgrade: h2c\r\n"
"""Header fields that the HttpClient of Java's JDK sends with each plain request."""
WEBSOCKET = (
    b"Connection: Upgrade\r\nUpgrade: websocket\r\n"
    b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
)
DELETE = b"DELETE /data/x HTTP/1.1\r\nHost: a\r\n\r\n"
NEXT = b"GET /next?a=b HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n"
LAST = ("GET", "/next?a=b", b"")


class Application:
    """An application that records requests, and answers each with its number."""

    def __init__(self) -> None:
        self.seen: Seen = []

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "websocket":
            self.seen.append(("websocket", scope["path"], b""))
            await receive()
            await send({"type": "websocket.accept"})
            while (await receive())["type"] != "websocket.disconnect":
                pass
            return
        body = await Request(scope, receive).body()
        query = scope["query_string"].decode()
        self.seen.append((scope["method"], scope["raw_path"].decode() + (query and f"?{query}"), body))
        await Response(f"answer {len(self.seen)}")(scope, receive, send)


Talk: TypeAlias = Callable[..., Awaitable[tuple[Seen, bytes]]]


@asynccontextmanager
async def listener() -> AsyncIterator[Talk]:
    """Yield a function that sends pieces on a new connection; it returns the requests and the response."""
    app = Application()
    async with listening(app, ConnectionBounds()) as port:

        async def talk(*pieces: bytes) -> tuple[Seen, bytes]:
            app.seen = []
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            for piece in pieces:
                writer.write(piece)
                for _ in range(4):  # iterations of the common loop, in which the server reads the piece
                    await asyncio.sleep(0)
            answers = await asyncio.wait_for(reader.read(), 10)
            writer.close()
            return app.seen, answers

        yield talk


async def test_a_client_that_upgrades_is_told_to_continue() -> None:
    head = b"PUT /data/a HTTP/1.1\r\nHost: a\r\nExpect: 100-continue\r\n" + H2C

    async with listener() as talk:
        seen, answers = await talk(head + b"Content-Length: 3\r\n\r\n", b"abc" + NEXT)
        assert seen == [("PUT", "/data/a", b"abc"), LAST]
        assert answers.startswith(b"HTTP/1.1 100 Continue\r\n\r\nHTTP/1.1 200 OK")


@pytest.mark.parametrize("length", [b"", b"Content-Length: 0\r\n"], ids=["no length", "length 0"])
async def test_bytes_behind_a_websocket_s_handshake_are_no_request(length: bytes) -> None:
    handshake = b"GET /channel HTTP/1.1\r\nHost: a\r\n" + WEBSOCKET + length + b"\r\n"

    async with listener() as talk:
        for cut in (*range(0, len(handshake), 3), len(handshake)):
            whole = handshake + DELETE
            seen, answers = await talk(whole[:cut], whole[cut:])
            assert {method for method, _, _ in seen} <= {"websocket"}, cut
            assert answers.startswith((b"HTTP/1.1 400", b"HTTP/1.1 101")), cut
        assert answers.startswith(b"HTTP/1.1 101"), "the handshake, by itself, is taken"


async def test_a_websocket_is_not_opened_while_an_answer_is_under_way() -> None:
    first = b"GET /first HTTP/1.1\r\nHost: a\r\n\r\n"
    handshake = b"GET /channel HTTP/1.1\r\nHost: a\r\n" + WEBSOCKET + b"\r\n"

    async with listener() as talk:
        seen, answers = await talk(first + handshake + NEXT)
        assert seen == [("GET", "/first", b""), ("GET", "/channel", b""), LAST]
        assert answers.count(b"HTTP/1.1 200 OK") == 3


async def test_connect_is_refused_and_what_follows_is_no_request() -> None:
    async with listener() as talk:
        for target in (b"a:80", b"/"):
            seen, answers = await talk(b"CONNECT %b HTTP/1.1\r\nHost: a\r\n\r\n" % target, DELETE)
            assert (seen, answers[:12]) == ([], b"HTTP/1.1 501")
