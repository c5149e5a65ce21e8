"""`/topics/NAME?series=FIELD`: one number of a topic over time, from the history, reduced to intervals."""

from __future__ import annotations

import asyncio
import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from datetime import datetime, timezone
from functools import partial
from typing import Any, NamedTuple, Protocol
from urllib.parse import quote

import orjson
from msgspec import Struct
from starlette.responses import Response

from rosld.adapters.base import FOR_EVER
from rosld.adapters.model import Array, MessageSchema, Primitive, Sample, TypeRef, UnknownType
from rosld.ontology.describe_views import series_document
from rosld.ontology.document import Document
from rosld.ontology.fields import field_at, number_type
from rosld.ontology.units import UNKNOWN, Quantity, quantity_at
from rosld.ontology.urls import Space
from rosld.server.history.chunk_index import ChunkRow, unpack_numbers
from rosld.server.history.history import History
from rosld.server.history.history_writer import HistoryWriter
from rosld.server.history.message_block import MessageBlock, columns_of, number_paths
from rosld.server.history.tables import TableParts
from rosld.server.http.conditional import digest
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import TEXT, json_array
from rosld.server.resources.memento import is_recorded, read_time
from rosld.server.resources.tables import table_response, wanted_table
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import CSV, JSON, TABLES
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


def read_series(
    writer: HistoryWriter, topic: str, span: SeriesRange, fields: Mapping[str, Values]
) -> Mapping[str, Series]:
    """Return the series of fields of a topic, whose numbers are read by their values, all from the same messages.

    The statistics of chunks are cached in the index. Raises SeriesTooLong, OSError, and ValueError for a damaged chunk.
    """
    at_hand = writer.unwritten(topic)  # first: what is written meanwhile is then in both, not in neither
    rows = writer.segments.index.of_topic(topic, span.from_ns, span.to_ns)
    first = min((each.sequence - 1 for each in at_hand), default=FOR_EVER)
    written = {number for row in rows if row.last >= first for number in unpack_numbers(row).tolist()}
    within = (each for each in at_hand if span.from_ns <= each.received_ns <= span.to_ns)
    unwritten = [each for each in within if each.sequence - 1 not in written]
    return {field: _series(writer, topic, field, span, values, rows, unwritten) for field, values in fields.items()}


def _series(
    writer: HistoryWriter,
    topic: str,
    field: str,
    span: SeriesRange,
    values: Values,
    rows: Sequence[ChunkRow],
    unwritten: Sequence[Sample],
) -> Series:
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


POINTS, MAX_POINTS = 500, 10_000
_SECONDS_BEFORE = 60.0
_MAX_FIELD = 500
_MAX_SERIES = 20
_MAX_NAMED = 12
"""Maximum number of fields suggested for a wrong path."""
PARAMETERS = (
    QueryParameter("series", "Paths of numbers, such as `pose.position.x`.", json_array(TEXT)),
    QueryParameter("from", "The start: an xsd:dateTime, or seconds before now as `-60`. Default: a minute ago."),
    QueryParameter("to", "The end, in the same format. Default: now."),
    QueryParameter(
        "points", f"The maximum number of points of a series, up to {MAX_POINTS}.", {"type": "integer", "minimum": 1}
    ),
    QueryParameter("at", "The topic as it was at this time (xsd:dateTime), from the history."),
)


class SeriesResource(Resource):
    """Series of one or several fields of a topic; several are available as columns, not as RDF."""

    kind = "Series"
    shape = "Series"
    links = (RESOURCE,)

    def __init__(
        self, space: Space, history: History, topic: str, fields: Sequence[str], wanted: SeriesRange, query: str
    ) -> None:
        super().__init__(space, f"{space.topic(topic)}?{query}")
        self.history = history
        self.topic = topic
        self.fields = fields
        self.wanted = wanted

    async def state(self) -> State:
        found = await self._read()
        times, *others = columns(found)
        table = {"time": [_utc_text(at) for at in times.values], **{each.name: each.values for each in others}}
        quantities = {field: self._quantity(field) for field in self.fields}
        if len(found) > 1:
            units = {field: quantity.symbol for field, quantity in quantities.items()}
            data = orjson.dumps({"topic": self.topic, "fields": self.fields, "units": units, **table})
            return State(self._no_document, lambda: data, token=digest(data))
        ((field, series),) = found.items()
        points = [(point.time_ns, *point.statistic) for point in series.points]
        url, topic, is_reduced, quantity = self.url, self.space.topic(self.topic), series.is_reduced, quantities[field]
        return State(
            lambda: series_document(url, topic, field, points, is_reduced=is_reduced, quantity=quantity),
            lambda: orjson.dumps({"topic": self.topic, "field": field, "unit": quantity.symbol, **table}),
        )

    def _no_document(self) -> Document:
        others = ", ".join((JSON, *TABLES.values()))
        raise Problem(406, f"Several series are columns, available as {others}; ask for one ?series= as RDF or a page.")

    async def custom_get(self, exchange: Exchange) -> Response | None:
        """Return the columns as a table, if requested; CSV (RFC 4180) needs no pyarrow."""
        format = wanted_table(exchange)
        if format is None:
            return None
        table = columns(await self._read())
        if format != "csv":
            units = {each.name: self._quantity(each.field).unit for each in table if each.field}
            values = {each.name: each.values for each in table}
            return await table_response(format, partial(_table, values, units), "series", {})
        times, *others = table
        rows = zip(map(_utc_text, times.values), *(each.values for each in others), strict=True)
        lines = [",".join(each.name for each in table)]
        lines += (",".join("" if each is None else str(each) for each in row) for row in rows)
        headers = {"Vary": "Accept", "Cache-Control": "no-cache"}
        return Response("\r\n".join(lines) + "\r\n", media_type=CSV, headers=headers)

    def _quantity(self, field: str) -> Quantity:
        """Return what a field measures in all types that the topic has had."""
        recording, found = self.history.recording, set[Quantity]()
        for ref in recording.types_of(self.topic):
            with suppress(UnknownType):
                schema = recording.schema(ref)
                found.add(quantity_at(schema, field) if isinstance(schema, MessageSchema) else UNKNOWN)
        return found.pop() if len(found) == 1 else UNKNOWN

    async def _read(self) -> Mapping[str, Series]:
        values = {field: FieldValues(self.history.recording.schema, field) for field in self.fields}
        try:
            found = await asyncio.to_thread(read_series, self.history.writer, self.topic, self.wanted, values)
        except SeriesTooLong as error:
            raise Problem(422, f"{error}: request a shorter period.") from error
        except (OSError, ValueError, KeyError) as error:
            raise Problem(503, f"The history cannot be read at the moment: {error}.") from error
        for field, series in found.items():
            if not series.points and (problem := values[field].problem) is not None:
                raise Problem(404, f"{problem}.")
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
        return f"; numeric fields are {few}{' and others' if len(near) > _MAX_NAMED else ''}" if few else ""


class Column(NamedTuple):
    """A column of series; `field` is the path of what its values measure, empty for times in ns and counts."""

    name: str
    field: str
    values: Sequence[Any]


_STATISTICS: Mapping[str, Callable[[Statistic], float]] = {
    "min": lambda each: each.minimum,
    "max": lambda each: each.maximum,
    "mean": lambda each: each.total / each.numbers,
    "count": lambda each: each.numbers,
}


def columns(found: Mapping[str, Series]) -> list[Column]:
    """Return series as columns: time and value of each message, or aggregates of intervals.

    With several fields their paths are in the names, and a value is None where a field has none at that time.
    """
    points: dict[str, dict[tuple[int, int], Statistic]] = {}
    for field, series in found.items():
        count: Counter[int] = Counter()
        points[field] = {}
        for at, statistic in series.points:  # messages may have the same time
            points[field][at, count[at]] = statistic
            count[at] += 1
    keys = sorted(set().union(*points.values()))
    table = [Column("time", "", [at for at, _ in keys])]
    for field, series in found.items():
        own, prefix = [points[field].get(key) for key in keys], "" if len(found) == 1 else f"{field}."
        if not series.is_reduced:
            values = [None if each is None else each.minimum for each in own]
            table.append(Column(field if prefix else "value", field, values))
            continue
        for name, read in _STATISTICS.items():
            values = [None if each is None else read(each) for each in own]
            table.append(Column(f"{prefix}{name}", "" if name == "count" else field, values))
    return table


def _table(columns: Mapping[str, Sequence[float | None]], units: Mapping[str, str | None]) -> TableParts:
    from rosld.server.history.table_files import table_of_columns

    table = table_of_columns(columns, units)
    return table.schema, (table,)


def series_of(space: Space, history: History, topic: str, exchange: Exchange) -> SeriesResource:
    """Return the requested series of a topic. Raises Problems."""
    require_history(history, topic)
    query, now = exchange.query, time.time_ns()
    fields = exchange.query_values("series")
    if not fields or max(map(len, fields)) > _MAX_FIELD or len(fields) > _MAX_SERIES:
        raise Problem(
            400, f"?series= must be the path of a number, such as pose.position.x; up to {_MAX_SERIES} times."
        )
    since = read_time(query.get("from", str(-_SECONDS_BEFORE)), now)
    until = read_time(query["to"], now) if "to" in query else now
    points = exchange.query_integer("points", POINTS, 1, MAX_POINTS)
    if since >= until:
        end = f"?to={query['to'][:60]}" if "to" in query else "now"
        begin = f"?from={query['from'][:60]}" if "from" in query else "?from=, by default a minute ago,"
        raise Problem(400, f"{begin} is not before {end}.")
    others = [(name, query[name]) for name in ("from", "to", "points") if name in query]
    requested = [*(("series", field) for field in fields), *others]
    text = "&".join(f"{name}={quote(value, safe='/:.-')}" for name, value in requested)
    return SeriesResource(space, history, topic, fields, SeriesRange(since, until, points), text)


def require_history(history: History, topic: str) -> None:
    """Raise a 404 Problem without a history of a topic."""
    if not is_recorded(history, topic):
        if history.is_enabled and history.will_record(topic):
            raise Problem(404, f"{topic} has no recorded messages yet.")
        words = f"start rosld with --history {topic}, or --history '*' for all topics"
        raise Problem(404, f"{topic} is not recorded: {words}.")


def _utc_text(time_ns: int) -> str:
    seconds, rest = divmod(time_ns, 10**9)
    moment = datetime.fromtimestamp(seconds, timezone.utc)
    return f"{moment:%Y-%m-%dT%H:%M:%S}.{rest:09d}Z"
