"""The wire format of TCPROS: headers and frames, whole, split anywhere, and hostile."""

from __future__ import annotations

import asyncio
import socket
import struct
import time
import tracemalloc
from collections.abc import Callable, Mapping, Sequence
from contextlib import AsyncExitStack
from unittest import mock

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.adapters.ros1 import tcpros
from rosld.adapters.ros1.tcpros import (
    FIRST_BUFFER,
    FIRST_PIECE,
    BadFrame,
    Frame,
    FrameReceiver,
    decode_header,
    encode_header,
    frame,
    newest_frames,
    read_frame,
)

MOST = 64 * 1024 * 1024
names = st.text(st.characters(blacklist_categories=["Cs"], blacklist_characters="="), min_size=1, max_size=20)
values = st.text(st.characters(blacklist_categories=["Cs"]), max_size=40)


@given(st.dictionaries(names, values, max_size=8))
def test_a_header_is_read_as_it_was_written(fields: dict[str, str]) -> None:
    encoded = encode_header(fields)
    assert struct.unpack("<I", encoded[:4])[0] == len(encoded) - 4
    assert decode_header(encoded[4:]) == fields


@given(st.binary(max_size=200))
def test_any_bytes_are_a_header_or_a_bad_frame(data: bytes) -> None:
    try:
        assert isinstance(decode_header(data), dict)
    except BadFrame:
        pass


@given(st.lists(st.binary(max_size=30), max_size=12), st.integers(0, 40), st.integers(1, 5))
def test_the_newest_whole_frames_of_a_buffer_are_found(frames: list[bytes], cut: int, depth: int) -> None:
    wire = b"".join(frame(each) for each in frames)
    end = max(0, len(wire) - cut)
    whole: list[bytes] = []
    position = 0
    for each in frames:
        position += 4 + len(each)
        if position <= end:
            whole.append(each)
    buffer = bytearray(wire + b"garbage beyond the end")
    spans, last, count = newest_frames(buffer, end, depth)
    assert (count, last) == (len(whole), sum(4 + len(each) for each in whole))
    assert [bytes(buffer[first + 4 : end_]) for first, end_ in spans] == whole[-depth:]


async def until(true: Callable[[], bool]) -> None:
    """Wait for a state that a receiver does not report."""
    end = time.monotonic() + 60
    while not true():
        assert time.monotonic() < end
        await asyncio.sleep(0.001)


class Peer:
    """The publisher's end of a connection to a receiver, which has a header at once unless it `is_silent`."""

    def __init__(self, limit: int = MOST, *, depth: int = 1, is_silent: bool = False) -> None:
        self.header: dict[str, str] = {}
        self.delivered: list[bytes] = []
        self.count = 0
        self._limit, self._depth, self._is_silent = limit, depth, is_silent

    async def __aenter__(self) -> Peer:
        here, self._there = socket.socketpair()
        here.setblocking(False)
        self._there.setblocking(False)
        loop = asyncio.get_running_loop()
        receiving = loop.create_connection(lambda: FrameReceiver(b"hello", self.accept, self._limit), sock=here)
        self._transport, self.receiver = await receiving
        self.receiver.depth = self._depth
        assert await loop.sock_recv(self._there, 100) == b"hello"
        if not self._is_silent:
            await self.sends(encode_header({"a": "b"}))
            await asyncio.wait_for(self.receiver.ready, 5)
        return self

    async def __aexit__(self, *_: object) -> None:
        self._transport.abort()
        self._there.close()

    async def sends(self, data: bytes) -> None:
        await asyncio.wait_for(asyncio.get_running_loop().sock_sendall(self._there, data), 20)

    def accept(self, fields: Mapping[str, str]) -> Callable[[Sequence[Frame], int], None]:
        self.header.update(fields)
        return self.deliver

    def deliver(self, frames: Sequence[Frame], count: int) -> None:
        self.delivered += map(bytes, frames)
        self.count += count


async def received(pieces: list[bytes], depth: int, count: int) -> Peer:
    """Return a connection over which these pieces were sent, with this many frames."""
    async with Peer(depth=depth, is_silent=True) as peer:
        for piece in pieces:
            await peer.sends(piece)
            await asyncio.sleep(0)
        await until(lambda: peer.count >= count)
        return peer


@given(
    st.lists(st.integers(0, 300) | st.sampled_from([FIRST_BUFFER + 1000, 3 * FIRST_BUFFER]), min_size=1, max_size=6),
    st.integers(1, 50),
    st.data(),
)
def test_frames_arrive_whole_however_the_stream_is_cut(sizes: list[int], parts: int, data: st.DataObject) -> None:
    frames = [bytes([number % 256]) * size for number, size in enumerate(sizes)]
    wire = encode_header({"type": "std_msgs/String"}) + b"".join(frame(each) for each in frames)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(wire)), max_size=parts)))
    pieces = [wire[a:b] for a, b in zip([0, *cuts], [*cuts, len(wire)], strict=True)]
    with mock.patch.object(tcpros, "FIRST_PIECE", FIRST_BUFFER):  # large frames arrive in more than one piece
        peer = asyncio.run(received(pieces, 10, len(frames)))
    assert peer.header == {"type": "std_msgs/String"}
    assert peer.count == len(frames)
    assert peer.delivered == frames


def test_of_a_batch_only_the_newest_is_delivered_and_all_are_counted() -> None:
    wire = encode_header({"a": "b"}) + b"".join(frame(b"%d" % number) for number in range(1000))
    peer = asyncio.run(received([wire], 1, 1000))
    assert peer.count == 1000
    assert peer.delivered[-1] == b"999"
    assert len(peer.delivered) < 20


async def test_a_header_or_a_frame_that_claims_four_gigabytes_ends_the_connection() -> None:
    huge = encode_header({"a": "b"}) + b"\xff\xff\xff\xff"
    for data in (huge, b"\xff\xff\xff\xff", struct.pack("<II", 8, 100) + b"a=bc"):
        async with Peer(is_silent=True) as peer:
            await peer.sends(data)
            await asyncio.wait_for(peer.receiver.closed, 60)
            if data is not huge:
                with pytest.raises(BadFrame):
                    await peer.receiver.ready


def test_what_a_peer_only_announces_costs_next_to_nothing_however_many_do() -> None:
    async def attempt() -> int:
        limit = 512 * 1024 * 1024
        tracemalloc.start()
        async with AsyncExitStack() as open_ones:
            for _ in range(8):
                peer = await open_ones.enter_async_context(Peer(limit))
                await peer.sends(struct.pack("<I", limit - 1) + b"x" * 100_000)
                await until(lambda at=peer: at.receiver.received >= 100_000)
            used = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return used

    assert asyncio.run(attempt()) < 8 * 6 * 1024 * 1024


async def test_a_header_that_is_announced_costs_what_arrives() -> None:
    async with Peer(is_silent=True) as peer:
        await peer.sends(struct.pack("<I", 1024 * 1024) + b"y")
        await until(lambda: peer.receiver.received >= 5)
        assert len(peer.receiver.get_buffer(-1)) <= FIRST_BUFFER


async def test_a_message_longer_than_the_limit_ends_the_connection_and_says_the_setting() -> None:
    limit = 1024 * 1024
    async with Peer(limit) as peer:
        await peer.sends(frame(b"a" * limit))
        await peer.sends(struct.pack("<I", limit + 1))
        await asyncio.wait_for(peer.receiver.closed, 5)
        assert peer.delivered == [b"a" * limit]
        assert f"{limit + 1} bytes" in (peer.receiver.failure or "")
        assert "--setting message_limit" in (peer.receiver.failure or "")


async def test_large_messages_one_after_the_other_are_received_whole() -> None:
    sizes = [3 * FIRST_PIECE + 1, 5, FIRST_PIECE, 3 * FIRST_PIECE + 1, 4 * FIRST_PIECE + 3]
    async with Peer() as peer:
        for number, size in enumerate(sizes):
            await peer.sends(frame(bytes([number]) * size))
        await until(lambda: len(peer.delivered) == len(sizes))
        assert [(len(each), each[:1], each[-1:]) for each in peer.delivered] == [
            (size, bytes([number]), bytes([number])) for number, size in enumerate(sizes)
        ]


async def test_a_response_longer_than_the_limit_is_refused_before_it_is_read() -> None:
    reader = asyncio.StreamReader()
    reader.feed_data(frame(b"a" * 10) + struct.pack("<I", 11))
    assert await read_frame(reader, 10) == b"a" * 10
    with pytest.raises(BadFrame, match="11 bytes"):
        await asyncio.wait_for(read_frame(reader, 10), 5)
