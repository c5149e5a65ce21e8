"""The time until which recorded messages must be read to have so many of the newest, or of the oldest."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rosld.adapters.base import Recording
from rosld.server.history.history import HistoryRecording
from rosld.server.history.past_reader import PastRange

_PIECES = 1000
"""Pieces of equal length that a recording without an index is taken to have its messages in, evenly."""


def time_of_end(plans: Sequence[tuple[Recording, Sequence[PastRange]]], most: int, *, is_newest: bool) -> int | None:
    """A time from which on, or until which, there are about `most` messages; None where there are no more in all.

    What an index tells is exact, but for chunks that reach beyond the ranges; what a rate tells is not.
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
    """What of ranges is at a time, or on the newer or older side of it."""
    if is_newest:
        clipped = (each._replace(from_ns=max(each.from_ns, bound)) for each in ranges)
    else:
        clipped = (each._replace(until_ns=min(each.until_ns, bound)) for each in ranges)
    return [each for each in clipped if each.from_ns <= each.until_ns]


def _spans(recording: Recording, wanted: PastRange, most: int, *, is_newest: bool) -> Iterator[tuple[int, int, int]]:
    """Times that messages lie between, and how many: more than `most`, or of all."""
    if isinstance(recording, HistoryRecording):
        yield from recording.spans_at_end(*wanted, most + 1, is_newest=is_newest)  # each has a message
        return
    count = recording.topics[wanted.topic].count
    start, end = recording.start_ns, recording.end_ns
    if count <= most or end <= start:
        yield start, end, count
        return
    pieces = min(count, _PIECES)
    for piece in range(pieces):
        begins, ends = (start + (end - start) * (piece + side) // pieces for side in (0, 1))
        if ends >= wanted.from_ns and begins <= wanted.until_ns:
            yield begins, ends, max(1, count // pieces)
