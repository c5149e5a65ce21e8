"""The finder: entries of the search index, stored documents included, and names similar to a missing one."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable, Hashable, Mapping, Sequence
from functools import partial

from msgspec import Struct

from rosld.adapters.base import Capabilities
from rosld.adapters.model import Graph, Schema, TypeRef
from rosld.ontology.names import IdentityCache, namespaces_of
from rosld.ontology.urls import Location, Space, locate
from rosld.ontology.vocab import dcterms, rdfs, schema_org
from rosld.server.auth.permissions import Permissions
from rosld.server.hypermedia.affordance_service import AffordanceService
from rosld.server.hypermedia.conditions import url_of
from rosld.server.hypermedia.resource_tree import ResourceTree, path_of, segments_of
from rosld.server.policies import stored_cockpits
from rosld.server.policies.stored_mappings import ROUTE
from rosld.server.policies.stored_queries import StoredQueries
from rosld.server.resources.ldp.base import Documents
from rosld.server.resources.namespaces import listed_graph, namespaces, things_of
from rosld.server.rest.state import State
from rosld.server.robot.audited_adapter import AuditedAdapter
from rosld.server.robot.schemas import Schemas
from rosld.server.robot.session import Session
from rosld.server.runtime.version_cache import IdentityKey
from rosld.server.search.catalog import catalog_of
from rosld.server.search.index import Catalog, Entry, EntryKind, SearchIndex, SearchResults
from rosld.server.search.near_names import NearNames
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
_ROOTS = (ROUTE, stored_cockpits.ROUTE, "data/")


async def kept_entries(documents: Documents, queries: StoredQueries) -> list[Entry]:
    """Return the entries of stored documents, at most `MAX_KEPT` beside the queries."""
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
    kind = EntryKind.MAPPING if record.path.startswith(ROUTE) else EntryKind.DOCUMENT
    return Entry(kind, _name(record.path), space.base + record.path, (), tuple(titles_in(record.triples)))


def _name(path: str) -> str:
    """Return the path below its route, as people write it."""
    return "/" + "/".join(locate(f"/{path}").segments)


def titles_in(triples: bytes) -> list[str]:
    """Return the titles and labels in the first of N-Triples that are kept so."""
    found = _TITLES.findall(unpack_prefix(triples, _MAX_BYTES))
    return [text.decode("utf-8", "replace").replace('\\"', '"') for text in found]


_MANY_NAMES = 1000
"""Names from which an index is made on a thread: ten thousand take a quarter of a second."""


class _Index(Struct, frozen=True, eq=False):
    """An index of one version of what it was made of."""

    version: Hashable
    index: SearchIndex


class Finder:
    """The search of one robot."""

    def __init__(
        self, session: Session, affordances: AffordanceService[State], documents: Documents, queries: StoredQueries
    ) -> None:
        self._session = session
        self._affordances = affordances
        self._documents = documents
        self._queries = queries
        self._of_robot: _Index | None = None
        self._of_kept: _Index | None = None
        self._making = asyncio.Lock()

    async def find(self, terms: Sequence[str], permissions: Permissions, limit: int) -> SearchResults:
        """Return the readable entries with all these terms, the best first, at most `limit`."""
        async with self._making:
            self._of_robot = await self._robot_index(self._of_robot)
            self._of_kept = await self._kept_index(self._of_kept)
        may_read: Callable[[str], bool] | None = None if permissions.is_unrestricted else permissions.may_read
        found = [each.index.find(terms, limit, may_read) for each in (self._of_robot, self._of_kept)]
        hits = sorted((hit for each in found for hit in each.hits), key=lambda hit: hit.rank)
        return SearchResults(hits[:limit], sum(each.total for each in found))

    async def _robot_index(self, known: _Index | None) -> _Index:
        tree = await self._affordances.tree()
        graph = listed_graph(self._session.graph, self._session.adapter.capabilities)
        version = (IdentityKey(graph), IdentityKey(tree), self._session.schemas.count)
        if known is not None and known.version == version:
            return known
        make = partial(_index_of_robot, self._session.space, self._session.schemas, graph, tree)
        names = len(graph.topics) + len(graph.services) + len(graph.parameters)
        return _Index(version, await asyncio.to_thread(make) if names > _MANY_NAMES else make())

    async def _kept_index(self, known: _Index | None) -> _Index:
        version = self._documents.records.version
        if known is not None and known.version == version:
            return known
        return _Index(version, SearchIndex(Catalog(await kept_entries(self._documents, self._queries))))


def _index_of_robot(space: Space, schemas: Schemas, graph: Graph, tree: ResourceTree) -> SearchIndex:
    return SearchIndex(catalog_of(graph, partial(_schema_at_hand, schemas), tree, space))


def _schema_at_hand(schemas: Schemas, ref: TypeRef) -> Schema | None:
    return schemas.find_cached(ref) or schemas.find_cached_by_name(ref.name)


_IN_GRAPH = frozenset({"nodes", "topics", "services", "actions", "parameters"})


def _near_in_route(things: Mapping[str, object]) -> NearNames:
    return NearNames((*things, *(path_of(namespace) for namespace in namespaces_of(things) if namespace)))


def _near_in_tree(tree: ResourceTree) -> NearNames:
    return NearNames({*tree.properties, *tree.actions, *tree.paths} - {"/"})


_route_names: IdentityCache[Mapping[str, object], NearNames] = IdentityCache(_near_in_route)
_tree_names: IdentityCache[ResourceTree, NearNames] = IdentityCache(_near_in_tree, 2)


def near_urls(space: Space, adapter: AuditedAdapter, affordances: AffordanceService[State], url: str) -> Sequence[str]:
    """Return the URLs of what the robot has under names near that of `url`, the nearest first.

    None where `url` is in no container of names, and where its name is there: then it is absent for another reason.
    """
    place = space.location(url)
    if place is None or not place.segments:
        return ()
    if place.kind == "resources":
        return _near_resources(space, affordances, place)
    return _near_names(space, adapter.graph, adapter.capabilities, place) if place.kind in _IN_GRAPH else ()


def _near_names(space: Space, graph: Graph, capabilities: Capabilities, place: Location) -> Sequence[str]:
    things, name = things_of(listed_graph(graph, capabilities), place.kind), _missing_name(place)
    if name in things or place.segments in namespaces(graph, place.kind):
        return ()
    return [
        space.container(place.kind, segments_of(each))
        if each.endswith("/")
        else space.url(place.kind, tuple(each[1:].split("/")))
        for each in _route_names(things).of(name)
    ]


def _near_resources(space: Space, affordances: AffordanceService[State], place: Location) -> Sequence[str]:
    tree, name = affordances.cached_tree(), _missing_name(place)
    if tree is None or tree.property(name) is not None or tree.action(name) is not None or f"{name}/" in tree.paths:
        return ()
    return [url_of(each, space) for each in _tree_names(tree).of(name)]


def _missing_name(place: Location) -> str:
    return "/" + "/".join(place.segments)
