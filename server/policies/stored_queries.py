"""Stored queries: those shipped with rosld, and those that clients store under `/queries/`."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Mapping

from pyoxigraph import NamedNode, Triple

from rosld.ontology.charsets import UTF_8, codec_of, decode
from rosld.ontology.triples import labelled, text, triples_about
from rosld.ontology.urls import Space, decode_segment
from rosld.ontology.vocab import dcterms, rdf, ros
from rosld.server.http.negotiation import parse_media_type
from rosld.server.http.problem import Problem
from rosld.server.runtime.version_cache import VersionCache
from rosld.server.sparql.stored_query import StoredQuery, outline, read_stored_query, shipped_queries
from rosld.server.sparql.syntax.lexer import DEFAULT_BOUNDS
from rosld.server.storage.record import Blob, Model, Record, RecordChange
from rosld.server.storage.sqlite import Records

ROUTE = "queries/"
_CACHE_SIZE = 256
"""Maximum number of cached texts."""


class StoredQueries:
    """The stored queries, always read from the records, which are the only copy."""

    def __init__(self, records: Records, space: Space) -> None:
        self.shipped: Mapping[str, StoredQuery] = shipped_queries()
        self.version = records.version
        """Version of the last change of records below `/queries/`; it increases across runs too."""
        self.lock = asyncio.Lock()
        """Lock held while a write is validated and applied."""
        self._records = records
        self._space = space
        self._outlines = VersionCache[StoredQuery](_CACHE_SIZE)
        self._checked = VersionCache["StoredQuery | str"](_CACHE_SIZE)

    def on_record_change(self, change: RecordChange) -> None:
        """Update the version after a change of a record."""
        if change.path.startswith(ROUTE):
            self.version = max(self.version, change.version)

    def stored_records(self, *, limit: int | None = None) -> Iterator[Record]:
        """Yield the first `limit` documents below `/queries/`, in order of creation."""
        last = 0
        while limit is None or limit > 0:
            found = self._records.members(ROUTE, after=last, limit=1000 if limit is None else min(limit, 1000))
            if not found:
                return
            last = found[-1].number
            limit = None if limit is None else limit - len(found)
            for member in found:
                record = self._records.get(member.path)
                if record is not None and record.model is Model.NON_RDF_SOURCE:
                    yield record

    def all(self, *, limit: int | None = None) -> Iterator[tuple[str, StoredQuery]]:
        """Yield the queries with their URLs, the shipped ones first, then stored ones up to a limit."""
        stored = {self._space.base + record.path: self.outline(record) for record in self.stored_records(limit=limit)}
        for name, query in self.shipped.items():
            if self._space.query(name) not in stored:
                yield self._space.query(name), query
        yield from stored.items()

    def outline(self, record: Record) -> StoredQuery:
        """Return the outline of a stored query; the purpose of an invalid one is the reason (thread-safe)."""
        assert record.blob is not None
        return self._outlines.get_or_make(record.blob.id, None, lambda: self._outline(record))

    def description(self, record: Record) -> list[Triple]:
        """Return the RDF in the text of a stored query; none for other records (thread-safe)."""
        if record.model is not Model.NON_RDF_SOURCE or not record.path.startswith(ROUTE):
            return []
        return query_triples(self._space.base + record.path, self.outline(record))

    async def executable(self, record: Record) -> StoredQuery:
        """Return a stored query that can be run. Raises a 409 Problem with the reason if it is (no longer) valid."""
        assert record.blob is not None
        id = record.blob.id
        found = self._checked.find(id, None)
        if found is None:
            found = self._checked.put(id, None, await asyncio.to_thread(self._parse_record, record))
        if isinstance(found, str):
            url = self._space.base + record.path
            raise Problem(409, f"The content of {url} is not a valid stored query: {found}. PUT a valid one.")
        return found

    def check(self, path: str, blob: Blob) -> None:
        """Raise ValueError, naming the line, if a blob is not a valid stored query."""
        name = name_of(path)
        read_stored_query(name, self._text(name, blob))

    def _outline(self, record: Record) -> StoredQuery:
        name = name_of(record.path)
        assert record.blob is not None
        try:
            content = self._text(name, record.blob)
        except (OSError, ValueError) as error:
            return StoredQuery(name, f"It cannot be read: {error}", (), "")
        try:
            return outline(name, content)
        except ValueError as error:
            return StoredQuery(name, f"It is not a valid stored query: {error}", (), content)

    def _parse_record(self, record: Record) -> StoredQuery | str:
        name = name_of(record.path)
        assert record.blob is not None
        try:
            return read_stored_query(name, self._text(name, record.blob))
        except (OSError, ValueError) as error:
            return str(error)

    def _text(self, name: str, blob: Blob) -> str:
        if blob.size > 4 * DEFAULT_BOUNDS.size:
            raise ValueError(f"{name}: a query of {blob.size} bytes is too large")
        data = self._records.file(blob).read_bytes()
        charset = parse_media_type(blob.media_type).parameter("charset") or UTF_8
        try:
            return data.decode("utf-8") if codec_of(charset) == UTF_8 else decode(data, codec_of(charset))
        except UnicodeDecodeError as error:
            line = data[: error.start].count(b"\n") + 1
            raise ValueError(f"{name}:{line}: this is not valid {charset.upper()} ({error.reason})") from error


def query_triples(url: str, query: StoredQuery) -> list[Triple]:
    """Return a stored query as RDF: its purpose, its parameters, its text."""
    return triples_about(
        NamedNode(url),
        (rdf.type, ros.Query),
        *labelled(ros.name, query.name),
        (dcterms.description, text(query.purpose)),
        *((ros.queryParameter, text(parameter.name)) for parameter in query.parameters),
        (ros.text, text(query.text)),
    )


def name_of(path: str) -> str:
    """Return the name of the query with this path."""
    return decode_segment(path.removeprefix(ROUTE))
