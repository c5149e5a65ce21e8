"""Query results: SELECT and ASK as JSON, XML, CSV and TSV, graphs in every RDF syntax."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain, islice
from typing import BinaryIO, NamedTuple, TypeVar, cast
from xml.sax.saxutils import quoteattr

from pyoxigraph import (
    Quad,
    QueryBoolean,
    QueryResultsFormat,
    QuerySolutions,
    QueryTriples,
    RdfFormat,
    Triple,
    serialize,
)

from rosld.ontology.rdfxml import rdfxml
from rosld.ontology.syntax import CannotCarry
from rosld.ontology.vocab import PREFIXES
from rosld.server.dataset import Results
from rosld.server.dataset.base import Term
from rosld.server.dataset.encoding import Decoder, decode_term, decode_triple
from rosld.server.http.negotiation import choose_offer
from rosld.server.http.problem import Problem
from rosld.server.sparql.query_limits import too_many_rows

_T = TypeVar("_T")

SOLUTIONS: Mapping[str, QueryResultsFormat] = {
    "application/sparql-results+json": QueryResultsFormat.JSON,
    "application/sparql-results+xml": QueryResultsFormat.XML,
    "text/csv": QueryResultsFormat.CSV,
    "text/tab-separated-values": QueryResultsFormat.TSV,
    "application/json": QueryResultsFormat.JSON,
    "application/xml": QueryResultsFormat.XML,
    "text/xml": QueryResultsFormat.XML,
}
"""Media types of SELECT and ASK, the preferred one first."""
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
"""Media types of CONSTRUCT and DESCRIBE, the preferred one first."""
DATASETS: Mapping[str, RdfFormat] = {
    "application/n-quads": RdfFormat.N_QUADS,
    "application/trig": RdfFormat.TRIG,
    "application/ld+json": RdfFormat.JSON_LD,
}
"""Media types of graphs with their names, the preferred one first."""
QUADS = "QUADS"
"""Form of a query whose solutions are written as a dataset."""
_CHARSET = frozenset({"text/csv", "text/tab-separated-values", "text/turtle", "text/n3", "text/xml"})
_PREFIXED = frozenset({RdfFormat.TURTLE, RdfFormat.TRIG, RdfFormat.N3})
_PREFIXES = dict(PREFIXES)
_MAX_HELD_BYTES = 32 * 1024 * 1024
"""Maximum number of bytes of XML held back until the end is seen."""
_NO_CHARACTER = re.compile(rb"[\x00-\x08\x0b\x0c\x0e-\x1f]|\xef\xbf[\xbe\xbf]")
XML_REASON = {"reason": "xml"}


def choose_media_type(form: str | None, accept: str | None) -> str:
    """Return the media type of the answer to a query of this form; raise Problem 406 if none is acceptable."""
    offers = media_types_of(form)
    chosen = choose_offer(accept, offers)
    if chosen is None:
        of = "A dataset" if form == QUADS else f"The results of {form or 'a query'}"
        raise Problem(406, f"{of} are available as {', '.join(offers)}.")
    return chosen


def media_types_of(form: str | None) -> tuple[str, ...]:
    """Return the media types for the answer to a query of this form, the preferred one first."""
    if form == QUADS:
        return _DATASETS
    return _GRAPHS if form in ("CONSTRUCT", "DESCRIBE") else _SOLUTIONS


_SOLUTIONS, _GRAPHS, _DATASETS = tuple(SOLUTIONS), tuple(GRAPHS), tuple(DATASETS)


def without_xml(form: str | None, accept: str | None) -> str | None:
    """Return the acceptable media type other than XML for a query of this form, None if there is none."""
    return choose_offer(accept, tuple(offer for offer in media_types_of(form) if not offer.endswith("xml")))


def content_type(media_type: str) -> str:
    """Return the Content-Type of a media type of results: all text is UTF-8."""
    return f"{media_type}; charset=utf-8" if media_type in _CHARSET else media_type


def write_results(
    results: Results, media_type: str, output: BinaryIO, limit: float, base: str, links: Sequence[str] = ()
) -> None:
    """Write results incrementally. Raises what `output` raises, and Problem 406 for what XML cannot represent.

    Raises Problem 503 for more than `limit` quads, or triples in a syntax that the store does not write itself. The
    head of JSON and XML results refers to `links` (SPARQL 1.1 Query Results JSON Format 3.1.2, XML 2.2).
    """
    if isinstance(results, QueryTriples):
        _write_graph(results, GRAPHS[media_type], output, limit, base)
    elif media_type in DATASETS:
        assert isinstance(results, QuerySolutions)
        _write_prefixed(_at_most(limit, _quads(results)), output, DATASETS[media_type])
    else:
        if links and SOLUTIONS[media_type] in (QueryResultsFormat.JSON, QueryResultsFormat.XML):
            output = cast("BinaryIO", _LinkingOutput(output, SOLUTIONS[media_type], links))
        decoder = Decoder(output)
        _write_solutions(results, media_type, cast("BinaryIO", decoder))
        decoder.finish()


class _LinkingOutput(io.RawIOBase):
    """Output that adds links to the end of the head of JSON or XML results."""

    def __init__(self, output: BinaryIO, syntax: QueryResultsFormat, links: Sequence[str]) -> None:
        super().__init__()
        self._output = output
        self._head: bytes | None = b""
        if syntax == QueryResultsFormat.JSON:
            text, self._end = f'"link":{json.dumps(links)}', b"}"
        else:
            text, self._end = "".join(f"<link href={quoteattr(each)}/>" for each in links), b"</head>"
        self._links = text.encode()

    def writable(self) -> bool:
        return True

    def write(self, data: bytes) -> int:  # type: ignore[override]
        """Hold the head back until it is complete, then pass everything on."""
        if self._head is None:
            return self._output.write(data)
        self._head += bytes(data)
        head, end, rest = self._head.partition(self._end)
        if end:
            separator = b"," if head.endswith(b"]") else b""  # of JSON, after the names of variables
            self._output.write(b"".join((head, separator, self._links, end, rest)))
            self._head = None
        return len(data)


def _write_decoded(results: QueryTriples, syntax: RdfFormat, output: BinaryIO) -> None:
    """Write a graph with the store's own writer."""
    decoder = Decoder(output)
    results.serialize(cast("BinaryIO", decoder), syntax)
    decoder.finish()


def _write_solutions(results: QuerySolutions | QueryBoolean, media_type: str, output: BinaryIO) -> None:
    syntax = SOLUTIONS[media_type]
    if isinstance(results, QueryBoolean) and media_type in _BOOLEANS:
        output.write(_BOOLEANS[media_type] % (b"true" if results else b"false"))
    elif syntax == QueryResultsFormat.XML:
        xml = _XmlOutput(output)
        results.serialize(cast("BinaryIO", xml), syntax)
        xml.finish()
    else:
        results.serialize(output, syntax)


_BOOLEANS: Mapping[str, bytes] = {
    "text/csv": b"_askResult\r\n%s\r\n",
    "text/tab-separated-values": b"?_askResult\n%s\n",
}
"""ASK in formats without booleans: a table with the column that Jena reads and writes."""


def _write_graph(results: QueryTriples, syntax: RdfFormat, output: BinaryIO, limit: float, base: str) -> None:
    triples = _at_most(limit, (decode_triple(triple) for triple in results))
    if syntax is RdfFormat.RDF_XML:
        _write_xml(triples, output, base)
    elif syntax in _PREFIXED:
        _write_prefixed(triples, output, syntax)
    elif syntax is RdfFormat.JSON_LD:
        serialize(triples, output, syntax)
    else:
        _write_decoded(results, syntax, output)


def _write_prefixed(statements: Iterator[Triple] | Iterator[Quad], output: BinaryIO, syntax: RdfFormat) -> None:
    """Write statements, declaring the prefixes that the first triples use if the syntax has prefixes."""
    if syntax not in _PREFIXED:
        serialize(statements, output, syntax)
        return
    triples = cast("Iterator[Triple]", statements)  # quads are taken and serialised alike
    first = [*islice(triples, _FIRST)]
    text = serialize(first, None, syntax, prefixes=_PREFIXES)
    assert text is not None
    used = {name.decode() for name in _PREFIX.findall(text) if name}
    prefixes = {name: iri for name, iri in _PREFIXES.items() if name in used}
    serialize(chain(first, triples), output, syntax, prefixes=prefixes)


_FIRST = 10_000
_PREFIX = re.compile(rb'"(?:[^"\\]|\\.)*"|<[^>]*>|@prefix [^\n]*|([A-Za-z][A-Za-z0-9_-]*):')


def _write_xml(triples: Iterable[Triple], output: BinaryIO, base: str) -> None:
    """Write RDF/XML with our own writer: the store's does not notice what XML cannot represent."""
    try:
        output.write(rdfxml(triples, base).encode("utf-8"))
    except CannotCarry as error:
        raise _not_in_xml(f"{error}.") from error


def _quads(solutions: QuerySolutions) -> Iterator[Quad]:
    """Yield solutions of graph, subject, predicate and object as quads."""
    for graph, subject, predicate, object in solutions:
        triple = decode_triple(Triple(subject, predicate, object))
        yield Quad(triple.subject, triple.predicate, triple.object, graph)


def _at_most(limit: float, statements: Iterable[_T]) -> Iterator[_T]:
    for number, statement in enumerate(statements, 1):
        if number > limit:
            raise too_many_rows(int(limit))
        yield statement


class ResultRows(NamedTuple):
    """First rows of results, for a page; graphs as subject, predicate and object; `boolean` is the result of ASK.

    `unread` holds the reasons why documents the query could match could not be read, by URL.
    """

    variables: tuple[str, ...] = ()
    rows: tuple[tuple[Term | None, ...], ...] = ()
    boolean: bool | None = None
    unread: Mapping[str, str] = {}


def result_rows(results: Results, limit: int) -> ResultRows:
    """Return at most `limit` rows of results."""
    if isinstance(results, QueryBoolean):
        return ResultRows(boolean=bool(results))
    if isinstance(results, QuerySolutions):
        names = tuple(variable.value for variable in results.variables)
        return ResultRows(names, tuple(_rows((tuple(row) for row in results), limit)))
    triples: Iterator[tuple[Term | None, ...]] = (
        (triple.subject, triple.predicate, triple.object) for triple in results
    )
    return ResultRows(("subject", "predicate", "object"), tuple(_rows(triples, limit)))


def _rows(rows: Iterator[tuple[Term | None, ...]], limit: int) -> Iterator[tuple[Term | None, ...]]:
    for row in islice(rows, limit):
        yield tuple(None if term is None else decode_term(term) for term in row)


def _not_in_xml(words: str) -> Problem:
    """Return the problem of results that XML cannot represent (other formats can)."""
    return Problem(406, words, extra=dict(XML_REASON))


class _XmlOutput(io.RawIOBase):
    """Output that passes XML on once it is known to be well-formed, or has more than 32 MiB.

    XML 1.0 has no way to write most control characters (2.2), and readers turn a carriage return into a line feed
    (2.11): the store's writer writes both unchanged. A carriage return is written as a reference here.
    """

    def __init__(self, output: BinaryIO) -> None:
        super().__init__()
        self._output = output
        self._held: list[bytes] | None = []
        self._size = 0
        self._rest = b""

    def writable(self) -> bool:
        return True

    def write(self, data: bytes) -> int:  # type: ignore[override]
        """Take bytes. Raises Problem 406 for a character that XML cannot represent."""
        piece = bytes(data)
        if found := _NO_CHARACTER.search(self._rest + piece):
            number = ord(found[0].decode())
            raise _not_in_xml(
                f"The results contain the character U+{number:04X}, which XML cannot represent: ask for JSON."
            )
        self._rest = piece[-2:]
        self._pass_on(piece.replace(b"\r", b"&#13;"))
        return len(piece)

    def _pass_on(self, piece: bytes) -> None:
        if self._held is None:
            self._output.write(piece)
            return
        self._held.append(piece)
        self._size += len(piece)
        if self._size > _MAX_HELD_BYTES:
            self.finish()

    def finish(self) -> None:
        """Pass on the bytes held back."""
        held, self._held = self._held, None
        for piece in held or ():
            self._output.write(piece)
