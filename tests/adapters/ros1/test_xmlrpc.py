"""XML-RPC: values survive a round trip, and hostile documents are rejected."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from datetime import datetime
from typing import TypeAlias

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.adapters.model import Refused, Sent, TimedOut, Unreachable
from rosld.adapters.model.parameter import ParameterValue
from rosld.adapters.ros1.publications import XmlRpcServer
from rosld.adapters.ros1.xmlrpc import (
    Answer,
    Malformed,
    XmlRpcClient,
    decode_answer,
    decode_call,
    encode_answer,
    encode_call,
    encode_fault,
)
from tests.adapters.ros1.system import free_port

Streams: TypeAlias = tuple[asyncio.StreamReader, asyncio.StreamWriter]

text = st.text(st.characters(min_codepoint=32, blacklist_categories=["Cs"], blacklist_characters="\ufffe\uffff\x7f"))
scalars = (
    st.booleans()
    | st.integers(-(2**31), 2**31 - 1)
    | st.floats(allow_nan=False, allow_infinity=False)
    | text
    | st.binary(max_size=20)
    | st.datetimes(min_value=datetime(1000, 1, 1)).map(lambda moment: moment.replace(microsecond=0))
)
values = st.recursive(scalars, lambda below: st.lists(below, max_size=3) | st.dictionaries(text, below, max_size=3))


@given(values)
def test_a_value_survives_the_wire(value: ParameterValue) -> None:
    assert decode_answer(encode_answer(Answer(1, "ok", value))) == Answer(1, "ok", value)
    assert decode_call(encode_call("setParam", "/rosld", value)) == ("setParam", ["/rosld", value])


@given(st.binary(max_size=300) | st.text(alphabet="<>/valuestringintarraydata ", max_size=200).map(str.encode))
def test_any_bytes_are_read_or_malformed(document: bytes) -> None:
    with contextlib.suppress(Malformed):
        decode_answer(document)
    with contextlib.suppress(Malformed):
        decode_call(document)


NAMELESS = b"<params><param><value><struct><member><value><i4>1</i4></value></member></struct></value></param></params>"
HOSTILE = {
    b'<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;">]>'
    + encode_call("f", "x").split(b"?>")[1]: "DOCTYPE",
    b"<methodCall><methodName>f</methodName><params><param>" + b"<value><array><data>" * 100_000: "deep",
    b"<methodCall><methodName>f</methodName>" + NAMELESS + b"</methodCall>": "not XML-RPC",
}


def test_entities_deep_nesting_and_a_struct_without_a_name_are_refused() -> None:
    for document, words in HOSTILE.items():
        with pytest.raises(Malformed, match=words):
            decode_call(document)


def test_a_fault_is_refused_with_its_words() -> None:
    with pytest.raises(Refused) as caught:
        decode_answer(encode_fault("no such thing"))
    assert caught.value.words == "no such thing"


@contextlib.asynccontextmanager
async def _serving(answer: Callable[[str, object], Answer]) -> AsyncIterator[tuple[XmlRpcServer, int]]:
    server = XmlRpcServer(answer)
    port = await server.start("127.0.0.1")
    try:
        yield server, port
    finally:
        server.close()


def _client(port: int, connections: list[Streams] | None = None) -> XmlRpcClient:
    """Return a client that records its `connections`."""

    async def connect() -> Streams:
        streams = await asyncio.open_connection("127.0.0.1", port)
        if connections is not None:
            connections.append(streams)
        return streams

    return XmlRpcClient(f"http://127.0.0.1:{port}", "/RPC2", connect, keep_alive=True)


async def test_our_client_speaks_with_our_server_over_one_connection() -> None:
    async with _serving(lambda method, arguments: Answer(1, method, list(arguments))) as (_, port):  # type: ignore[call-overload]
        connections: list[Streams] = []
        client = _client(port, connections)
        for number in range(3):
            assert await client.call("add", number, timeout=5) == Answer(1, "add", [number])
        assert len(connections) == 1
        client.close()


async def test_a_kept_connection_that_died_is_replaced() -> None:
    async with _serving(lambda method, arguments: Answer(1, "", 0)) as (_, port):
        connections: list[Streams] = []
        client = _client(port, connections)
        await client.call("a", timeout=5)
        connections[0][1].transport.abort()
        assert (await client.call("b", timeout=5)).code == 1
        assert len(connections) == 2
        client.close()


def test_nobody_listening_is_unreachable_and_nothing_was_sent() -> None:
    with pytest.raises(Unreachable) as caught:
        asyncio.run(_client(free_port()).call("getPid", "/x", timeout=5))
    assert caught.value.sent is Sent.NO


async def test_a_server_that_never_answers_is_timed_out() -> None:
    hanging = await asyncio.start_server(lambda reader, writer: asyncio.sleep(30), "127.0.0.1", 0)
    async with hanging:
        with pytest.raises(TimedOut) as caught:
            await _client(hanging.sockets[0].getsockname()[1]).call("getPid", "/x", timeout=0.2)
        assert caught.value.sent is Sent.MAYBE


async def test_a_server_that_is_no_master_is_unreachable() -> None:
    replies = [
        b"HTTP/1.1 200 OK\r\nContent-Length: 99999999999999\r\n\r\n",
        b"HTTP/1.1 200 OK\r\nContent-Length: -5\r\n\r\n",
        b"HTTP/1.1 500 Oh\r\nContent-Length: 0\r\n\r\n",
        b"SSH-2.0-hello\r\n\r\n",
        b"HTTP/1.1 200 OK\r\n" + b"X: " + b"y" * 200_000,
        b"HTTP/1.1 200 OK\r\nContent-Length: 3\r\n\r\nabc",
    ]
    left = list(replies)

    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readuntil(b"\r\n\r\n")
        writer.write(left.pop())
        writer.close()

    async with await asyncio.start_server(answer, "127.0.0.1", 0) as server:
        for _ in replies:
            with pytest.raises(Unreachable):
                await _client(server.sockets[0].getsockname()[1]).call("getPid", "/x", timeout=5)
    assert not left


async def test_our_server_survives_what_is_no_call() -> None:
    async with _serving(lambda method, arguments: Answer(1, "", 0)) as (_, port):
        for request, expected in {
            b"GET / HTTP/1.1\r\n\r\n": b"HTTP/1.1 405",
            b"POST / HTTP/1.1\r\nContent-Length: 5\r\n\r\nhello": b"HTTP/1.1 200",
            b"POST / HTTP/1.1\r\nContent-Length: 999999999\r\n\r\n": b"",
            b"\x16\x03\x01" * 10 + b"\r\n\r\n": b"HTTP/1.1 405",
        }.items():
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(request)
            assert (await asyncio.wait_for(reader.read(12), 60)) == expected
            writer.close()
            assert (await _client(port).call("still", timeout=5)).code == 1
