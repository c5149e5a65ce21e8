"""A topic that rosld publishes, and its connections to subscribers, which cannot block each other or rosld."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Collection, Iterable
from typing import cast

from rosld.adapters.model import MessageSchema, TypeRef
from rosld.adapters.ros1.tcpros import LENGTH, MAX_HEADER, BadFrame, Header, decode_header, encode_header, frame
from rosld.adapters.ros1.types import ros_name
from rosld.adapters.thread import wait_event

_HIGH_WATER = 256 * 1024
_MAX_QUEUED = 8 * 1024 * 1024
_MAX_PENDING = 64 * 1024 * 1024


class Outbox:
    """Queue of frames with a maximum size in bytes: the oldest are dropped, but never the newest."""

    def __init__(self, max_bytes: int) -> None:
        self._limit = max_bytes
        self._bytes = 0
        self._frames: deque[bytes] = deque()

    def __bool__(self) -> bool:
        return bool(self._frames)

    def add(self, frame: bytes) -> None:
        """Add the newest frame."""
        self._frames.append(frame)
        self._bytes += len(frame)
        while self._bytes > self._limit and len(self._frames) > 1:
            self._bytes -= len(self._frames.popleft())

    def take(self, max_bytes: int) -> bytes:
        """Remove and return the oldest frames, joined: at least one, and within `max_bytes` if possible."""
        frames = [self._frames.popleft()]
        size = len(frames[0])
        while self._frames and size + len(self._frames[0]) <= max_bytes:
            frames.append(self._frames.popleft())
            size += len(frames[-1])
        self._bytes -= size
        return b"".join(frames)

    def take_all(self) -> list[bytes]:
        """Remove and return all frames, oldest first."""
        frames = list(self._frames)
        self._frames.clear()
        self._bytes = 0
        return frames


class Publication:
    """A topic that we publish. Everything except `matched`, `ref` and `carries` belongs to the reading thread.

    `registered_at` is the time of the master's last confirmation on the loop's clock.
    """

    def __init__(self, topic: str, schema: MessageSchema, node: str) -> None:
        self.topic = topic
        self.ref: TypeRef = schema.ref
        self.type_name = ros_name(schema.ref.name)
        self.matched = 0
        self.latched: bytes | None = None
        self.registered_at: float | None = None
        self._schema = schema
        self._node = node
        self._links: set[SubscriberConnection] = set()
        self._pending = Outbox(_MAX_PENDING)
        self._flushing = False
        self._changed = asyncio.Event()

    def carries(self, type: TypeRef) -> bool:
        """Whether the topic accepts messages of this type."""
        return type.name == self.ref.name and type.hash in (None, self.ref.hash)

    def header(self) -> dict[str, str]:
        """Return our connection header."""
        return {
            "callerid": self._node,
            "latching": "1" if self.latched is not None else "0",
            "md5sum": self.ref.hash or "*",
            "message_definition": self._schema.definition,
            "topic": self.topic,
            "type": self.type_name,
        }

    def objection(self, header: Header) -> str | None:
        """Return why a subscriber with this header is refused, or None."""
        if header.get("md5sum", "*") not in ("*", self.ref.hash):
            return f"{self.topic} is published as {self.type_name} with md5sum {self.ref.hash}, not {header['md5sum']}"
        return None

    def send(self, data: bytes, latch: bool) -> None:
        """Publish a message. Messages of one loop iteration are written together."""
        framed = frame(data)
        self.latched = framed if latch else None
        self._pending.add(framed)
        if not self._flushing:
            self._flushing = True
            asyncio.get_running_loop().call_soon(self._flush)

    async def wait_matched(self, count: int, until: float, patience: float) -> None:
        """Wait until `count` subscribers are connected, or one has been for `patience` seconds, or until a time."""
        now = asyncio.get_running_loop().time
        patient: float | None = None
        while self.matched < count:
            if self.matched and patient is None:
                patient = min(until, now() + patience)
            if not await self._wait_changed(until if patient is None else patient):
                return

    def links_to(self, nodes: Collection[str]) -> frozenset[SubscriberConnection]:
        """Return the connections to these nodes, and to subscribers without a name."""
        return frozenset(link for link in self._links if not link.node or link.node in nodes)

    async def connected_to(self, nodes: Collection[str], until: float) -> frozenset[SubscriberConnection]:
        """Wait until one of these nodes is connected, or until a time; return its connections."""
        while not (links := self.links_to(nodes)) and await self._wait_changed(until):
            pass
        return links

    async def _wait_changed(self, until: float) -> bool:
        """Wait until a subscriber connects or disconnects; return False when the time is up."""
        self._changed.clear()
        left = until - asyncio.get_running_loop().time()
        return left > 0 and await wait_event(self._changed, left)

    def join(self, link: SubscriberConnection) -> None:
        """Add a connected subscriber."""
        self._links.add(link)
        self._count()
        if self.latched is not None:
            link.send([self.latched])

    def leave(self, link: SubscriberConnection) -> None:
        """Remove a disconnected subscriber."""
        self._links.discard(link)
        self._count()

    async def close(self, patience: float) -> None:
        """Flush, wait at most `patience` seconds for subscribers to disconnect, and close all connections.

        A rospy subscriber that learns of a new registration before the end of the old connection considers itself
        connected (rospy's `_connect_topic`), and never connects again.
        """
        until = asyncio.get_running_loop().time() + patience
        self._flush()
        for link in tuple(self._links):
            await link.wait_written(until)
        for link in tuple(self._links):
            link.end()
        while self._links and await self._wait_changed(until):
            pass
        for link in tuple(self._links):
            link.close()

    def _count(self) -> None:
        self.matched = len(self._links)
        self._changed.set()

    def _flush(self) -> None:
        self._flushing = False
        frames = self._pending.take_all()
        if frames:
            for link in tuple(self._links):
                link.send(frames)


class SubscriberConnection(asyncio.Protocol):
    """A subscriber's connection. A slow subscriber loses its oldest queued messages instead of using our memory.

    `node` is the subscriber's name from its connection header.
    """

    def __init__(self, publications: dict[str, Publication]) -> None:
        self.node = ""
        self._publications = publications
        self._publication: Publication | None = None
        self._received = bytearray()
        self._outbox = Outbox(_MAX_QUEUED)
        self._paused = False
        self._ended = False
        self._drained: asyncio.Future[None] | None = None
        self._transport: asyncio.Transport

    async def wait_written(self, until: float) -> None:
        """Wait until the subscriber has received its queued messages, or until a time."""
        left = until - asyncio.get_running_loop().time()
        if self._outbox and left > 0:
            self._drained = asyncio.get_running_loop().create_future()
            await asyncio.wait([self._drained], timeout=left)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)
        self._transport.set_write_buffer_limits(high=_HIGH_WATER)

    def data_received(self, data: bytes) -> None:
        if self._publication is not None:
            return  # subscribers send nothing after their header
        self._received += data
        try:
            header = self._header()
        except BadFrame:
            self._transport.abort()
            return
        if header is not None:
            self._greet(header)

    def connection_lost(self, exc: Exception | None) -> None:
        if self._publication is not None:
            self._publication.leave(self)

    def pause_writing(self) -> None:
        self._paused = True

    def resume_writing(self) -> None:
        self._paused = False
        self._write()

    def send(self, frames: Iterable[bytes]) -> None:
        """Write frames, or queue them until the subscriber reads."""
        for each in frames:
            self._outbox.add(each)
        self._write()

    def end(self) -> None:
        """Signal the end of the stream, so that the subscriber disconnects."""
        self._ended = True
        if not self._transport.is_closing():
            self._transport.write_eof()

    def close(self) -> None:
        """Close the connection."""
        self._transport.close()

    def _write(self) -> None:
        while self._outbox and not (self._paused or self._ended or self._transport.is_closing()):
            self._transport.write(self._outbox.take(_HIGH_WATER))
        if self._drained is not None and not self._outbox and not self._drained.done():
            self._drained.set_result(None)

    def _header(self) -> dict[str, str] | None:
        """Return the subscriber's header, or None while it is incomplete. Raises BadFrame."""
        if len(self._received) < 4:
            return None
        (length,) = LENGTH.unpack_from(self._received)
        if length > MAX_HEADER:
            raise BadFrame(f"a header of {length} bytes")
        return decode_header(self._received[4 : 4 + length]) if len(self._received) >= 4 + length else None

    def _greet(self, header: Header) -> None:
        topic = header.get("topic", "")
        publication = self._publications.get(topic)
        words = f"{topic!r} is not published here" if publication is None else publication.objection(header)
        if publication is None or words:
            self._transport.write(encode_header({"error": words or ""}))
            self._transport.close()
            return
        self._received.clear()
        self.node = header.get("callerid", "")
        self._publication = publication
        self._transport.write(encode_header(publication.header()))
        publication.join(self)
