"""Summaries of recorded messages as N-Triples, for queries that only aggregate numbers (`sparql/summaries.py`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from math import isnan
from typing import NamedTuple, Protocol
from urllib.parse import unquote

import numpy as np

from rosld.adapters.base import Recording
from rosld.adapters.model import FieldType, MessageSchema, Nested, Primitive, TypeRef
from rosld.ontology.literals import DATATYPES, DTYPES, date_time, scalar_texts
from rosld.ontology.names import type_names
from rosld.ontology.urls import Space
from rosld.ontology.vocab import rdf, ros, xsd
from rosld.server.dataset.encoding import is_changed, private_datatype
from rosld.server.history.history import HistoryRecording
from rosld.server.history.message_block import number_paths
from rosld.server.history.statistics import (
    ByType,
    Statistics,
    Total,
    history_total,
    measure_between,
    statistics_of,
)
from rosld.server.sparql.summaries import COUNT, MAXIMUM, MINIMUM, TOTAL, SummaryQuery


class Span(Protocol):
    """Messages of one topic between two times in ns (inclusive)."""

    @property
    def topic(self) -> str: ...
    @property
    def from_ns(self) -> int: ...
    @property
    def until_ns(self) -> int: ...


SchemaOf = Callable[[Recording, TypeRef], "MessageSchema | None"]
Step = Callable[[int], object]


def field_path(predicates: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the fields whose properties these are."""
    return tuple(unquote(each.partition("#")[2]) for each in predicates)


class _Row(NamedTuple):
    """Totals of fields of messages of one type on a topic in a recording, and the types of its numbers by path."""

    recording: Recording
    totals: Mapping[str, Total]
    types: Mapping[tuple[str, ...], str]


class _Unknown(Exception):
    """Messages must be read."""


class SummaryText:
    """Text of the summaries that a query needs; `only` are its predicates."""

    def __init__(self, space: Space, query: SummaryQuery, only: frozenset[str], statistics: Statistics) -> None:
        self._space = space
        self._query = query
        self._only = only
        self._statistics = statistics
        self._fields = [".".join(field_path(each)) for each in query.numbers]
        self._count = 0
        self._types: dict[TypeRef, Mapping[tuple[str, ...], str] | None] = {}
        self._known: dict[str, Mapping[str, Mapping[str, Mapping[str, Total]]]] = {}

    def of(self, plans: Sequence[tuple[Recording, Sequence[Span]]], schema_of: SchemaOf, step: Step) -> str | None:
        """Return the text about messages of recordings in its stored form, None if it is not known.

        `step` is called between messages that are read.
        """
        groups: dict[tuple[str, TypeRef], list[_Row]] = {}
        try:
            for recording, spans in plans:
                for span in spans:
                    for ref, row in self._rows(recording, span, schema_of, step):
                        groups.setdefault((span.topic, ref), []).append(row)
            return "".join(self._text(topic, rows) for (topic, _), rows in groups.items())
        except _Unknown:
            return None

    def _rows(
        self, recording: Recording, span: Span, schema_of: SchemaOf, step: Step
    ) -> Iterator[tuple[TypeRef, _Row]]:
        of = recording.topics[span.topic].type
        if isinstance(recording, HistoryRecording):
            refs = recording.types_of(span.topic)
            if len({ref.name for ref in refs}) != 1:
                raise _Unknown
            of = next(iter(refs))
        for type, totals in self._totals(recording, span, of, lambda ref: schema_of(recording, ref), step):
            schema = schema_of(recording, of if of.name == type else TypeRef(type, None))
            if schema is None:
                raise _Unknown
            types = self._types_of(schema)
            if types is None or not totals or not totals[""].messages:
                continue
            if any(field not in totals or isnan(totals[field].total) for field in self._fields):
                raise _Unknown
            yield schema.ref, _Row(recording, totals, types)

    def _totals(
        self,
        recording: Recording,
        span: Span,
        of: TypeRef,
        schema_of: Callable[[TypeRef], MessageSchema | None],
        step: Step,
    ) -> Iterator[tuple[str, Mapping[str, Total]]]:
        """Yield the totals of the messages of a topic by type."""
        if isinstance(recording, HistoryRecording):
            schema = schema_of(of)
            if schema is None or self._types_of(schema) is None:
                return
            # a number proves that messages can be decoded
            fields = self._fields or [".".join(each) for each in list(number_paths(schema))[:1]]
            found = history_total(recording, span.topic, fields, (span.from_ns, span.until_ns), schema_of, step)
            if found is None:
                raise _Unknown
            yield of.name, found
            return
        key = recording.content
        if span.from_ns <= recording.start_ns and recording.end_ns <= span.until_ns and key is not None:
            if span.topic not in self._known:
                self._known[span.topic] = self._statistics.totals(span.topic, self._fields)
            totals = self._known[span.topic].get(key)
            if totals is not None:
                yield from totals.items()
                return
        by_type: ByType | None = None if key is None else self._statistics.find(key, span.topic, self._fields)
        if by_type is None:
            by_type = statistics_of(recording, span.topic, schema_of, step)
            if key is not None:
                self._statistics.keep(key, span.topic, by_type)
        yield from measure_between(recording, span.topic, (span.from_ns, span.until_ns), by_type, schema_of, step)

    def _types_of(self, schema: MessageSchema) -> Mapping[tuple[str, ...], str] | None:
        if schema.ref not in self._types:
            self._types[schema.ref] = self._read_types(schema)
        return self._types[schema.ref]

    def _read_types(self, schema: MessageSchema) -> Mapping[tuple[str, ...], str] | None:
        """Return the types of the wanted numbers of messages of a type by path, None if it has not all paths."""
        names = type_names(schema.types, self._space.types)
        ends: dict[tuple[str, ...], FieldType] = {(): Nested(schema.ref.name)}
        for path in self._query.paths:
            above = ends[path[:-1]]
            fields = schema.types[above.name].fields if isinstance(above, Nested) else ()
            field = next((each for each in fields if names[above.name].property(each.name) == path[-1]), None)  # type: ignore[union-attr]
            if field is None:
                return None
            ends[path] = field.type
        for path, iri in self._query.classes:
            end = ends[path]
            if not isinstance(end, Nested) or names[end.name].iri != iri:
                return None
        types: dict[tuple[str, ...], str] = {}
        for path in self._query.numbers:
            end = ends[path]
            if not isinstance(end, Primitive) or end.name not in DTYPES or end.name == "bool":
                raise _Unknown
            types[path] = end.name
        return types

    def _text(self, topic: str, rows: Sequence[_Row]) -> str:
        """Return the text about messages of one type on a topic in several recordings."""
        query, types = self._query, rows[0].types
        times = [row.totals[""] for row in rows]
        self._count += len(rows)
        columns: dict[str, Sequence[object]] = {
            "node": [f"{COUNT}:{self._count - number}" for number in range(len(rows))],
            "bag": [self._space.bag(row.recording.name) for row in rows],
            COUNT: _literals([str(each.messages) for each in times], "integer"),
        }
        if ros.received.value in self._only:
            for predicate, at in ((MINIMUM, 1), (MAXIMUM, 2)):
                moments = [date_time(0, int(each[at])) for each in times]
                columns[f"{predicate}:time"] = _literals(moments, "dateTime")
        for number, path in enumerate(query.numbers):
            field, dtype = ".".join(field_path(path)), DTYPES[types[path]]
            name = DATATYPES[types[path]]
            is_integer = dtype.kind in "iu"
            kinds = (dtype, name), (dtype, name), (np.dtype("i8"), "integer") if is_integer else (dtype, name)
            for at, (predicate, kind) in enumerate(zip((MINIMUM, MAXIMUM, TOTAL), kinds, strict=True), 1):
                if predicate in query.text:
                    numbers = np.array([row.totals[field][at] for row in rows]).astype(kind[0])
                    columns[f"{predicate}:{number}"] = _literals(scalar_texts(numbers), kind[1])
        template = "".join(self._template(self._space.topic(topic)))
        return "".join(template % dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True))

    def _template(self, topic: str) -> Iterator[str]:
        """Yield the lines of a summary, with the names of its values."""
        query = self._query
        nodes = {(): "%(node)s", **{path: f"%(node)s/{number}" for number, path in enumerate(query.paths)}}

        def line(subject: str, predicate: str, object: str) -> str:
            return f"<{subject}> <{predicate.replace('%', '%%')}> {object} .\n"

        yield line(topic.replace("%", "%%"), ros.past.value, "<%(node)s>")
        if COUNT in query.text:
            yield line("%(node)s", COUNT, f"%({COUNT})s")
        if ros.recordedIn.value in self._only:
            yield line("%(node)s", ros.recordedIn.value, "<%(bag)s>")
        if ros.recordedMessage.value in self._only:
            yield line("%(node)s/record", ros.recordedMessage.value, "<%(node)s>")
            yield line("%(node)s/record", ros.recordedIn.value, "<%(bag)s>")
        if ros.received.value in self._only:
            yield line("%(node)s", ros.received.value, "<%(node)s/time>")
            for predicate in (MINIMUM, MAXIMUM):
                yield line("%(node)s/time", predicate, f"%({predicate}:time)s")
        for path in query.paths:
            yield line(nodes[path[:-1]], path[-1], f"<{nodes[path]}>")
        for path, iri in query.classes:
            yield line(nodes[path], rdf.type.value, f"<{iri.replace('%', '%%')}>")
        for number, path in enumerate(query.numbers):
            for predicate in (MINIMUM, MAXIMUM, TOTAL):
                if predicate in query.text:
                    yield line(nodes[path], predicate, f"%({predicate}:{number})s")


def _literals(texts: Sequence[str], name: str) -> list[str]:
    """Return literals of an XSD datatype in their stored form."""
    plain, private = f"{xsd.iri}{name}", private_datatype(name).value
    return [f'"{text}"^^<{private if is_changed(text, name) else plain}>' for text in texts]
