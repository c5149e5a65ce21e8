"""Connections, on the real server: what a stranger sends before it is a request is bounded."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable
from typing import TypeVar

import pytest
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from rosld.server.commands import listening
from rosld.server.http import connection
from rosld.server.http.body import read_body
from rosld.server.http.problem import Problem, render

_V = TypeVar("_V")
Talk = Callable[[bytes], Awaitable[bytes]]


async def echo(scope: Scope, receive: Receive, send: Send) -> None:
    """Answers with the body it was sent, or with the Problem of reading it."""
    try:
        response = Response(await read_body(Request(scope, receive), limit=1000), media_type="text/plain")
    except Problem as problem:
        response = render(problem).response()
    await response(scope, receive, send)


def with_server(work: Callable[[int], Awaitable[_V]]) -> _V:
    """What `work` makes of a running server's port; the server has ended afterwards."""

    async def main() -> _V:
        listens = asyncio.Event()
        server = listening.Server(echo, listens.set)
        sock = listening.bind("127.0.0.1", 0)
        serving = asyncio.create_task(server.serve(sockets=[sock]))
        try:
            await asyncio.wait_for(listens.wait(), 10)
            return await asyncio.wait_for(work(sock.getsockname()[1]), 20)
        finally:
            server.should_exit = True
            await serving

    return asyncio.run(main())


def answer(*chunks: bytes) -> tuple[int, bytes, bytes]:
    """Status, head and body of the answer to these bytes, read until the server closes the connection."""

    async def talk(port: int) -> bytes:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        for chunk in chunks:
            writer.write(chunk)
            await writer.drain()
        try:
            return await reader.read()
        finally:
            writer.close()

    head, _, body = with_server(talk).partition(b"\r\n\r\n")
    return int(head.split()[1]), head.lower(), body


def test_a_request_is_answered() -> None:
    status, _, body = answer(b"PUT / HTTP/1.1\r\nHost: a\r\nConnection: close\r\nContent-Length: 3\r\n\r\nabc")
    assert (status, body) == (200, b"abc")


def test_what_is_no_http_is_400_problem_details() -> None:
    status, head, body = answer(b"EHLO robot\r\n\r\n")
    assert status == 400
    assert b"application/problem+json" in head
    assert json.loads(body)["status"] == 400


@pytest.mark.parametrize(
    "request_line",
    [b"GET /\x01 HTTP/1.1", b"GET / HTTP/9.9", b"GET / HTTP/1.1\r\nBad Header: x", b"GET / HTTP/1.1\r\nA: b\x00c"],
)
def test_a_malformed_head_is_400(request_line: bytes) -> None:
    assert answer(request_line + b"\r\nHost: a\r\nConnection: close\r\n\r\n")[0] == 400


def test_a_length_and_a_transfer_coding_together_are_400() -> None:
    head = b"PUT / HTTP/1.1\r\nHost: a\r\nContent-Length: 3\r\nTransfer-Encoding: chunked\r\nConnection: close\r\n\r\n"
    assert answer(head + b"0\r\n\r\n")[0] == 400


def test_headers_without_end_are_431() -> None:
    many = [b"X-%d: %s\r\n" % (number, b"x" * 1000) for number in range(400)]
    assert answer(b"GET / HTTP/1.1\r\nHost: a\r\n", *many)[0] == 431


def test_one_header_without_end_is_431() -> None:
    assert answer(b"GET / HTTP/1.1\r\nX: ", *[b"x" * 10_000] * 30)[0] == 431


def test_a_url_without_end_is_431() -> None:
    assert answer(b"GET /", *[b"x" * 10_000] * 30)[0] == 431


def test_a_head_that_never_ends_is_408(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "HEAD_SECONDS", 0.05)
    assert answer(b"GET / HTTP/1.1\r\nHost:")[0] == 408


def test_a_client_that_says_nothing_is_sent_away(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "HEAD_SECONDS", 0.05)
    assert answer()[0] == 408


def test_a_second_head_that_never_ends_is_408(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "HEAD_SECONDS", 0.05)

    async def talk(port: int) -> bytes:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(b"PUT / HTTP/1.1\r\nHost: a\r\nContent-Length: 3\r\n\r\nabc")
        await reader.readuntil(b"abc")
        writer.write(b"GET / HTTP/1.1\r\nHo")
        try:
            return await reader.read()
        finally:
            writer.close()

    assert with_server(talk).startswith(b"HTTP/1.1 408")


def test_a_large_body_is_no_large_head() -> None:
    status, _, body = answer(
        b"PUT / HTTP/1.1\r\nHost: a\r\nConnection: close\r\nContent-Length: 200000\r\n\r\n", *[b"x" * 10_000] * 20
    )
    assert status == 413
    assert json.loads(body)["status"] == 413


def test_requests_in_a_row_are_answered_in_a_row() -> None:
    one = b"PUT / HTTP/1.1\r\nHost: a\r\nContent-Length: 1\r\n\r\n"
    last = b"PUT / HTTP/1.1\r\nHost: a\r\nConnection: close\r\nContent-Length: 1\r\n\r\n3"
    _, _, rest = answer(one + b"1" + one + b"2" + last)
    assert [part[-1:] for part in rest.split(b"HTTP/1.1 200 OK")][:1] == [b"1"]
    assert rest.endswith(b"3")


def test_the_server_does_not_tell_what_it_is() -> None:
    _, head, _ = answer(b"GET / HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n")
    assert b"server:" not in head
