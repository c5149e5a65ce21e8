"""TCPROS: connection headers and frames, the wire format of ROS 1's topics and services.

A frame is a little-endian uint32 length and that many bytes. The first frame in each direction is a header: fields
`name=value`, each preceded by its length.

A publisher without a queue (rospy's `queue_size=None`) blocks in `publish()` when the buffers between it and a
subscriber are full. So the kernel's receive buffer must hold its messages while this process is not running.
"""

from __future__ import annotations

import asyncio
import socket
import struct
import sys
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TypeAlias, cast

SECONDS = 2.0
"""Seconds of messages that the buffer holds at the highest measured rate: one is promised, but rates vary."""
MIN_BYTES = 1024 * 1024
MAX_BYTES = 64 * 1024 * 1024
_PERMITTED = Path("/proc/sys/net/core/rmem_max")
_FORCE = 33 if sys.platform == "linux" else None
"""SO_RCVBUFFORCE, which `socket` does not define: exceeds net.core.rmem_max with CAP_NET_ADMIN."""


def buffer_size(highest_rate: float) -> int:
    """Return the buffer size for a topic of this many bytes per second."""
    return min(max(int(SECONDS * highest_rate), MIN_BYTES), MAX_BYTES)


class ReceiveBuffer:
    """Enlarges the receive buffer of a socket; never makes it smaller than the system's own tuning did."""

    def __init__(self, sock: socket.socket, now: float) -> None:
        self._socket = sock
        self._measured = (now, 0)
        self._highest = 0.0
        self._size = 0

    def fit(self, received: int, now: float) -> None:
        """Adapt the buffer to a total of `received` bytes at `now` (seconds); called about once a second."""
        then, before = self._measured
        if now - then < 0.5:
            return
        self._measured = (now, received)
        self._highest = max(self._highest, (received - before) / (now - then))
        size = buffer_size(self._highest)
        if size > self._size:
            self._size = max(size, self._size * 5 // 4)  # rates vary: larger steps avoid a call each time
            enlarge(self._socket, self._size)


def enlarge(sock: socket.socket, size: int) -> None:
    """Enlarge the kernel's receive buffer to `size` bytes, or to the permitted maximum.

    The kernel doubles the number for its own bookkeeping, and reports the doubled value.
    """
    try:
        if 2 * size <= sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF):
            return
        if _FORCE is not None:
            try:
                sock.setsockopt(socket.SOL_SOCKET, _FORCE, size)
                return
            except PermissionError:
                size = min(size, max_permitted_bytes())
        if 2 * size > sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF):
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, size)
    except OSError:
        pass  # the connection has just ended


def max_permitted_bytes() -> int:
    """Return the maximum buffer size in bytes without privileges (net.core.rmem_max), or `MAX_BYTES` if unknown."""
    try:
        return int(_PERMITTED.read_text())
    except (OSError, ValueError):
        return MAX_BYTES


LENGTH = struct.Struct("<I")
MAX_HEADER = 1024 * 1024
FIRST_BUFFER = 64 * 1024
MAX_BUFFER = 1024 * 1024
FIRST_PIECE = 4 * 1024 * 1024
"""Initial bytes allocated for an announced length; more are allocated as data arrives."""

Header: TypeAlias = Mapping[str, str]
Frame: TypeAlias = "bytes | bytearray"
Deliver: TypeAlias = Callable[[Sequence[Frame], int], None]
Accept: TypeAlias = Callable[[Header], Deliver]


class BadFrame(ValueError):
    """An invalid frame or header."""


def encode_header(fields: Header) -> bytes:
    """Return the header as one frame, including its length."""
    parts = [f"{name}={value}".encode("utf-8", "surrogateescape") for name, value in fields.items()]
    body = b"".join(LENGTH.pack(len(part)) + part for part in parts)
    return LENGTH.pack(len(body)) + body


def decode_header(body: bytes | bytearray) -> dict[str, str]:
    """Return the fields of a header without its outer length. Raises BadFrame."""
    fields: dict[str, str] = {}
    position = 0
    while position < len(body):
        if position + 4 > len(body):
            raise BadFrame("a header field lacks its length")
        (length,) = LENGTH.unpack_from(body, position)
        position += 4
        name, equals, value = bytes(body[position : position + length]).partition(b"=")
        position += length
        if position > len(body) or not equals:
            raise BadFrame("a header field is truncated or has no '='")
        fields[name.decode("utf-8", "replace")] = value.decode("utf-8", "replace")
    return fields


def frame(data: bytes) -> bytes:
    """Return the data as one frame."""
    return LENGTH.pack(len(data)) + data


async def read_frame(reader: asyncio.StreamReader, limit: int) -> bytes:
    """Return the next frame of a stream; memory grows with the received data. Raises BadFrame if it exceeds `limit`."""
    (length,) = LENGTH.unpack(await reader.readexactly(4))
    if length > limit:
        raise BadFrame(f"it announces {length} bytes, more than the limit of {limit}")
    return await reader.readexactly(length)


class LargeFrame:
    """A frame received into its own memory, which grows with the received data, not with the announced length.

    `trusted` bytes are allocated at once: a peer that has sent a frame of this size may send another.
    """

    def __init__(self, length: int, trusted: int) -> None:
        self._missing = length
        self._pieces: list[bytearray] = []
        self._filled = 0
        self._next_piece(max(FIRST_PIECE, trusted))

    def writable_view(self) -> memoryview:
        """Return the memory for the next bytes."""
        return memoryview(self._pieces[-1])[self._filled :]

    def put(self, data: memoryview) -> None:
        """Add bytes that were received elsewhere, within the room left."""
        self.writable_view()[: len(data)] = data
        self.advance(len(data))

    def advance(self, count: int) -> None:
        """Count bytes written to `writable_view`."""
        self._filled += count
        self._missing -= count
        if self._missing and self._filled == len(self._pieces[-1]):
            self._next_piece(sum(map(len, self._pieces)))

    def whole(self) -> bytes | bytearray | None:
        """Return the frame once it is complete, else None."""
        if self._missing:
            return None
        return self._pieces[0] if len(self._pieces) == 1 else b"".join(self._pieces)

    def _next_piece(self, size: int) -> None:
        self._pieces.append(bytearray(min(size, self._missing)))
        self._filled = 0


def newest_frames(buffer: bytearray, end: int, depth: int) -> tuple[list[tuple[int, int]], int, int]:
    """Return the spans of the newest `depth` complete frames, the end of the last one, and the number of all."""
    unpack = LENGTH.unpack_from
    starts: deque[int] = deque(maxlen=depth)
    position = count = 0
    last = end - 4
    while position <= last:
        stop = position + 4 + unpack(buffer, position)[0]
        if stop > end:
            break
        starts.append(position)
        position = stop
        count += 1
    return list(pairwise((*starts, position))), position, count


class FrameBuffer:
    """Bytes of incomplete frames: `data` up to `end`, at most MAX_BUFFER bytes unless requested."""

    def __init__(self) -> None:
        self.data = bytearray(FIRST_BUFFER)
        self.view = memoryview(self.data)
        self.end = 0

    def writable_view(self) -> memoryview:
        """Return the memory that the kernel writes to."""
        return self.view[self.end :]

    def grow(self, size: int) -> None:
        """Enlarge the buffer to `size` bytes."""
        if size > len(self.data):
            data = bytearray(size)
            data[: self.end] = self.data[: self.end]
            self.data, self.view = data, memoryview(data)

    def drop(self, position: int, end: int) -> None:
        """Move the bytes from `position` to `end` to the front, and drop the others."""
        rest = end - position
        if position and rest:
            self.data[:rest] = self.data[position:end]
        self.end = rest


class FrameReceiver(asyncio.BufferedProtocol):
    """Receives frames in bulk and delivers the newest of each batch.

    The kernel writes into one buffer; its complete frames are counted, and only the newest `depth` are copied. A frame
    larger than the buffer is received into its own memory; one larger than `limit` bytes ends the connection, and
    `failure` is the reason. `accept` is called with the peer's header and returns the receiver of frames; any exception
    of it ends the connection.
    """

    def __init__(self, hello: bytes, accept: Accept, limit: int) -> None:
        self.depth = 1
        self.received = 0
        self.failure: str | None = None
        self.ready: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.closed: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._hello = hello
        self._accept = accept
        self._deliver: Deliver | None = None
        self._transport: asyncio.Transport | None = None
        self._kernel: ReceiveBuffer | None = None
        self._buffer = FrameBuffer()
        self._large: LargeFrame | None = None
        self._limit = limit
        self._proven = 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)
        sock = self._transport.get_extra_info("socket")
        self._kernel = None if sock is None else ReceiveBuffer(sock, time.monotonic())
        self._transport.write(self._hello)

    def connection_lost(self, exc: Exception | None) -> None:
        error = exc or ConnectionResetError("the publisher closed the connection")
        if not self.ready.done():
            self.ready.set_exception(error)
            self.ready.exception()  # retrieved, because nobody may be waiting
        if not self.closed.done():
            self.closed.set_result(None)

    def close(self) -> None:
        """Abort the connection."""
        if self._transport is not None:
            self._transport.abort()

    def fit_buffer(self) -> None:
        """Adapt the kernel's buffer to the incoming rate; called about once a second."""
        if self._kernel is not None and not self.closed.done():
            self._kernel.fit(self.received, time.monotonic())

    def get_buffer(self, sizehint: int) -> memoryview:
        """Return the memory for the kernel: the rest of the buffer, or of the large frame being received."""
        if self._large is not None:
            return self._large.writable_view()
        return self._buffer.writable_view()

    def buffer_updated(self, nbytes: int) -> None:
        """Process received bytes."""
        self.received += nbytes
        if self._large is not None:
            self._fill_large(nbytes)
            return
        buffer = self._buffer
        end = buffer.end + nbytes
        if self._deliver is None:
            end = self._take_header(end)
            if self._deliver is None:
                return
        spans, position, count = newest_frames(buffer.data, end, self.depth)
        if count:
            self._deliver([bytes(buffer.view[start + 4 : stop]) for start, stop in spans], count)
        self._keep_rest(position, end)

    def _take_header(self, end: int) -> int:
        """Read the peer's header at the front of the buffer; return the number of bytes after it."""
        buffer = self._buffer
        buffer.end = end
        if end < 4:
            return end
        length: int = LENGTH.unpack_from(buffer.data)[0]
        try:
            if length > MAX_HEADER:
                raise BadFrame(f"a header of {length} bytes")
            if end < 4 + length:
                if end == len(buffer.data):
                    buffer.grow(2 * end)
                return end
            deliver = self._accept(decode_header(buffer.data[4 : 4 + length]))
        except Exception as error:
            self._refuse(error)
            return 0
        self._deliver = deliver
        buffer.drop(4 + length, end)
        if not self.ready.done():
            self.ready.set_result(None)
        return buffer.end

    def _refuse(self, error: Exception) -> None:
        self.failure = str(error)
        if not self.ready.done():
            self.ready.set_exception(error)
        self._buffer.end = 0
        self.close()

    def _keep_rest(self, position: int, end: int) -> None:
        """Move the bytes after the last complete frame to the front, or start to receive a large frame."""
        buffer = self._buffer
        if end - position >= 4:
            (length,) = LENGTH.unpack_from(buffer.data, position)
            if length > self._limit:
                words = (
                    f"it announces a message of {length} bytes, more than the {self._limit} of --setting message_limit"
                )
                self._refuse(BadFrame(words))
                return
            if length + 4 > len(buffer.data):
                self._large = LargeFrame(length, self._proven)
                self._large.put(buffer.view[position + 4 : end])
                buffer.end = 0
                return
        buffer.drop(position, end)
        if end == len(buffer.data) and end < MAX_BUFFER:
            buffer.grow(2 * end)

    def _fill_large(self, nbytes: int) -> None:
        assert self._large is not None
        self._large.advance(nbytes)
        whole = self._large.whole()
        if whole is not None:
            self._large = None
            self._proven = max(self._proven, len(whole))
            assert self._deliver is not None
            self._deliver((whole,), 1)
