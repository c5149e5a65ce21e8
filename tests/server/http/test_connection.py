"""Connections on the real server: limits of the bytes that a client sends before a complete request."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Callable

import pytest
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from rosld.server.http.body import read_body
from rosld.server.http.problem import Problem
from rosld.server.http.problem_details import render
from rosld.server.serving.connection import ConnectionBounds
from tests.server.http.listening import exchange, listening


async def echo(scope: Scope, receive: Receive, send: Send) -> None:
    """Answer with the body of the request, or with the Problem of reading it."""
    try:
        response = Response(await read_body(Request(scope, receive), limit=1000), media_type="text/plain")
    except Problem as problem:
        response = render(problem).response()
    await response(scope, receive, send)


def answer(*chunks: bytes, bounds: ConnectionBounds | None = None) -> tuple[int, bytes, bytes]:
    """Return status, head and body of the response to these bytes, read until the server closes the connection."""

    async def talk() -> bytes:
        async with listening(echo, bounds) as port:
            return await exchange(port, *chunks)

    head, _, body = asyncio.run(talk()).partition(b"\r\n\r\n")
    return int(head.split()[1]), head.lower(), body


def test_what_is_no_http_is_400_problem_details() -> None:
    status, head, body = answer(b"EHLO robot\r\n\r\n")
    assert status == 400
    assert b"application/problem+json" in head
    assert json.loads(body)["status"] == 400


@pytest.mark.slow
def test_a_malformed_head_is_400_and_another_version_505() -> None:
    both = b"Host: a\r\nContent-Length: 3\r\nTransfer-Encoding: chunked\r\nConnection: close\r\n\r\n0\r\n\r\n"
    assert answer(b"PUT / HTTP/1.1\r\n" + both)[0] == 400
    for request_line in (
        b"GET /\x01 HTTP/1.1",
        b"GET / HTTP/9.9",
        b"GET / HTTP/1.1\r\nBad Header: x",
        b"GET / HTTP/1.1\r\nA: b\x00c",
    ):
        assert answer(request_line + b"\r\nHost: a\r\nConnection: close\r\n\r\n")[0] == 400
    assert answer(b"GET / HTTP/2.0\r\nHost: a\r\n\r\n")[0] == 505


def test_a_head_without_end_is_431() -> None:
    many = [b"X-%d: %s\r\n" % (number, b"x" * 1000) for number in range(400)]
    assert answer(b"GET / HTTP/1.1\r\nHost: a\r\n", *many)[0] == 431
    for begin in (b"GET / HTTP/1.1\r\nX: ", b"GET /"):
        assert answer(begin, *[b"x" * 10_000] * 30)[0] == 431


def test_a_head_of_the_largest_size_is_read() -> None:
    head = b"GET / HTTP/1.1\r\nHost: a\r\nConnection: close\r\n"
    padding = b"X: " + b"x" * (64 * 1024 - len(head) - len(b"X: \r\n\r\n"))
    assert answer(head + padding + b"\r\n\r\n")[0] == 200
    assert answer(head + padding + b"x\r\n\r\n")[0] == 431


def test_a_transfer_coding_that_is_not_undone_is_501() -> None:
    for coding in (b"gzip, chunked", b"chunked, chunked", b"chunked\r\nTransfer-Encoding: chunked"):
        head = b"PUT / HTTP/1.1\r\nHost: a\r\nTransfer-Encoding: " + coding
        assert answer(head + b"\r\n\r\n3\r\nabc\r\n0\r\n\r\n")[0] in (400, 501)


def test_a_url_longer_than_can_be_read_is_431_also_where_heads_may_be_larger() -> None:
    line = b"GET /" + b"x" * 70_000 + b" HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n"
    assert answer(line, bounds=ConnectionBounds(head_bytes=1 << 20))[0] == 431


CHUNK = b"PUT / HTTP/1.1\r\nHost: a\r\nTransfer-Encoding: chunked\r\n\r\n1\r\na\r\n"


def test_trailers_and_chunk_extensions_without_end_are_431() -> None:
    for more in (b"0\r\nX: ", b"1;a="):
        assert answer(CHUNK + more, *[b"x" * 10_000] * 50)[0] == 431


async def test_a_trailer_is_no_header() -> None:
    async def headers(scope: Scope, receive: Receive, send: Send) -> None:
        request = Request(scope, receive)
        await request.body()
        await Response(repr(dict(request.headers)))(scope, receive, send)

    async with listening(headers) as port:
        assert b"authorization" not in await exchange(port, CHUNK + b"0\r\nAuthorization: Bearer x\r\n\r\n" + CLOSE)


CLOSE = b"GET / HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n"


CHUNKED = b"PUT /%d HTTP/1.1\r\nHost: a\r\nTransfer-Encoding: chunked\r\n\r\n"
BROKEN = {
    "a size that is no number": b"g\r\n",
    "a negative size": b"-1\r\n",
    "a size beyond all numbers": b"fffffffffffffffff\r\n",
    "more bytes than the size": b"1\r\nab\r\n0\r\n\r\n",
    "fewer bytes than the size": b"3\r\na\r\n0\r\n\r\n",
    "a size of hexadecimal notation": b"0x1\r\na\r\n0\r\n\r\n",
    "another request": b"GET / HTTP/1.1\r\nHost: a\r\n\r\n",
    "a trailer that is no field": b"0\r\n: x\r\n\r\n",
}


class Bodies:
    """An application that records bodies, and answers with them once `gate` is open."""

    def __init__(self) -> None:
        self.bodies: list[bytes] = []
        self.unfinished = 0
        self.has_begun = asyncio.Event()
        self.gate = asyncio.Event()
        self.gate.set()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            body = await read_body(Request(scope, receive), limit=1 << 20)
        except Problem as problem:
            self.unfinished += 1
            await render(problem).response()(scope, receive, send)
            return
        self.bodies.append(body)
        self.has_begun.set()
        await self.gate.wait()
        await Response(body, media_type="text/plain")(scope, receive, send)


@pytest.mark.parametrize("broken", BROKEN.values(), ids=BROKEN)
async def test_a_body_with_a_broken_chunk_is_400_with_words_and_reaches_nobody(broken: bytes) -> None:
    app = Bodies()
    async with listening(app) as port:
        for sent_before in (b"", b"1\r\na\r\n", b"20000\r\n" + b"x" * 0x20000 + b"\r\n"):
            for pieces in ([broken], [broken[at : at + 1] for at in range(len(broken))]):
                reader, writer = await asyncio.open_connection("127.0.0.1", port)
                for piece in (CHUNKED % 1 + sent_before, *pieces):
                    writer.write(piece)
                    await writer.drain()
                    await asyncio.sleep(0)
                head, _, body = (await reader.read()).partition(b"\r\n\r\n")
                writer.close()
                assert head.startswith(b"HTTP/1.1 400 ")
                assert b"connection: close" in head.lower()
                assert "chunked encoding" in json.loads(body)["detail"]
    assert app.bodies == []
    assert app.unfinished <= 6


async def test_requests_before_a_broken_chunk_are_answered_first_and_what_follows_it_is_not_done() -> None:
    app = Bodies()
    app.gate.clear()
    async with listening(app) as port:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        first, second = (CHUNKED % number + b"1\r\n%d\r\n0\r\n\r\n" % number for number in (1, 2))
        writer.write(first + second + CHUNKED % 3 + b"1\r\nc\r\nno chunk\r\n" + CHUNKED % 4 + b"0\r\n\r\n")
        await writer.drain()
        await app.has_begun.wait()
        app.gate.set()
        answers = (await reader.read()).split(b"HTTP/1.1 ")[1:]
        writer.close()
    assert [each[:3] for each in answers] == [b"200", b"200", b"400"]
    assert [each[-1:] for each in answers[:2]] == [b"1", b"2"]
    assert app.bodies == [b"1", b"2"]


SOON = ConnectionBounds(head_seconds=0.05)


def test_a_head_that_never_ends_is_408() -> None:
    assert answer(b"GET / HTTP/1.1\r\nHost:", bounds=SOON)[0] == 408
    assert answer(bounds=SOON)[0] == 408


async def endless(scope: Scope, receive: Receive, send: Send) -> None:
    """Answer with more than fits into the buffers of any system."""
    await send({"type": "http.response.start", "status": 200, "headers": []})
    for _ in range(1000):
        await send({"type": "http.response.body", "body": b"x" * 65536, "more_body": True})


async def test_a_client_that_reads_nothing_is_cut_off() -> None:
    async with listening(endless, ConnectionBounds(read_seconds=0.1)) as port:
        reader, writer = await asyncio.open_connection("127.0.0.1", port, limit=1)
        writer.write(b"GET / HTTP/1.1\r\nHost: a\r\n\r\n")
        await reader.readexactly(1)
        await asyncio.sleep(0.5)  # in which nothing is read, as its reader accepts one byte at a time
        told = 0
        with contextlib.suppress(ConnectionError):
            while chunk := await reader.read(1 << 20):
                told += len(chunk)
        writer.close()
    assert told < 1000 * 65536


async def test_a_client_that_may_not_connect_is_told_why_and_its_end_is_noted() -> None:
    ended: list[str | None] = []

    def connect(address: str | None) -> Callable[[], None]:
        if ended:
            raise Problem(429, "One is enough.", headers={"Retry-After": "5"})
        return lambda: ended.append(address)

    one = b"PUT / HTTP/1.1\r\nHost: a\r\nConnection: close\r\nContent-Length: 1\r\n\r\n1"
    async with listening(echo, ConnectionBounds(connect=connect)) as port:
        assert (await exchange(port, one)).startswith(b"HTTP/1.1 200")
        said = await exchange(port, one)
    assert said.startswith(b"HTTP/1.1 429")
    assert b"retry-after: 5" in said
    assert ended == ["127.0.0.1"]


async def test_a_second_head_that_never_ends_is_408() -> None:
    async with listening(echo, SOON) as port:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(b"PUT / HTTP/1.1\r\nHost: a\r\nContent-Length: 3\r\n\r\nabc")
        await reader.readuntil(b"abc")
        writer.write(b"GET / HTTP/1.1\r\nHo")
        assert (await reader.read()).startswith(b"HTTP/1.1 408")
        writer.close()
