"""A chunk of one topic's messages being filled."""

from __future__ import annotations

from array import array

from rosld.server.history.chunk_reader import ChunkMessage
from rosld.server.history.mcap_records import MESSAGE, MESSAGE_FIXED, MESSAGE_HEAD

MAX_MESSAGES = 500
MAX_BYTES = 4 * 1024 * 1024
MAX_SECONDS = 1.0
"""How long a chunk is filled: with what a poll and a write take on a busy machine, less than two seconds are lost."""


class TopicChunk:
    """Messages of one topic as records of MCAP, with the times and offsets of each channel. One thread fills it.

    `sequence` of a record is the message's number, of which it has 32 bits.
    """

    __slots__ = ("channels", "count", "end_ns", "entries", "numbers", "opened", "parts", "size", "start_ns", "topic")

    def __init__(self, topic: str, opened: float) -> None:
        """`opened` is when its first message came, in seconds of the monotonic clock."""
        self.topic = topic
        self.opened = opened
        self.parts: list[bytes] = []
        self.entries: dict[int, array[int]] = {}
        self.numbers: array[int] = array("Q")
        self.channels: array[int] = array("H")
        self.size = 0
        self.count = 0
        self.start_ns = 1 << 63
        self.end_ns = 0

    def add(self, channel: int, number: int, time_ns: int, data: bytes, published_ns: int | None = None) -> None:
        """Append a message, with the time when it was published where that is another one."""
        length, published = len(data), time_ns if published_ns is None else published_ns
        head = MESSAGE_HEAD.pack(MESSAGE, MESSAGE_FIXED + length, channel, number & 0xFFFFFFFF, time_ns, published)
        self.parts.append(head)
        self.parts.append(data)
        entries = self.entries.get(channel)
        if entries is None:
            entries = self.entries[channel] = array("Q")
        entries.append(time_ns)
        entries.append(self.size)
        self.numbers.append(number)
        self.channels.append(channel)
        self.size += MESSAGE_HEAD.size + length
        self.count += 1
        if time_ns < self.start_ns:
            self.start_ns = time_ns
        if time_ns > self.end_ns:
            self.end_ns = time_ns

    def is_due(self, now: float) -> bool:
        """Whether it is to be written."""
        return self.count >= MAX_MESSAGES or self.size >= MAX_BYTES or now - self.opened >= MAX_SECONDS

    def messages(self) -> list[ChunkMessage]:
        """All of it; `sequence` is the whole number."""
        heads = map(MESSAGE_HEAD.unpack, self.parts[::2])
        found = zip(heads, self.numbers, self.parts[1::2], strict=False)
        return [ChunkMessage(head[2], number, head[4], data) for head, number, data in found]

    def message(self, number: int) -> tuple[int, int, bytes] | None:
        """The channel, time and data of the message of this number; None where it is not here. Any thread may ask."""
        for at, each in enumerate(self.numbers):
            if each == number:
                head = self.parts[2 * at]
                _, _, channel, _, time_ns, _ = MESSAGE_HEAD.unpack(head)
                return channel, time_ns, self.parts[2 * at + 1]
        return None
