"""Reads what is recorded of topics between two times."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from rosld.adapters.base import MessageFilter, Recording
from rosld.server.history.history import HistoryRecording
from rosld.server.history.message_block import MessageBlock

_PAGE = 2000
"""Messages that are read at a time from a file."""


class PastRange(NamedTuple):
    """The messages of one topic from one time until another, in ns, both included."""

    topic: str
    from_ns: int
    until_ns: int


def count_past(recording: Recording, ranges: Sequence[PastRange]) -> int:
    """At most how many messages there are, as far as that is known without reading."""
    if isinstance(recording, HistoryRecording):
        return sum(recording.count_between(*each) for each in ranges)
    return 0


def read_past(recording: Recording, ranges: Sequence[PastRange]) -> Iterator[MessageBlock]:
    """The messages, in any order, each once; what cannot be read is left out.

    Ranges of one topic must not overlap.
    """
    for each in ranges:
        if isinstance(recording, HistoryRecording):
            yield from recording.blocks_between(*each)
        else:
            yield from _in_pages(recording, each)


def _in_pages(recording: Recording, wanted: PastRange) -> Iterator[MessageBlock]:
    start: int | None = recording.first
    while start is not None:
        one = MessageFilter(frozenset({wanted.topic}), wanted.from_ns, wanted.until_ns, start)
        page = recording.select(one, _PAGE)
        yield MessageBlock.of(page.messages)
        start = page.next


def merge_ranges(ranges: Sequence[PastRange]) -> list[PastRange]:
    """The same moments in ranges that do not overlap."""
    merged: list[PastRange] = []
    for each in sorted(ranges):
        last = merged[-1] if merged else None
        if last is not None and last.topic == each.topic and each.from_ns <= last.until_ns:
            merged[-1] = last._replace(until_ns=max(last.until_ns, each.until_ns))
        elif each.from_ns <= each.until_ns:
            merged.append(each)
    return merged
