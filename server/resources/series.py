"""`/topics/NAME?series=FIELD`: one number of a topic over time, from the history, reduced to intervals."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from datetime import datetime, timezone
from typing import NamedTuple, Protocol
from urllib.parse import quote

import orjson
from msgspec import Struct
from starlette.responses import Response

from rosld.adapters.model import Array, MessageSchema, Primitive, Sample, TypeRef, UnknownType
from rosld.ontology.describe_views import series_document
from rosld.ontology.fields import field_at, number_type
from rosld.ontology.units import UNKNOWN, Quantity, quantity_at
from rosld.ontology.urls import Space
from rosld.server.history.chunk_index import ChunkRow
from rosld.server.history.history import History
from rosld.server.history.history_writer import HistoryWriter
from rosld.server.history.message_block import MessageBlock, columns_of, number_paths
from rosld.server.http.negotiation import choose_offer
from rosld.server.http.problem import Problem
from rosld.server.resources.memento import is_recorded, read_time
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import OFFERS
from rosld.server.rest.path_item import QueryParameter
from rosld.server.rest.resource import RESOURCE, Resource
from rosld.server.rest.state import State

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


CSV = "text/csv"
POINTS, MAX_POINTS = 500, 10_000
_SECONDS_BEFORE = 60.0
_MAX_FIELD = 500
_MAX_NAMED = 12
"""Maximum number of fields suggested for a wrong path."""
PARAMETERS = (
    QueryParameter("series", "The path of a number, such as `pose.position.x`: its values over a time."),
    QueryParameter("from", "Since when: an xsd:dateTime, or seconds before now as `-60`. Default: a minute ago."),
    QueryParameter("to", "Until when, in the same format. Default: now."),
    QueryParameter(
        "points", f"The maximum number of points of a series, up to {MAX_POINTS}.", {"type": "integer", "minimum": 1}
    ),
    QueryParameter("at", "The topic as it was at this time, an xsd:dateTime, by the history."),
)


class SeriesResource(Resource):
    """A series of a topic."""

    kind = "Series"
    shape = "Series"
    links = (RESOURCE,)

    def __init__(self, space: Space, history: History, topic: str, field: str, wanted: SeriesRange, query: str) -> None:
        super().__init__(space, f"{space.topic(topic)}?{query}")
        self.history = history
        self.topic = topic
        self.field = field
        self.wanted = wanted

    async def state(self) -> State:
        found = await self._read()
        points = [(point.time_ns, *point.statistic) for point in found.points]
        url, topic, field, is_reduced = self.url, self.space.topic(self.topic), self.field, found.is_reduced
        quantity = self._quantity()
        return State(
            lambda: series_document(url, topic, field, points, is_reduced=is_reduced, quantity=quantity),
            lambda: orjson.dumps({"topic": self.topic, "field": field, "unit": quantity.symbol, **columns(found)}),
        )

    async def custom_get(self, exchange: Exchange) -> Response | None:
        """Return the columns as CSV (RFC 4180), if requested."""
        requested = exchange.query.get("format")
        wanted = choose_offer(exchange.accept, (*OFFERS, CSV)) if requested is None else requested
        if wanted not in (CSV, "csv"):
            return None
        table = columns(await self._read())
        lines = [",".join(table), *(",".join(map(str, row)) for row in zip(*table.values(), strict=True))]
        headers = {"Vary": "Accept", "Cache-Control": "no-cache"}
        return Response("\r\n".join(lines) + "\r\n", media_type=CSV, headers=headers)

    def _quantity(self) -> Quantity:
        """Return what the field measures in all types that the topic has had."""
        recording, found = self.history.recording, set[Quantity]()
        for ref in recording.types_of(self.topic):
            with suppress(UnknownType):
                schema = recording.schema(ref)
                found.add(quantity_at(schema, self.field) if isinstance(schema, MessageSchema) else UNKNOWN)
        return found.pop() if len(found) == 1 else UNKNOWN

    async def _read(self) -> Series:
        values = FieldValues(self.history.recording.schema, self.field)
        writer = self.history.writer
        try:
            found = await asyncio.to_thread(read_series, writer, self.topic, self.field, self.wanted, values)
        except SeriesTooLong as error:
            raise Problem(422, f"{error}: request a shorter period.") from error
        except (OSError, ValueError, KeyError) as error:
            raise Problem(503, f"The history cannot be read at the moment: {error}.") from error
        if not found.points and values.problem is not None:
            raise Problem(404, f"{values.problem}.")
        return found


class FieldValues:
    """Reader of the number at a path of each message; `problem` says why a message had none."""

    def __init__(self, schema_of: Callable[[TypeRef], object], path: str) -> None:
        self.problem: str | None = None
        self._schema_of = schema_of
        self._path = path
        self._schemas: dict[TypeRef, MessageSchema | None] = {}
        self._numeric: set[TypeRef] = set()
        """Types that have a number at the path."""

    def value_of(self, sample: Sample) -> float | None:
        """Return the number of a sample, or None if it has none, as `problem` explains. Runs in any thread."""
        schema = self._schema(sample.schema)
        if schema is None:
            return None
        try:
            kind, value = field_at(schema, schema.codec.decode(sample.data, sample.encoding), self._path)
            if not isinstance(kind, Primitive) or isinstance(value, str) or not hasattr(value, "__float__"):
                raise ValueError(f"{self._path} of {schema.ref.name} is not a number")
            number = float(value)
        except ValueError as error:
            self.problem = self.problem or f"{error}{_suggestion(schema, self._path)}"
            return None
        return number if math.isfinite(number) else None

    def values_of(self, block: MessageBlock) -> Iterator[tuple[int, float | None]]:
        """Yield the time of reception in ns and the number of each message; decodes uniform blocks at once."""
        if block.rows is not None and len(block.rows.times):
            schema = self._schema(block.channel.type)
            if schema is not None and schema.ref in self._numeric:
                columns = columns_of(block.rows, schema, block.channel.encoding, [tuple(self._path.split("."))])
                if columns is not None:
                    values = columns[0].astype(float)
                    found = zip(block.rows.times.tolist(), values.tolist(), strict=True)
                    yield from ((at, value if math.isfinite(value) else None) for at, value in found)
                    return
        for each in block.messages():
            yield each.sample.received_ns, self.value_of(each.sample)

    def _schema(self, ref: TypeRef) -> MessageSchema | None:
        if ref not in self._schemas:
            try:
                found = self._schema_of(ref)
            except UnknownType as error:
                self.problem, found = error.sentence, None
            self._schemas[ref] = found if isinstance(found, MessageSchema) else None
            if isinstance(found, MessageSchema) and tuple(self._path.split(".")) in number_paths(found):
                self._numeric.add(found.ref)
        return self._schemas[ref]


def _suggestion(schema: MessageSchema, path: str) -> str:
    """Return the end of a sentence that suggests numbers for a wrong path."""
    try:
        return f": name an element, such as {path}.0" if isinstance(number_type(schema, path), Array) else ""
    except ValueError:
        paths = [".".join(each) for each in number_paths(schema)]
        near = [each for each in paths if each.startswith(f"{path}.")] or paths
        few = ", ".join(near[:_MAX_NAMED])
        return f"; numbers are {few}{' and others' if len(near) > _MAX_NAMED else ''}" if few else ""


def columns(series: Series) -> dict[str, list[float | str]]:
    """Return a series as columns: time and value of each message, or aggregates of intervals."""
    points: Sequence[Point] = series.points
    times: list[float | str] = [_utc_text(each.time_ns) for each in points]
    if not series.is_reduced:
        return {"time": times, "value": [each.statistic.minimum for each in points]}
    return {
        "time": times,
        "min": [each.statistic.minimum for each in points],
        "max": [each.statistic.maximum for each in points],
        "mean": [each.statistic.total / each.statistic.numbers for each in points],
        "count": [each.statistic.numbers for each in points],
    }


def series_of(space: Space, history: History, topic: str, exchange: Exchange) -> SeriesResource:
    """Return the requested series of a topic. Raises Problems."""
    require_history(history, topic)
    query, now = exchange.query, time.time_ns()
    field = query["series"]
    if not 0 < len(field) <= _MAX_FIELD:
        raise Problem(400, "?series= must be the path of a number, such as pose.position.x.")
    since = read_time(query.get("from", str(-_SECONDS_BEFORE)), now)
    until = read_time(query["to"], now) if "to" in query else now
    points = query.get("points", str(POINTS))
    if not (points.isascii() and points.isdecimal() and 1 <= int(points[:9]) <= MAX_POINTS):
        raise Problem(400, f"?points={points[:20]}: from 1 to {MAX_POINTS}.")
    if since >= until:
        end = f"?to={query['to'][:60]}" if "to" in query else "now"
        begin = f"?from={query['from'][:60]}" if "from" in query else "?from=, by default a minute ago,"
        raise Problem(400, f"{begin} is not before {end}.")
    requested = {name: query[name] for name in ("series", "from", "to", "points") if name in query}
    text = "&".join(f"{name}={quote(value, safe='/:.-')}" for name, value in requested.items())
    return SeriesResource(space, history, topic, field, SeriesRange(since, until, int(points)), text)


def require_history(history: History, topic: str) -> None:
    """Raise a 404 Problem without a history of a topic."""
    if not is_recorded(history, topic):
        if history.is_enabled and history.will_record(topic):
            raise Problem(404, f"Nothing is recorded of {topic} yet: its first message will be.")
        words = f"start rosld with --history {topic}, or --history '*' for all topics"
        raise Problem(404, f"Nothing is recorded of {topic}: {words}.")


def _utc_text(time_ns: int) -> str:
    seconds, rest = divmod(time_ns, 10**9)
    moment = datetime.fromtimestamp(seconds, timezone.utc)
    return f"{moment:%Y-%m-%dT%H:%M:%S}.{rest:09d}Z"
