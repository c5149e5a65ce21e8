"""Reader of recorded messages between two times, from either end."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from rosld.adapters.base import MessageFilter, Recording
from rosld.server.history.history import HistoryRecording
from rosld.server.history.message_block import MessageBlock

_PAGE = 2000
"""Number of messages read from a file at a time."""


class PastRange(NamedTuple):
    """Messages of one topic between two times in ns (inclusive)."""

    topic: str
    from_ns: int
    until_ns: int


def count_past(recording: Recording, ranges: Sequence[PastRange]) -> int:
    """Return an upper bound of the number of messages, as far as it is known without reading."""
    if isinstance(recording, HistoryRecording):
        return sum(recording.count_between(*each) for each in ranges)
    return 0


def read_past(recording: Recording, ranges: Sequence[PastRange]) -> Iterator[MessageBlock]:
    """Yield each message once, in any order, without unreadable ones.

    Ranges of one topic must not overlap.
    """
    for each in ranges:
        if isinstance(recording, HistoryRecording):
            yield from recording.blocks_between(*each)
        else:
            yield from _in_pages(recording, each)


def _in_pages(recording: Recording, span: PastRange) -> Iterator[MessageBlock]:
    start: int | None = recording.first
    while start is not None:
        criteria = MessageFilter(frozenset({span.topic}), span.from_ns, span.until_ns, start)
        page = recording.select(criteria, _PAGE)
        yield MessageBlock.of(page.messages)
        start = page.next


def merge_ranges(ranges: Sequence[PastRange]) -> list[PastRange]:
    """Return ranges for the same times that do not overlap."""
    merged: list[PastRange] = []
    for each in sorted(ranges):
        last = merged[-1] if merged else None
        if last is not None and last.topic == each.topic and each.from_ns <= last.until_ns:
            merged[-1] = last._replace(until_ns=max(last.until_ns, each.until_ns))
        elif each.from_ns <= each.until_ns:
            merged.append(each)
    return merged


_PIECES = 1000
"""Number of equal parts of a recording without an index, over which its messages are assumed to be spread evenly."""


def time_of_end(plans: Sequence[tuple[Recording, Sequence[PastRange]]], most: int, *, is_newest: bool) -> int | None:
    """Return a time after (or before) which there are about `most` messages; None if there are fewer.

    With an index the result is exact, except for chunks that extend beyond the ranges; otherwise it is an estimate.
    """
    spans = [
        span
        for recording, ranges in plans
        for each in ranges
        for span in _spans(recording, each, most, is_newest=is_newest)
    ]
    count = 0
    for start, end, messages in sorted(spans, key=lambda span: -span[0] if is_newest else span[1]):
        count += messages
        if count >= most:
            return start if is_newest else end
    return None


def clip_ranges(ranges: Sequence[PastRange], bound: int, *, is_newest: bool) -> list[PastRange]:
    """Return the parts of ranges at or after (`is_newest`) or at or before a time."""
    if is_newest:
        clipped = (each._replace(from_ns=max(each.from_ns, bound)) for each in ranges)
    else:
        clipped = (each._replace(until_ns=min(each.until_ns, bound)) for each in ranges)
    return [each for each in clipped if each.from_ns <= each.until_ns]


def _spans(recording: Recording, span: PastRange, most: int, *, is_newest: bool) -> Iterator[tuple[int, int, int]]:
    """Yield start, end and number of messages of time ranges; altogether more than `most` messages, or all."""
    if isinstance(recording, HistoryRecording):
        yield from recording.spans_at_end(*span, most + 1, is_newest=is_newest)  # each span has at least one message
        return
    count = recording.topics[span.topic].count
    start, end = recording.start_ns, recording.end_ns
    if count <= most or end <= start:
        yield start, end, count
        return
    pieces = min(count, _PIECES)
    for piece in range(pieces):
        begins, ends = (start + (end - start) * (piece + side) // pieces for side in (0, 1))
        if ends >= span.from_ns and begins <= span.until_ns:
            yield begins, ends, max(1, count // pieces)
