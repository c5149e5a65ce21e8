"""Results in the formats people ask for: SELECT and ASK as JSON, XML, CSV, TSV, graphs in every RDF syntax."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import islice
from typing import BinaryIO, NamedTuple, TypeAlias, cast

from pyoxigraph import QueryBoolean, QueryResultsFormat, QuerySolutions, QueryTriples, RdfFormat, Triple, serialize

from rosld.ontology.rdfxml import rdfxml
from rosld.ontology.syntax import CannotCarry
from rosld.ontology.vocab import PREFIXES
from rosld.server.http import negotiation
from rosld.server.http.problem import Problem
from rosld.server.store import Results
from rosld.server.store.base import Term

Check: TypeAlias = Callable[[], None]
"""Raises once the time is over."""

SOLUTIONS: Mapping[str, QueryResultsFormat] = {
    "application/sparql-results+json": QueryResultsFormat.JSON,
    "application/sparql-results+xml": QueryResultsFormat.XML,
    "text/csv": QueryResultsFormat.CSV,
    "text/tab-separated-values": QueryResultsFormat.TSV,
    "application/json": QueryResultsFormat.JSON,
    "application/xml": QueryResultsFormat.XML,
    "text/xml": QueryResultsFormat.XML,
}
"""The media types of SELECT and ASK, the favourite first."""
_RDF_XML = "application/rdf+xml"
GRAPHS: Mapping[str, RdfFormat] = {
    "text/turtle": RdfFormat.TURTLE,
    "application/ld+json": RdfFormat.JSON_LD,
    "application/n-triples": RdfFormat.N_TRIPLES,
    _RDF_XML: RdfFormat.RDF_XML,
    "text/n3": RdfFormat.N3,
    "application/n-quads": RdfFormat.N_QUADS,
    "application/trig": RdfFormat.TRIG,
    "application/json": RdfFormat.JSON_LD,
}
"""The media types of CONSTRUCT and DESCRIBE, the favourite first."""
_CHARSET = frozenset({"text/csv", "text/tab-separated-values", "text/turtle", "text/n3", "text/xml"})
_PREFIXED = frozenset({RdfFormat.TURTLE, RdfFormat.TRIG, RdfFormat.N3})
_PREFIXES = dict(PREFIXES)


def choose(form: str | None, accept: str | None) -> str:
    """The media type of the answer to a query of this form; Problem 406 where none is acceptable."""
    offers = GRAPHS if form in ("CONSTRUCT", "DESCRIBE") else SOLUTIONS
    chosen = negotiation.choose(accept, _OFFERS[offers is GRAPHS])
    if chosen is None:
        raise Problem(406, f"The results of {form or 'a query'} can be had as {', '.join(offers)}.")
    return chosen


_OFFERS = {True: tuple(GRAPHS), False: tuple(SOLUTIONS)}


def content_type(media_type: str) -> str:
    """The Content-Type of a media type of results: all text is UTF-8."""
    return f"{media_type}; charset=utf-8" if media_type in _CHARSET else media_type


def write(results: Results, media_type: str, output: BinaryIO, check: Check, base: str) -> None:
    """Write results as they come. Raises what `check` and `output` raise, and Problem 406 for what XML cannot carry."""
    if isinstance(results, QueryTriples):
        _write_graph(results, GRAPHS[media_type], output, check, base)
    else:
        results.serialize(output, SOLUTIONS[media_type])


class _Few(io.RawIOBase):
    """Takes a few bytes, and raises rather than take many."""

    def __init__(self) -> None:
        super().__init__()
        self.parts: list[bytes] = []
        self._left = _FEW

    def writable(self) -> bool:
        return True

    def write(self, data: bytes) -> int:  # type: ignore[override]
        self._left -= len(data)
        if self._left < 0:
            raise _TooMany
        self.parts.append(bytes(data))
        return len(data)


class _TooMany(Exception):
    """The results are not small."""


_FEW = 64 * 1024


def few(results: Results, media_type: str) -> bytes | None:
    """The results of a SELECT or ASK as bytes, None where they turn out to be many."""
    assert not isinstance(results, QueryTriples)
    output = _Few()
    try:
        results.serialize(cast("BinaryIO", output), SOLUTIONS[media_type])
    except _TooMany:
        return None
    return b"".join(output.parts)


def _write_graph(results: QueryTriples, syntax: RdfFormat, output: BinaryIO, check: Check, base: str) -> None:
    if syntax is RdfFormat.RDF_XML:
        _write_xml(results, output, check, base)
    elif syntax in _PREFIXED:
        serialize(_checked(results, check), output, syntax, prefixes=_PREFIXES)
    elif syntax is RdfFormat.JSON_LD:
        serialize(_checked(results, check), output, syntax)
    else:
        results.serialize(output, syntax)


def _write_xml(results: QueryTriples, output: BinaryIO, check: Check, base: str) -> None:
    """XML cannot carry every graph, and the store's writer does not look; ours does, on the whole of it."""
    try:
        output.write(rdfxml(_checked(results, check), base).encode("utf-8"))
    except CannotCarry as error:
        raise Problem(406, f"{error}.") from error


def _checked(triples: Iterable[Triple], check: Check) -> Iterator[Triple]:
    for triple in triples:
        check()
        yield triple


class Table(NamedTuple):
    """The first rows of results, for a page: of a graph, subject, predicate and object; `boolean` is ASK's answer."""

    variables: tuple[str, ...] = ()
    rows: tuple[tuple[Term | None, ...], ...] = ()
    boolean: bool | None = None


def table(results: Results, limit: int, check: Check) -> Table:
    """At most `limit` rows of results. Raises what `check` raises."""
    if isinstance(results, QueryBoolean):
        return Table(boolean=bool(results))
    if isinstance(results, QuerySolutions):
        names = tuple(variable.value for variable in results.variables)
        return Table(names, tuple(_rows((tuple(row) for row in results), limit, check)))
    triples = ((triple.subject, triple.predicate, triple.object) for triple in results)
    return Table(("subject", "predicate", "object"), tuple(_rows(triples, limit, check)))


def _rows(rows: Iterator[tuple[Term | None, ...]], limit: int, check: Check) -> Iterator[tuple[Term | None, ...]]:
    for row in islice(rows, limit):
        check()
        yield row
