"""What clients keep, as entries to be found: stored queries, mappings and documents by their paths and titles."""

from __future__ import annotations

import asyncio
import re

from rosld.ontology.urls import Space, locate
from rosld.ontology.vocab import dcterms, rdfs, schema_org
from rosld.server.policies import stored_cockpits, stored_mappings
from rosld.server.policies.stored_queries import StoredQueries
from rosld.server.resources.ldp.documents import Documents
from rosld.server.search.entry import Entry, EntryKind
from rosld.server.storage.record import Record
from rosld.server.storage.record_documents import unpack_prefix

MAX_KEPT = 500
"""Documents that are looked through, those that lie highest first: the rest is for SPARQL."""
_MAX_BYTES = 8192
"""Bytes of a document in which its titles are looked for."""
_AT_ONCE = 25
"""Documents that are read before the loop has its turn."""
_NAMING = "|".join(map(re.escape, (dcterms.title.value, rdfs.label.value, schema_org.name.value)))
_TITLES = re.compile(rf'<(?:{_NAMING})> "((?:[^"\\]|\\.)*)"'.encode())
_ROOTS = (stored_mappings.ROUTE, stored_cockpits.ROUTE, "data/")


async def kept_entries(documents: Documents, queries: StoredQueries) -> list[Entry]:
    """The entries of what is kept now, at most `MAX_KEPT` beside the queries."""
    found = [
        Entry(EntryKind.QUERY, f"/{query.name}", url, (), (query.purpose,))
        for url, query in queries.all(limit=MAX_KEPT)
    ]
    waiting, count = list(_ROOTS), 0
    while waiting and count < MAX_KEPT:
        for member in documents.records.members(waiting.pop(0), limit=MAX_KEPT - count):
            record = documents.records.get(member.path)
            if record is None:
                continue
            count += 1
            found.append(_entry(documents.space, record))
            if record.model.is_container:
                waiting.append(record.path)
            if count % _AT_ONCE == 0:
                await asyncio.sleep(0)
    return found


def _entry(space: Space, record: Record) -> Entry:
    kind = EntryKind.MAPPING if record.path.startswith(stored_mappings.ROUTE) else EntryKind.DOCUMENT
    return Entry(kind, _name(record.path), space.base + record.path, (), tuple(titles_in(record.triples)))


def _name(path: str) -> str:
    """The path below its route, as people write it."""
    return "/" + "/".join(locate(f"/{path}").segments)


def titles_in(triples: bytes) -> list[str]:
    """The titles and labels in the first of N-Triples that are kept so."""
    found = _TITLES.findall(unpack_prefix(triples, _MAX_BYTES))
    return [text.decode("utf-8", "replace").replace('\\"', '"') for text in found]
