"""Finds what the robot has, and what is kept beside it, by words; indexes are made when something is searched for."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import partial

from rosld.adapters.model import Graph, Schema, TypeRef
from rosld.ontology.urls import Space
from rosld.server.auth.permissions import Permissions
from rosld.server.hypermedia.affordance_service import AffordanceService
from rosld.server.hypermedia.resource_tree import ResourceTree
from rosld.server.policies.stored_queries import StoredQueries
from rosld.server.resources.kept_entries import kept_entries
from rosld.server.resources.ldp.documents import Documents
from rosld.server.resources.namespaces import listed_graph
from rosld.server.rest.state import State
from rosld.server.robot.schemas import Schemas
from rosld.server.robot.session import Session
from rosld.server.runtime.version_cache import IdentityKey
from rosld.server.search.catalog import catalog_of
from rosld.server.search.entry import Catalog
from rosld.server.search.index import SearchIndex, SearchResults

_MANY_NAMES = 1000
"""Names from which an index is made on a thread: ten thousand take a quarter of a second."""


@dataclass(frozen=True, slots=True, eq=False)
class _Index:
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
        """What has all these terms and may be read, the best first, at most `limit` of it."""
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
