"""Mapping documents: the initial ones, and those that clients store."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Iterator

from pyoxigraph import RdfFormat, parse

from rosld.adapters.base import Adapter
from rosld.ontology.body import index_quads
from rosld.ontology.urls import Space
from rosld.server.hypermedia.affordance_service import AffordanceService
from rosld.server.hypermedia.mapping_parser import MappingDocument, load_mapping, mapping_of
from rosld.server.hypermedia.mappings import Mappings
from rosld.server.rest.state import State
from rosld.server.runtime.tasks import loop_time
from rosld.server.settings import Settings
from rosld.server.storage.record import Model, Put
from rosld.server.storage.record_documents import to_ntriples, unpack_triples
from rosld.server.storage.sqlite import Records

ROUTE = "mappings/"
_log = logging.getLogger("rosld")


def stored_mapping(triples: bytes, url: str) -> MappingDocument:
    """Return the mapping in stored N-Triples. Raises InvalidMapping."""
    return mapping_of(index_quads(parse(triples, RdfFormat.N_TRIPLES), url), url)


def initial_mappings(settings: Settings, adapter: Adapter, space: Space) -> Iterator[MappingDocument]:
    """Yield the initial mapping documents: the robot's own, and those of the settings. Raises ValueError.

    Shipped mappings are trusted to be valid.
    """
    shipped = adapter.capabilities.mapping
    if shipped is not None:
        yield load_mapping(shipped, space, adapter.capabilities.system, is_valid=True)
    for path in settings.mapping:
        yield load_mapping(path, space)


async def load_stored_mappings(mappings: Mappings, records: Records, settings: Settings, space: Space) -> None:
    """Store the initial mappings, and activate those stored by an earlier run.

    A client's changes override the mapping of the robot, but not those of the settings.
    """
    named = {space.url("mappings", (path.stem,)) for path in settings.mapping}
    begun = set()
    for document in mappings.given:
        path = document.url[len(space.base) :]
        if records.is_tombstone(path):
            mappings.remove(document.url)
        elif records.get(path) is None or document.url in named:
            await records.write(Put(path, Model.RDF_SOURCE, to_ntriples(document.triples)))
            begun.add(document.url)
    for member in records.members(ROUTE):
        record, url = records.get(member.path), space.base + member.path
        if record is None or url in begun or (url in mappings.documents and url in named):
            continue
        try:
            mappings.replace(stored_mapping(unpack_triples(record.triples), url))
        except ValueError as error:
            _log.error("The mapping %s is stored but not in force: %s", url, error)


_DISCOVERY = 5.0
"""Seconds to wait for the discovery of a robot: in ROS 2 nodes appear one after the other."""
_AGAIN = 0.5


async def log_mapping_warnings(affordances: AffordanceService[State], mappings: Mappings) -> None:
    """Log names in the mappings that are missing or unusable, once the robot should have been discovered."""
    until = loop_time() + _DISCOVERY
    while found := await _warnings(affordances, mappings):
        if loop_time() > until:
            for url, words in found:
                _log.warning("The mapping %s names things that do not exist: %s", url, words)
            return
        await asyncio.sleep(_AGAIN)


async def _warnings(affordances: AffordanceService[State], mappings: Mappings) -> list[tuple[str, str]]:
    """Return what is missing for each mapping, with the URL of its document."""
    urls = tuple(mappings.documents)
    return [(url, words) for url in urls for words in await affordances.mapping_warnings(url)]
