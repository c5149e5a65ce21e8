"""Series: a field of a topic's messages over time, reduced to minimum, maximum and mean of intervals."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple, Protocol

from msgspec import Struct

from rosld.adapters.model import Sample
from rosld.server.history.chunk_index import ChunkRow
from rosld.server.history.history_writer import HistoryWriter
from rosld.server.history.message_block import MessageBlock

MAX_READ = 500_000
"""Maximum number of messages that one series may read; cached statistics are not limited."""


class Statistic(NamedTuple):
    """Statistic of the numbers in an interval that has at least one."""

    minimum: float
    maximum: float
    total: float
    numbers: int

    def join(self, other: Statistic) -> Statistic:
        """Combine two statistics."""
        return Statistic(
            min(self.minimum, other.minimum),
            max(self.maximum, other.maximum),
            self.total + other.total,
            self.numbers + other.numbers,
        )


class Point(NamedTuple):
    """A time in ns, or the start of an interval, and the statistic of its numbers."""

    time_ns: int
    statistic: Statistic


class SeriesRange(Struct, frozen=True):
    """Range of times in ns, and the maximum number of points."""

    from_ns: int
    to_ns: int
    points: int

    def interval(self, time_ns: int) -> int:
        """Return the index of the interval of a time within the range."""
        return min((time_ns - self.from_ns) * self.points // max(self.to_ns - self.from_ns, 1), self.points - 1)

    def begin(self, interval: int) -> int:
        """Return the start of an interval, in ns."""
        return self.from_ns + interval * (self.to_ns - self.from_ns) // self.points


class Series(Struct, frozen=True):
    """The points, ascending. `is_reduced`: each is for an interval, else for one message."""

    points: Sequence[Point]
    is_reduced: bool


class Values(Protocol):
    """Reader of a number in messages; None for messages without it."""

    def value_of(self, sample: Sample) -> float | None:
        """Return the value in one message."""
        ...

    def values_of(self, block: MessageBlock) -> Iterable[tuple[int, float | None]]:
        """Return the values in many messages, each with its time of receipt in ns."""
        ...


class SeriesTooLong(ValueError):
    """A series requires more messages than one request may read."""


def read_series(writer: HistoryWriter, topic: str, field: str, span: SeriesRange, values: Values) -> Series:
    """Return the series of a topic's field, whose numbers are read by `values`.

    The statistics of chunks are cached in the index. Raises SeriesTooLong, OSError, and ValueError for a damaged chunk.
    """
    rows = writer.segments.index.of_topic(topic, span.from_ns, span.to_ns)
    unwritten = [each for each in writer.unwritten(topic) if span.from_ns <= each.received_ns <= span.to_ns]
    if sum(row.messages for row in rows) + len(unwritten) <= span.points:
        samples = [*unwritten, *(sample for row in rows for _, sample in writer.segments.messages_of(row))]
        within = (each for each in samples if span.from_ns <= each.received_ns <= span.to_ns)
        points = ((each.received_ns, values.value_of(each)) for each in sorted(within, key=_received))
        return Series([Point(at, single(value)) for at, value in points if value is not None], is_reduced=False)
    intervals: dict[int, Statistic] = {}

    def add(interval: int, statistic: Statistic | None) -> None:
        if statistic is not None:
            previous = intervals.get(interval)
            intervals[interval] = statistic if previous is None else previous.join(statistic)

    statistics = writer.segments.index.statistics(topic, field, span.from_ns, span.to_ns)
    read = 0
    for row in rows:
        is_whole = span.from_ns <= row.start_ns and row.end_ns <= span.to_ns
        interval = span.interval(row.start_ns) if is_whole else -1
        is_one = is_whole and interval == span.interval(row.end_ns)
        if is_one and (entry := statistics.get((row.segment, row.at))) is not None:
            add(interval, Statistic(*entry) if entry[3] else None)
            continue
        read += row.messages
        if read > MAX_READ:
            raise SeriesTooLong(f"more than {MAX_READ} messages would be read")
        numbers = values.values_of(MessageBlock(writer.segments, row, span.from_ns, span.to_ns))
        if is_one:
            add(interval, _of_chunk(writer, row, field, numbers))
        else:
            _add_each(add, span, numbers)
    _add_each(add, span, ((each.received_ns, values.value_of(each)) for each in unwritten))
    return Series([Point(span.begin(each), intervals[each]) for each in sorted(intervals)], is_reduced=True)


def single(value: float) -> Statistic:
    """Return the statistic of one number."""
    return Statistic(value, value, value, 1)


def _add_each(
    add: Callable[[int, Statistic | None], None], span: SeriesRange, numbers: Iterable[tuple[int, float | None]]
) -> None:
    for at, value in numbers:
        add(span.interval(at), None if value is None else single(value))


def _of_chunk(
    writer: HistoryWriter, row: ChunkRow, field: str, numbers: Iterable[tuple[int, float | None]]
) -> Statistic | None:
    """Return the statistic of a chunk, and store it in the index."""
    values = [value for _, value in numbers if value is not None and math.isfinite(value)]
    statistic = Statistic(min(values), max(values), math.fsum(values), len(values)) if values else None
    writer.segments.index.keep_statistic(row, field, statistic or (0.0, 0.0, 0.0, 0))
    return statistic


def _received(sample: Sample) -> int:
    return sample.received_ns
