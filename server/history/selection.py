"""Selection of messages of the history by topic, time and number; reads only the chunks in the index that match."""

from __future__ import annotations

import logging

from rosld.adapters.base import PAGE_BYTES, MessageFilter, MessagePage, RecordedMessage
from rosld.adapters.model import Sample
from rosld.server.history.chunk_index import ChunkRow, unpack_numbers
from rosld.server.history.history_writer import HistoryWriter

log = logging.getLogger("rosld.history")


def select_messages(writer: HistoryWriter, criteria: MessageFilter, limit: int) -> MessagePage:
    """Return at most `limit` messages of the history, of about `PAGE_BYTES` in total."""
    at_hand = _unwritten(writer, criteria)  # first: what is written meanwhile is then in both, not in neither
    rows = _written(writer, criteria, limit + 1)
    messages: list[RecordedMessage] = []
    read: dict[int, RecordedMessage] = {}
    size = 0
    for number in sorted({*at_hand, *rows}):
        if len(messages) == limit or size >= PAGE_BYTES:
            return MessagePage(messages, number)
        row = rows.get(number)
        if row is not None and number not in read:
            numbers = {each for each, one in rows.items() if one is row}
            read |= {each: message for each, message in _messages(writer, row).items() if each in numbers}
        message = at_hand.get(number) or read.pop(number, None)
        if message is not None:
            messages.append(message)
            size += len(message.sample.data)
    return MessagePage(messages, None)


def _unwritten(writer: HistoryWriter, criteria: MessageFilter) -> dict[int, RecordedMessage]:
    return {
        number: RecordedMessage(number, channel.topic, sample)
        for number, channel, sample in writer.unwritten_messages()
        if (criteria.topics is None or channel.topic in criteria.topics) and _matches(number, sample, criteria)
    }


def _written(writer: HistoryWriter, criteria: MessageFilter, limit: int) -> dict[int, ChunkRow]:
    """Return the chunks of the first `limit` messages in the index, by number."""
    rows: dict[int, ChunkRow] = {}
    for segment in writer.segments.rows:
        if segment.next <= criteria.start or segment.first >= criteria.end:
            continue
        if not segment.end_ns or segment.end_ns < criteria.from_ns or segment.start_ns > criteria.to_ns:
            continue
        for topic in (None,) if criteria.topics is None else sorted(criteria.topics):
            rows |= _of_segment(writer, segment.id, topic, criteria, limit)
        if len(rows) >= limit:
            break  # numbers increase from segment to segment
    return {number: rows[number] for number in sorted(rows)[:limit]}


def _of_segment(
    writer: HistoryWriter, segment: int, topic: str | None, criteria: MessageFilter, limit: int
) -> dict[int, ChunkRow]:
    """Return the chunks of the first `limit` messages of a topic (None: of all) in a segment, by number."""
    rows: dict[int, ChunkRow] = {}
    after = -1
    while True:
        batch = writer.segments.index.of_numbers(
            segment, topic, criteria.start, criteria.from_ns, criteria.to_ns, after, limit
        )
        for row in batch:
            if len(rows) >= limit and row.first > sorted(rows)[limit - 1]:
                return rows  # this chunk and the following ones start after the last wanted message
            rows |= dict.fromkeys(_numbers(writer, row, criteria), row)
        if len(batch) < limit:
            return rows
        after = batch[-1].first


def _numbers(writer: HistoryWriter, row: ChunkRow, criteria: MessageFilter) -> list[int]:
    """Return the wanted numbers of a chunk, which is read only if it is partly outside the times."""
    if criteria.from_ns <= row.start_ns and row.end_ns <= criteria.to_ns:
        return [each for each in unpack_numbers(row).tolist() if criteria.start <= each < criteria.end]
    read = _messages(writer, row).values()
    return [each.index for each in read if _matches(each.index, each.sample, criteria)]


def _matches(number: int, sample: Sample, criteria: MessageFilter) -> bool:
    return criteria.start <= number < criteria.end and criteria.from_ns <= sample.received_ns <= criteria.to_ns


def _messages(writer: HistoryWriter, row: ChunkRow) -> dict[int, RecordedMessage]:
    """Return the messages of a chunk by number; none if it is damaged or was removed."""
    messages: dict[int, RecordedMessage] = {}
    try:
        for channel, sample in writer.segments.messages_of(row):
            number = sample.sequence - 1
            messages[number] = RecordedMessage(number, channel.topic, sample)
    except (OSError, ValueError) as error:
        log.warning("a part of the history cannot be read: %s", error)
    except KeyError:  # the segment was removed
        pass
    return messages
