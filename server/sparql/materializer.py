"""The materializer, which loads the graphs that a query needs into the query process before the query runs.

Graphs with an unchanged token are skipped; the others are rendered and replaced in one transaction, so that no query
misses a graph. `StoredSync` loads the graphs that clients store.
"""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager
from itertools import count
from typing import NamedTuple, Protocol

from msgspec import Struct

from rosld.server.auth.permissions import ALLOW_ALL, Permissions
from rosld.server.rest.resource import Resource
from rosld.server.sparql.needs import Needs
from rosld.server.sparql.process.client import QueryProcess
from rosld.server.sparql.stored_sync import (
    INLINE,
    ChangeSource,
    HeldGraph,
    StoredSync,
    TargetState,
    render_graphs,
    render_in_thread,
)


class GraphEntry(NamedTuple):
    """A named graph of the source: `token` changes whenever the result of `ntriples()` (thread-safe) would.

    `observed`: whether it has the observations of its messages.
    """

    iri: str
    token: Hashable
    ntriples: Callable[[], str]
    observed: bool = False


class LiveDocument(NamedTuple):
    """A document whose values a query can match.

    `is_named`: the query names its IRI, type or a predicate, so its values must be current. Without `subscribes`, only
    values at hand are included. `members` are the properties to read of a complex resource, None for all. `observed`:
    whether the query can match observations of its messages.
    """

    url: str
    resource: Resource
    is_named: bool = False
    subscribes: bool = True
    members: frozenset[str] | None = None
    observed: bool = False


class LiveGraphs(Struct, frozen=True):
    """Documents with their values, by URL (None for missing ones), and the reasons why others could not be read."""

    entries: dict[str, GraphEntry | None]
    unread: dict[str, str]


class GraphSource(Protocol):
    """Source of the graphs of the dataset, by default without values. Called on the loop."""

    @property
    def revision(self) -> Hashable:
        """Revision of the set of description graphs: while it is unchanged, so are they."""
        ...

    @property
    def writes(self) -> int:
        """Number that increases with each write that the server sends to the robot, before the write is answered."""
        return 0

    def descriptions(self) -> Mapping[str, GraphEntry]:
        """Return all graphs, by IRI, without values."""
        ...

    async def prepare(self, needs: Needs) -> None:
        """Make the descriptions of everything that the needs name available."""
        return

    def wanted(self, needs: Needs, permissions: Permissions) -> Sequence[LiveDocument]:
        """Return the documents whose values the needs can match and the permissions allow to read."""
        return ()

    async def read(self, documents: Sequence[LiveDocument], *, deadline: float) -> LiveGraphs:
        """Return documents with their current values, waiting until `deadline` (loop time) at most for first values."""
        return LiveGraphs({}, {})


_WILDCARD_SECONDS = 0.2
"""Seconds for which values may be reused by queries that do not name their document.

This covers changes that the robot makes by itself: after a write through the server all values are read again.
"""


class DatasetVersions(NamedTuple):
    """Versions that a query sees: the tokens of graphs with live values, and the version of the stored graphs."""

    tokens: Mapping[str, Hashable]
    stored: int


class _Change(NamedTuple):
    """Change of one graph: `entry` is None for a removal. `size` is the number of characters before the change.

    `description` is the token of its description at that time, None for a graph without one.
    """

    entry: GraphEntry | None
    description: Hashable
    has_values: bool
    size: int


class _Reading(NamedTuple):
    """Values read for a query. `number` orders readings; the later one is right."""

    number: int
    graphs: LiveGraphs


class _Recent(NamedTuple):
    """Documents of the last unnamed reading, with the generation, the number of writes and the time of that reading."""

    urls: frozenset[str]
    version: tuple[int, int]
    ended: float


_NEVER = _Recent(frozenset(), (-1, -1), 0.0)


class Materializer:
    """Synchronisation of a dataset with a source, as far as queries need it. Belongs to one loop."""

    def __init__(
        self,
        target: QueryProcess,
        source: GraphSource,
        *sources: ChangeSource,
    ) -> None:
        self._target = target
        self._state = TargetState(target, len(sources))
        self.stored = StoredSync(target, self._state, sources)
        """Synchronisation of the graphs that clients store."""
        self._source = source
        self._numbers = count(1)
        self._pinned: Counter[str] = Counter()
        self._recent = _NEVER
        self._applying = asyncio.Lock()

    @property
    def source_graphs(self) -> Sequence[str]:
        """Return the graphs in the dataset whose source is the `GraphSource`, without those that clients store."""
        return list(self._state.held)

    @asynccontextmanager
    async def materialize(
        self,
        needs: Needs,
        permissions: Permissions = ALLOW_ALL,
        *,
        deadline: float,
        scope: frozenset[str] | None = None,
    ) -> AsyncIterator[Mapping[str, str]]:
        """Within the context the dataset holds what the needs require; the query must be sent at once.

        Yields the reasons why documents could not be read, by URL. `scope` limits the graphs that are examined, None
        for all. Raises what the source raises, and Problem 503 if too much must be loaded first.
        """
        self._state.follow_restart()
        await self._source.prepare(needs)
        documents = self._source.wanted(needs, permissions)
        pins = [one.url for one in documents if _is_recorded_message(one.url)]
        self._pinned.update(pins)
        try:
            yield await self._update(documents, self.stored.wanted(needs), scope, deadline)
        finally:
            if pins:
                self._pinned.subtract(pins)
                self._pinned = +self._pinned

    def versions_of(self, graphs: frozenset[str] | None) -> DatasetVersions:
        """Return the versions of the live values (None: of all graphs) and of the stored graphs in the dataset."""
        live = self._state.live if graphs is None else self._state.live & graphs
        wanted = self.stored.wanted_of_clients
        stored = wanted[0] if self.stored.is_current(graphs, wanted) else self._state.versions[0]
        return DatasetVersions({iri: self._state.held[iri].token for iri in live}, stored)

    async def _update(
        self, documents: Sequence[LiveDocument], wanted: Sequence[int], scope: frozenset[str] | None, deadline: float
    ) -> Mapping[str, str]:
        writes, number = self._source.writes, next(self._numbers)
        due = self._due(documents)
        graphs = await self._source.read(due, deadline=deadline) if due else LiveGraphs({}, {})
        unnamed = frozenset(one.url for one in due if not one.is_named)
        if unnamed and not graphs.unread:
            self._recent = _Recent(unnamed, (self._state.generation, writes), time.monotonic())
        if not self.stored.is_current(scope, wanted):
            await self.stored.catch_up(scope, wanted, deadline)
        reading = _Reading(number, graphs)
        if not self._send_small(reading):  # the update must finish even if the query is cancelled
            await asyncio.shield(asyncio.ensure_future(self._apply(reading)))
        self._state.require(self._state.generation)
        return graphs.unread

    def _due(self, documents: Sequence[LiveDocument]) -> Sequence[LiveDocument]:
        """Return the documents to be read, without unnamed ones that were read just now."""
        urls, version, ended = self._recent
        now = self._state.generation, self._source.writes
        if version != now or time.monotonic() - ended >= _WILDCARD_SECONDS:
            return documents
        if any(not one.is_named and (one.url not in urls or self._lacks_observations(one)) for one in documents):
            return documents  # all values must be of the same moment
        return [one for one in documents if one.is_named]

    def _lacks_observations(self, one: LiveDocument) -> bool:
        held = self._state.held.get(one.url)
        return one.observed and (held is None or not held.observed)

    def _send_small(self, reading: _Reading) -> bool:
        """Apply small changes at once; return False, changing nothing, for large ones or while others are applied."""
        if self._applying.locked():
            return False
        revision, changes = self._find_changes(reading)
        if sum(change.size for change in changes.values()) > INLINE:
            return False
        self._send(reading, revision, changes, render_graphs(_renderings(changes)))
        return True

    async def _apply(self, reading: _Reading) -> None:
        """Apply changes one reading at a time; those that another query has applied meanwhile are skipped."""
        async with self._applying:
            revision, changes = self._find_changes(reading)
            generation = self._state.generation
            texts = await render_in_thread(_renderings(changes))
            self._state.require(generation)
            applied = {iri: one for iri, one in changes.items() if one.entry is not None or iri not in self._pinned}
            self._send(reading, revision, applied, {iri: texts[iri] for iri in applied})

    def _find_changes(self, reading: _Reading) -> tuple[Hashable, dict[str, _Change]]:
        """Return the changes for the target and the revision of the descriptions; newer graphs are left alone."""
        revision = self._source.revision
        described = self._source.descriptions()
        changes: dict[str, _Change] = {}
        if revision != self._state.descriptions:
            changes.update(self._changed_descriptions(described))
        for iri in self._state.transient - self._pinned.keys():
            changes[iri] = _Change(None, None, False, 0)
        for iri, entry in reading.graphs.entries.items():
            held, plain = self._state.held.get(iri), described.get(iri)
            description = None if plain is None else plain.token
            if held is not None and held.number > reading.number:
                continue
            if entry is None:
                if held is not None and held.has_values:
                    changes[iri] = _Change(plain, description, False, held.size)
            elif held is None or not held.has_values or (held.token, held.observed) != (entry.token, entry.observed):
                changes[iri] = _Change(entry, description, True, INLINE + 1 if held is None else held.size)
            else:
                changes.pop(iri, None)
        return revision, changes

    def _changed_descriptions(self, described: Mapping[str, GraphEntry]) -> Iterator[tuple[str, _Change]]:
        for iri, entry in described.items():
            held = self._state.held.get(iri)
            if held is None or held.description != entry.token:
                yield iri, _Change(entry, entry.token, False, INLINE + 1 if held is None else held.size)
        for iri, held in self._state.held.items():
            if held.description is not None and iri not in described:
                yield iri, _Change(None, None, False, 0)

    def _send(
        self,
        reading: _Reading,
        revision: Hashable,
        changes: Mapping[str, _Change],
        texts: Mapping[str, str | None],
    ) -> None:
        state = self._state
        state.require(state.generation)
        self._target.change(texts)
        for iri, change in changes.items():
            state.live.discard(iri)
            state.transient.discard(iri)
            if change.entry is None:
                state.held.pop(iri, None)
                continue
            token, observed, size = change.entry.token, change.entry.observed, len(texts[iri] or "")
            state.held[iri] = HeldGraph(token, change.description, change.has_values, reading.number, size, observed)
            if change.has_values:
                state.live.add(iri)
            elif iri in self._recent.urls and iri not in reading.graphs.entries:
                self._recent = _NEVER  # the new description replaced its values
            if _is_recorded_message(iri):
                state.transient.add(iri)
        state.descriptions = revision


def _is_recorded_message(iri: str) -> bool:
    """Whether a graph is a single recorded message, which is present only for queries that name it."""
    return "/bags/" in iri and "/messages/" in iri


def _renderings(changes: Mapping[str, _Change]) -> dict[str, Callable[[], str] | None]:
    return {iri: None if change.entry is None else change.entry.ntriples for iri, change in changes.items()}
