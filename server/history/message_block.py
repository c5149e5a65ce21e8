"""A block of messages of one topic, in a chunk or in memory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rosld.adapters.base import RecordedMessage
from rosld.server.history.channel import Channel
from rosld.server.history.chunk_index import ChunkRow
from rosld.server.history.chunk_reader import messages_in
from rosld.server.history.columns import ChunkRows, rows_of
from rosld.server.history.segments import Segments, sample_of


class MessageBlock:
    """Messages from one time until another. `rows` are all of them at once, where they are alike; else None."""

    def __init__(self, segments: Segments, row: ChunkRow, from_ns: int, until_ns: int) -> None:
        """Those of a chunk. Raises OSError, ValueError where it is damaged, and KeyError where it is gone."""
        self._at_hand: Sequence[RecordedMessage] = ()
        self._row = row
        self._from_ns, self._until_ns = from_ns, until_ns
        self._records = segments.records_of(row)
        self._channels = segments.channels_of(row.segment)
        found = rows_of(self._records)
        self.rows: ChunkRows | None = None if found is None else found.select(from_ns, until_ns)

    @classmethod
    def of(cls, messages: Sequence[RecordedMessage]) -> MessageBlock:
        """Messages that are at hand."""
        block = cls.__new__(cls)
        block.rows, block._at_hand, block._records = None, messages, b""
        return block

    @property
    def channel(self) -> Channel:
        """The channel of the rows."""
        assert self.rows is not None
        return self._channels[self.rows.channel]

    def numbers(self) -> Sequence[int]:
        """The numbers of the messages, in the order of the rows where there are any."""
        if self.rows is None:
            return [each.index for each in self.messages()]
        first = self._row.first
        return [first + ((each - first) & 0xFFFFFFFF) for each in self.rows.sequences.tolist()]

    def messages(self) -> Iterator[RecordedMessage]:
        """The messages one by one."""
        if not self._records:
            yield from self._at_hand
            return
        first = self._row.first
        for each in messages_in(self._records):
            if self._from_ns <= each.time_ns <= self._until_ns:
                number = first + ((each.sequence - first) & 0xFFFFFFFF)
                channel = self._channels[each.channel]
                yield RecordedMessage(number, channel.topic, sample_of(channel, each, number))
