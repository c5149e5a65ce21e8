"""Selection of messages of the history by topic, time and number; reads only the chunks in the index that match."""

from __future__ import annotations

import logging

from rosld.adapters.base import PAGE_BYTES, MessageFilter, MessagePage, RecordedMessage
from rosld.adapters.model import Sample
from rosld.server.history.chunk_index import ChunkRow, unpack_numbers
from rosld.server.history.history_writer import HistoryWriter

log = logging.getLogger("rosld.history")


def select_messages(writer: HistoryWriter, wanted: MessageFilter, limit: int) -> MessagePage:
    """Return at most `limit` messages of the history, of about `PAGE_BYTES` in total."""
    at_hand = _unwritten(writer, wanted)  # first: what is written meanwhile is then in both, not in neither
    rows = _written(writer, wanted, limit + 1)
    found: list[RecordedMessage] = []
    read: dict[int, RecordedMessage] = {}
    size = 0
    for number in sorted({*at_hand, *rows}):
        if len(found) == limit or size >= PAGE_BYTES:
            return MessagePage(found, number)
        row = rows.get(number)
        if row is not None and number not in read:
            numbers = {each for each, one in rows.items() if one is row}
            read |= {each: message for each, message in _messages(writer, row).items() if each in numbers}
        message = at_hand.get(number) or read.pop(number, None)
        if message is not None:
            found.append(message)
            size += len(message.sample.data)
    return MessagePage(found, None)


def _unwritten(writer: HistoryWriter, wanted: MessageFilter) -> dict[int, RecordedMessage]:
    return {
        number: RecordedMessage(number, channel.topic, sample)
        for number, channel, sample in writer.unwritten_messages()
        if (wanted.topics is None or channel.topic in wanted.topics) and _is_wanted(number, sample, wanted)
    }


def _written(writer: HistoryWriter, wanted: MessageFilter, limit: int) -> dict[int, ChunkRow]:
    """Return the chunks of the first `limit` messages in the index, by number."""
    found: dict[int, ChunkRow] = {}
    for segment in writer.segments.rows:
        if segment.next <= wanted.start or segment.first >= wanted.end:
            continue
        if not segment.end_ns or segment.end_ns < wanted.from_ns or segment.start_ns > wanted.to_ns:
            continue
        for topic in (None,) if wanted.topics is None else sorted(wanted.topics):
            found |= _of_segment(writer, segment.id, topic, wanted, limit)
        if len(found) >= limit:
            break  # numbers increase from segment to segment
    return {number: found[number] for number in sorted(found)[:limit]}


def _of_segment(
    writer: HistoryWriter, segment: int, topic: str | None, wanted: MessageFilter, limit: int
) -> dict[int, ChunkRow]:
    """Return the chunks of the first `limit` messages of a topic (None: of all) in a segment, by number."""
    found: dict[int, ChunkRow] = {}
    after = -1
    while True:
        batch = writer.segments.index.of_numbers(
            segment, topic, wanted.start, wanted.from_ns, wanted.to_ns, after, limit
        )
        for row in batch:
            if len(found) >= limit and row.first > sorted(found)[limit - 1]:
                return found  # this chunk and the following ones start after the last wanted message
            found |= dict.fromkeys(_numbers(writer, row, wanted), row)
        if len(batch) < limit:
            return found
        after = batch[-1].first


def _numbers(writer: HistoryWriter, row: ChunkRow, wanted: MessageFilter) -> list[int]:
    """Return the wanted numbers of a chunk, which is read only if it is partly outside the times."""
    if wanted.from_ns <= row.start_ns and row.end_ns <= wanted.to_ns:
        return [each for each in unpack_numbers(row).tolist() if wanted.start <= each < wanted.end]
    read = _messages(writer, row).values()
    return [each.index for each in read if _is_wanted(each.index, each.sample, wanted)]


def _is_wanted(number: int, sample: Sample, wanted: MessageFilter) -> bool:
    return wanted.start <= number < wanted.end and wanted.from_ns <= sample.received_ns <= wanted.to_ns


def _messages(writer: HistoryWriter, row: ChunkRow) -> dict[int, RecordedMessage]:
    """Return the messages of a chunk by number; none if it is damaged or was removed."""
    found: dict[int, RecordedMessage] = {}
    try:
        for channel, sample in writer.segments.messages_of(row):
            number = sample.sequence - 1
            found[number] = RecordedMessage(number, channel.topic, sample)
    except (OSError, ValueError) as error:
        log.warning("a part of the history cannot be read: %s", error)
    except KeyError:  # the segment was removed
        pass
    return found
