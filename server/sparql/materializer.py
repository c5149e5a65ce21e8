"""The materializer: brings the live graphs that a query needs into the query process before the query.

The source tells what there is by tokens: a graph whose token is as before is left alone, the others are rendered and
replaced in one transaction, so that no query sees a graph missing or two graphs of different moments. What clients keep
is brought by `StoredSync`, before every query that may look at it.
"""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import Hashable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from itertools import count
from typing import NamedTuple

from rosld.server.sparql.change_source import NOTHING, ChangeSource
from rosld.server.sparql.graph_changes import (
    GraphChange,
    find_changes,
    is_small,
    note_changes,
    renderings,
    without_pinned,
)
from rosld.server.sparql.graph_rendering import render_graphs, render_in_thread
from rosld.server.sparql.graph_source import GraphEntry, GraphSource, MentionedDocuments, Snapshot
from rosld.server.sparql.needs import Needs
from rosld.server.sparql.stored_sync import StoredSync
from rosld.server.sparql.sync_target import SyncTarget, TargetState

WILDCARD_SECONDS = 0.2
"""Seconds for which a look at everything is good enough for the next query that looks at everything.

They count for what the robot did by itself: after a write through the server everything is looked at again.
"""


class SeenVersions(NamedTuple):
    """The tokens of the graphs with live values, and the version of what clients keep, that a query sees."""

    tokens: Mapping[str, Hashable]
    stored: int


class _Materialized:
    """One query's use of the dataset."""

    __slots__ = ("_deadline", "_extras", "_materializer", "_needs", "_scope")

    def __init__(self, materializer: Materializer, needs: Needs, scope: frozenset[str] | None, deadline: float) -> None:
        self._materializer = materializer
        self._needs = needs
        self._scope = scope
        self._deadline = deadline
        self._extras: Sequence[str] = ()

    async def __aenter__(self) -> None:
        self._extras = await self._materializer.begin(self._needs, self._scope, self._deadline)

    async def __aexit__(self, *error: object) -> None:
        self._materializer.end(self._extras)


class Materializer:
    """Keeps a dataset in step with a source, as far as queries need it. Belongs to one loop."""

    def __init__(
        self,
        target: SyncTarget,
        source: GraphSource,
        kept: ChangeSource = NOTHING,
        *more: ChangeSource,
        interval: float = WILDCARD_SECONDS,
        mentioned: MentionedDocuments | None = None,
    ) -> None:
        sources = (kept, *more)
        self._target = target
        self._state = TargetState(target, len(sources))
        self.stored = StoredSync(target, self._state, sources)
        """What brings what clients keep."""
        self._source = source
        self._interval = interval
        self._mentioned = mentioned
        self._numbers = count(1)
        self._described: tuple[Hashable, Mapping[str, GraphEntry]] = (object(), {})
        self._pinned: Counter[str] = Counter()
        self._applying = asyncio.Lock()

    @property
    def source_graphs(self) -> Sequence[str]:
        """The graphs in the dataset that come from the source: all but those that clients keep."""
        return list(self._state.held)

    async def resolve_documents(self, needs: Needs) -> Needs:
        """The needs with the documents that their terms name, and those that clients mention: what to `materialize`.

        Raises Problem 503 where what clients keep is to be read first.
        """
        if needs.terms:
            needs = needs.with_documents(await self._source.documents_of(needs.terms))
        if needs.rests_on and self._mentioned is not None:
            self._state.follow_restart()
            wanted = self.stored.versions
            if not self.stored.is_current(None, wanted):
                await self.stored.catch_up(None, wanted, float("inf"))
            mentioned = self._mentioned(needs.rests_on)
            needs = needs if mentioned == frozenset() else needs.with_mentions(mentioned)
        return needs

    def materialize(
        self, needs: Needs, *, deadline: float, scope: frozenset[str] | None = None
    ) -> AbstractAsyncContextManager[None]:
        """Within it the dataset holds what the needs ask for: send the query there, at once.

        `scope` are the only graphs that are looked at, None for all. Raises what the source raises, and Problem 503
        where too much is to be brought first.
        """
        return _Materialized(self, needs, scope, deadline)

    async def begin(self, needs: Needs, scope: frozenset[str] | None, deadline: float) -> Sequence[str]:
        """Bring the dataset to what the needs ask for. What is returned is kept until it is given to `end`."""
        self._state.follow_restart()
        snapshot = await self._take_snapshot(needs, deadline)
        extras = (*snapshot.extras, *snapshot.lasting)
        self._pinned.update(extras)
        try:
            wanted = self.stored.versions
            if not self.stored.is_current(scope, wanted):
                await self.stored.catch_up(scope, wanted, deadline)
            if not self._send_small(snapshot):  # it goes on even where the query is given up
                await asyncio.shield(asyncio.ensure_future(self._apply(snapshot)))
            self._state.require(self._state.generation)
            if needs.is_everything and snapshot.has_values:
                self._state.everything = snapshot
        except BaseException:
            self.end(extras)
            raise
        return extras

    def versions_of(self, graphs: frozenset[str] | None) -> SeenVersions:
        """What the dataset holds now of values that change by themselves (None: of all), and of what clients keep."""
        live = self._state.live if graphs is None else self._state.live & graphs
        wanted = self.stored.versions
        kept = wanted[0] if self.stored.is_current(graphs, wanted) else self._state.versions[0]
        return SeenVersions({iri: self._state.held[iri].token for iri in live}, kept)

    def end(self, extras: Sequence[str]) -> None:
        """The query has begun: graphs that were there for it alone may go."""
        if extras:
            self._pinned.subtract(extras)
            self._pinned = +self._pinned

    async def _take_snapshot(self, needs: Needs, deadline: float) -> Snapshot:
        writes = self._source.writes
        revision, described = self._descriptions()
        entries: Sequence[GraphEntry] = ()
        recent = self._recent
        asked = self._must_read_values(needs, described, recent)
        if asked:
            entries = await self._source.live(needs, deadline=deadline)
            revision, described = self._descriptions()
        lasting = () if recent is None else recent.unnamed
        number, ended = next(self._numbers), time.monotonic()
        return Snapshot(number, revision, described, asked, entries, needs, writes, ended, lasting)

    def _descriptions(self) -> tuple[Hashable, Mapping[str, GraphEntry]]:
        revision = self._source.revision
        if self._described[0] != revision:
            self._described = (revision, self._source.descriptions())
        return self._described

    def _must_read_values(self, needs: Needs, described: Mapping[str, GraphEntry], last: Snapshot | None) -> bool:
        """Whether the last look at everything is not good enough for these needs."""
        if not needs.documents <= described.keys():
            return True
        if not needs.demands:
            return False
        return last is None or not needs.is_everything or not last.needs.covers(needs) or not self._holds(last)

    @property
    def _recent(self) -> Snapshot | None:
        """The last look at everything, where it is still good enough."""
        last = self._state.everything
        if last is None or last.writes != self._source.writes or time.monotonic() - last.ended >= self._interval:
            return None
        return last

    def _holds(self, last: Snapshot) -> bool:
        """Whether what is there for looks at everything alone is there."""
        return self._state.extras.issuperset(last.unnamed)

    def _find_changes(self, snapshot: Snapshot) -> dict[str, GraphChange]:
        return find_changes(snapshot, self._state, self._pinned)

    def _send_small(self, snapshot: Snapshot) -> bool:
        """Make small changes here and now. False, with nothing changed, where they are not or others are being made."""
        if self._applying.locked():
            return False
        changes = self._find_changes(snapshot)
        if not is_small(changes):
            return False
        self._send(snapshot, changes, render_graphs(renderings(changes)))
        return True

    async def _apply(self, snapshot: Snapshot) -> None:
        """One change at a time; what another query has brought meanwhile is not brought again."""
        async with self._applying:
            changes = self._find_changes(snapshot)
            generation = self._state.generation
            texts = await render_in_thread(renderings(changes))
            self._state.require(generation)
            changes = without_pinned(changes, self._state, self._pinned)  # others have begun meanwhile
            self._send(snapshot, changes, {iri: texts[iri] for iri in changes})

    def _send(self, snapshot: Snapshot, changes: Mapping[str, GraphChange], texts: Mapping[str, str | None]) -> None:
        self._state.require(self._state.generation)
        self._target.change(texts)
        note_changes(changes, snapshot, {iri: len(text or "") for iri, text in texts.items()}, self._state)
