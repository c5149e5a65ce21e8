"""The wire of TCPROS: headers and frames, whole, split anywhere, and hostile."""

from __future__ import annotations

import asyncio
import socket
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.adapters.ros1.tcpros import (
    FIRST_BUFFER,
    BadFrame,
    FrameReceiver,
    decode_header,
    encode_header,
    frame,
    newest_frames,
    skip_frames,
)

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
    start, stop, count = skip_frames(buffer, end)
    assert count == len(whole)
    assert bytes(buffer[start + 4 : stop]) == (whole[-1] if whole else b"")
    spans, last, several = newest_frames(buffer, end, depth)
    assert (several, last) == (count, stop)
    assert [bytes(buffer[first + 4 : end_]) for first, end_ in spans] == whole[-depth:]


async def _received(pieces: list[bytes], depth: int, count: int) -> tuple[dict[str, str], list[bytes], int]:
    """What a receiver delivers of these pieces, written one after the other to a real socket."""
    header: dict[str, str] = {}
    delivered: list[bytes] = []
    total = 0
    done = asyncio.Event()

    def deliver(frames: object, number: int) -> None:
        nonlocal total
        delivered.extend(bytes(each) for each in frames)  # type: ignore[attr-defined]
        total += number
        if total >= count:
            done.set()

    def accept(fields: object) -> object:
        header.update(fields)  # type: ignore[call-overload]
        return deliver

    here, there = socket.socketpair()
    here.setblocking(False)
    there.setblocking(False)
    loop = asyncio.get_running_loop()
    transport, receiver = await loop.create_connection(lambda: FrameReceiver(b"hello", accept), sock=here)  # type: ignore[arg-type]
    receiver.depth = depth
    try:
        for piece in pieces:
            await loop.sock_sendall(there, piece)
            await asyncio.sleep(0)
        if count:
            await asyncio.wait_for(done.wait(), 60)
        assert await loop.sock_recv(there, 100) == b"hello"
    finally:
        transport.close()
        there.close()
    return header, delivered, total


@given(
    st.lists(st.integers(0, 300) | st.just(FIRST_BUFFER + 1000), min_size=1, max_size=6), st.integers(1, 50), st.data()
)
def test_frames_arrive_whole_however_the_stream_is_cut(sizes: list[int], parts: int, data: st.DataObject) -> None:
    frames = [bytes([number % 256]) * size for number, size in enumerate(sizes)]
    wire = encode_header({"type": "std_msgs/String"}) + b"".join(frame(each) for each in frames)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(wire)), max_size=parts)))
    pieces = [wire[a:b] for a, b in zip([0, *cuts], [*cuts, len(wire)], strict=True)]
    header, delivered, total = asyncio.run(_received(pieces, 10, len(frames)))
    assert header == {"type": "std_msgs/String"}
    assert total == len(frames)
    assert delivered == frames


def test_of_a_batch_only_the_newest_is_delivered_and_all_are_counted() -> None:
    wire = encode_header({"a": "b"}) + b"".join(frame(b"%d" % number) for number in range(1000))
    _, delivered, total = asyncio.run(_received([wire], 1, 1000))
    assert total == 1000
    assert delivered[-1] == b"999"
    assert len(delivered) < 20


def test_a_frame_that_claims_four_gigabytes_ends_the_connection() -> None:
    async def attempt() -> None:
        here, there = socket.socketpair()
        here.setblocking(False)
        there.setblocking(False)
        loop = asyncio.get_running_loop()
        _, receiver = await loop.create_connection(
            lambda: FrameReceiver(b"", lambda _: lambda frames, count: None), sock=here
        )
        with there:
            await loop.sock_sendall(there, encode_header({"a": "b"}) + b"\xff\xff\xff\xff")
            await asyncio.wait_for(receiver.closed, 60)

    asyncio.run(attempt())


@pytest.mark.parametrize("header", [b"\xff\xff\xff\xff", struct.pack("<II", 8, 100) + b"a=bc"])
def test_a_header_that_is_none_is_refused(header: bytes) -> None:
    async def attempt() -> None:
        here, there = socket.socketpair()
        here.setblocking(False)
        there.setblocking(False)
        loop = asyncio.get_running_loop()
        _, receiver = await loop.create_connection(
            lambda: FrameReceiver(b"", lambda _: lambda frames, count: None), sock=here
        )
        with there:
            await loop.sock_sendall(there, header)
            with pytest.raises(BadFrame):
                await asyncio.wait_for(receiver.ready, 60)

    asyncio.run(attempt())
