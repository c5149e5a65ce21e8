"""Synchronising: before a query is asked, the store holds what it needs as of now, and only that is paid for.

The source tells what there is by tokens: a graph whose token is as before is left alone, the others are rendered and
replaced in one transaction, so that no query sees a graph missing or two graphs of different moments. Of what clients
keep only the changes are told, before every query: as long as there are none, they cost the comparison of two numbers.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections import Counter
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from itertools import count, islice
from typing import NamedTuple, Protocol

from pyoxigraph import Triple

from rosld.server.memory import DATASET_PER_CHARACTER, MEMORY
from rosld.server.sparql.kept import NOTHING, Backlog, KeptSource
from rosld.server.sparql.needs import Needs
from rosld.server.store import Edit, MemoryStore, Store

_log = logging.getLogger("rosld.sparql")

WILDCARD_INTERVAL = 0.2
"""Seconds for which one look at everything is good enough for the next query that looks at everything."""
_INLINE = 64 * 1024
"""Characters of N-Triples up to which a change is made on the loop: a thread would cost more than the change."""
_MUCH = 1000
"""Changes of what clients keep that are not left for a query to find."""
_GLANCE = 1.0
"""Seconds between looks at how many there are."""
_SHORT_OF_MEMORY = 30.0
"""Seconds until what there was no memory for is tried again, unless a query asks for it."""
_SLICE = 0.002
"""Seconds of rendering after which the loop gets its turn."""


class GraphEntry(NamedTuple):
    """A named graph as its source has it: `token` changes whenever `ntriples()` would (called in any thread).

    `triples` are the same as terms, where these are at hand.
    """

    iri: str
    token: Hashable
    ntriples: Callable[[], str]
    triples: Callable[[], Iterable[Triple]] | None = None


class GraphSource(Protocol):
    """Where the graphs of the dataset come from. Called on the loop."""

    @property
    def revision(self) -> Hashable:
        """Of the set of description graphs: while it is the same, none of them has changed."""
        ...

    def descriptions(self) -> Mapping[str, GraphEntry]:
        """All graphs without live values, by IRI: the computation graph, containers, types, shapes, the ontology.

        That of a topic or a parameter is there too, without its values.
        """
        ...

    async def documents_of(self, terms: Collection[str]) -> Collection[str]:
        """The resources that these classes and predicates may be said of, and that are there only where named."""
        ...

    def glance(self, needs: Needs) -> Hashable | None:
        """What stays equal for as long as `live` would return the same, told at once; None where none can tell."""
        ...

    async def live(self, needs: Needs, *, deadline: float) -> Sequence[GraphEntry]:
        """The graphs that the needs ask for, description included, with their values as of now.

        Subscribes on demand, and waits no longer than `deadline` (loop time) for first values. Whatever has been
        returned once comes again whenever it is asked for, with or without a value: what does not is taken as gone.
        A topic is asked for by `needs.wants_topic(url, types)`, a parameter by `needs.wants_parameter(url)`, any other
        document (a recorded message) by being one of `needs.documents`; `needs.graphs`, where it is not None, spares a
        walk over all topics. Where `needs.everything`, that is all topics subscribed to, with no new subscription.
        """
        ...


class _Held(NamedTuple):
    """A graph as the store holds it: its token, that of the description it was made with, and the `look` it is of."""

    token: Hashable
    description: Hashable
    live: bool
    look: int
    size: int


class _Change(NamedTuple):
    """What becomes of one graph: `entry` is None where it goes. `size` is the number of characters it had."""

    entry: GraphEntry | None
    description: Hashable
    live: bool
    size: int


class _Look(NamedTuple):
    """What the source said at one moment: `number` orders looks, `asked` is whether it was asked for live values."""

    number: int
    revision: Hashable
    described: Mapping[str, GraphEntry]
    asked: bool
    entries: Sequence[GraphEntry]
    needs: Needs

    @property
    def extras(self) -> list[str]:
        """Graphs that are there only because they were named."""
        return [entry.iri for entry in self.entries if entry.iri not in self.described]


class Seen(NamedTuple):
    """The tokens of the graphs with live values, and the version of what clients keep, that a query sees."""

    tokens: Mapping[str, Hashable]
    kept: int


class _Synced:
    """One query's use of the store."""

    __slots__ = ("_deadline", "_extras", "_needs", "_synchroniser")

    def __init__(self, synchroniser: Synchroniser, needs: Needs, deadline: float) -> None:
        self._synchroniser = synchroniser
        self._needs = needs
        self._deadline = deadline
        self._extras: Sequence[str] = ()

    async def __aenter__(self) -> None:
        self._extras = await self._synchroniser.enter(self._needs, self._deadline)

    async def __aexit__(self, *error: object) -> None:
        self._synchroniser.leave(self._extras)


class Synchroniser:
    """Keeps a store in step with a source, as far as queries look. Belongs to one loop."""

    def __init__(
        self,
        store: Store,
        source: GraphSource,
        kept: KeptSource = NOTHING,
        *more: KeptSource,
        interval: float = WILDCARD_INTERVAL,
    ) -> None:
        self._store = store
        self._source = source
        self._kept = (kept, *more)
        self._versions = [0] * len(self._kept)
        self._interval = interval
        self._held: dict[str, _Held] = {}
        self._live: set[str] = set()
        self._extras: set[str] = set()
        self._pinned: Counter[str] = Counter()
        self._numbers = count(1)
        self._described: tuple[Hashable, Mapping[str, GraphEntry]] = (object(), {})
        self._applied: Hashable = object()
        self._everything: tuple[float, Needs] = (float("-inf"), Needs())
        self._changing = asyncio.Lock()

    @property
    def held(self) -> Sequence[str]:
        """The graphs in the store that come from the source: all but those that clients keep."""
        return list(self._held)

    async def resolved(self, needs: Needs) -> Needs:
        """The needs with all documents that they name, be it by terms: to be `synced`."""
        return needs.resolved(await self._source.documents_of(needs.terms)) if needs.terms else needs

    def synced(self, needs: Needs, *, deadline: float) -> AbstractAsyncContextManager[None]:
        """Within it the store holds what the needs ask for: begin the query there. Raises what the source raises."""
        return _Synced(self, needs, deadline)

    def glance(self, needs: Needs) -> Hashable | None:
        """What stays equal for as long as `synced` would bring nothing new, told at once; None where none can tell."""
        live: Hashable = ()
        _, described = self._descriptions()
        if needs.demands or not needs.documents <= described.keys():
            live = self._source.glance(needs)
        return None if live is None else (self._source.revision, *(each.version for each in self._kept), live)

    async def enter(self, needs: Needs, deadline: float) -> Sequence[str]:
        """Bring the store to what the needs ask for. What is returned is kept until it is given to `leave`."""
        look = await self._look(needs, deadline)
        extras = look.extras
        self._pinned.update(extras)
        try:
            if not self._at_once(look):  # it goes on even where the query is given up
                await asyncio.shield(asyncio.ensure_future(self._apply(look)))
            if needs.everything and look.asked:
                self._everything = (time.monotonic(), needs)
        except BaseException:
            self.leave(extras)
            raise
        return extras

    async def catch_up(self) -> None:
        """Bring to the store what clients keep, before a query asks for it: whoever asks meanwhile waits for it."""
        await asyncio.shield(asyncio.ensure_future(self._apply(None)))

    async def keep_up(self) -> None:
        """Catch up whenever much has changed since a query asked, at once and then for ever: to be cancelled."""
        while True:
            if self._kept[0].version - self._versions[0] >= _MUCH:
                try:
                    await self.catch_up()
                except MemoryError as error:
                    _log.error("what clients keep cannot be brought to the dataset now: %s", error)
                    await asyncio.sleep(_SHORT_OF_MEMORY)
                except Exception:  # the next query, or the next time, may have more luck
                    _log.exception("what clients keep cannot be brought to the dataset now")
            await asyncio.sleep(_GLANCE)

    @property
    def seen(self) -> Seen:
        """What the store holds now of values that change by themselves, and of what clients keep."""
        return Seen({iri: self._held[iri].token for iri in self._live}, self._versions[0])

    def leave(self, extras: Sequence[str]) -> None:
        """The query has begun: graphs that were there for it alone may go."""
        if extras:
            self._pinned.subtract(extras)
            self._pinned = +self._pinned

    async def _look(self, needs: Needs, deadline: float) -> _Look:
        revision, described = self._descriptions()
        entries: Sequence[GraphEntry] = ()
        asked = self._must_ask(needs, described)
        if asked:
            entries = await self._source.live(needs, deadline=deadline)
            revision, described = self._descriptions()
        return _Look(next(self._numbers), revision, described, asked, entries, needs)

    def _descriptions(self) -> tuple[Hashable, Mapping[str, GraphEntry]]:
        revision = self._source.revision
        if self._described[0] != revision:
            self._described = (revision, self._source.descriptions())
        return self._described

    def _must_ask(self, needs: Needs, described: Mapping[str, GraphEntry]) -> bool:
        if not needs.documents <= described.keys():
            return True
        if not needs.demands:
            return False
        when, seen = self._everything
        recently = time.monotonic() - when < self._interval
        return not (needs.everything and recently and seen.covers(needs))

    # --- what differs

    def _changes(self, look: _Look) -> dict[str, _Change]:
        """What the store must be told, by graph. Nothing newer than the look is touched."""
        changes: dict[str, _Change] = {}
        if look.revision != self._applied:
            changes.update(self._changed_descriptions(look))
        changes.update(self._vanished(look))
        for entry in look.entries:
            description = look.described[entry.iri].token if entry.iri in look.described else None
            held = self._held.get(entry.iri)
            if held is None or (held.token, held.description, held.live) != (entry.token, description, True):
                if held is None or held.look < look.number:
                    changes[entry.iri] = _Change(entry, description, True, _size(held))
            else:
                changes.pop(entry.iri, None)
        return changes

    def _changed_descriptions(self, look: _Look) -> Iterator[tuple[str, _Change]]:
        for iri, entry in look.described.items():
            held = self._held.get(iri)
            if held is None or (held.description != entry.token and held.look < look.number):
                yield iri, _Change(entry, entry.token, False, _size(held))
        for iri, held in self._held.items():
            if iri not in look.described and iri not in self._extras and held.look < look.number:
                yield iri, _Change(None, None, False, 0)

    def _vanished(self, look: _Look) -> Iterator[tuple[str, _Change]]:
        """What was there for an earlier query only, and values that a look at everything no longer finds."""
        if not self._extras and not look.needs.everything:
            return
        found = {entry.iri for entry in look.entries}
        for iri in self._extras - found:
            if iri not in self._pinned and self._held[iri].look < look.number:
                yield iri, _Change(look.described.get(iri), None, False, 0)
        if look.needs.everything and look.asked:
            for iri in self._live - found - self._extras:
                entry = look.described.get(iri)
                if entry is not None and self._held[iri].look < look.number:
                    yield iri, _Change(entry, entry.token, False, self._held[iri].size)

    # --- telling the store

    def _at_once(self, look: _Look) -> bool:
        """Make small changes here and now. False, with nothing changed, where they are not or others are being made."""
        if self._changing.locked():
            return False
        changes = self._changes(look)
        backlog, versions = self._first_part()
        if backlog is None or backlog.size > _INLINE or not _is_small(changes):
            return False
        self._carried_out(look, changes, _replace(self._store, changes, backlog))
        self._versions = versions
        return True

    def _first_part(self) -> tuple[Backlog | None, list[int]]:
        """What changed of what is kept, if the first part of each is all, and of which versions this is."""
        backlog, versions = Backlog(), [kept.version for kept in self._kept]
        for kept, version, before in zip(self._kept, versions, self._versions, strict=True):
            if version != before:
                parts = kept.changes(before)
                for part in islice(parts, 1):
                    backlog.add(part)
                if next(parts, None) is not None:
                    return None, versions
        return backlog, versions

    async def _all_parts(self, sources: Sequence[KeptSource]) -> tuple[Backlog, list[int]]:
        """All of it of these sources, whatever changes while it is being found."""
        backlog, versions = Backlog(), [*self._versions]
        for place, kept in enumerate(sources):
            version = kept.version
            if version != versions[place]:
                for part in kept.changes(versions[place]):
                    backlog.add(part)
                    await asyncio.sleep(0)
                    version = kept.version  # of before the search for the next part: there may be none
            versions[place] = version
        return backlog, versions

    async def _apply(self, look: _Look | None) -> None:
        """One change at a time; what another query has brought meanwhile is not brought again."""
        async with self._changing:
            sources = self._kept[:1] if look is None else self._kept  # the others only where a query asks
            backlog, versions = await self._all_parts(sources)
            changes = self._changes(look) if look is not None else {}
            sizes = await asyncio.to_thread(_replace, self._store, changes, backlog)
            if look is not None:
                self._carried_out(look, changes, sizes)
            self._versions = versions

    def _carried_out(self, look: _Look, changes: Mapping[str, _Change], sizes: Mapping[str, int]) -> None:
        for iri, change in changes.items():
            self._note(iri, change, look, sizes[iri])
        self._applied = look.revision

    def _note(self, iri: str, change: _Change, look: _Look, size: int) -> None:
        self._live.discard(iri)
        self._extras.discard(iri)
        if change.entry is None:
            self._held.pop(iri, None)
            return
        self._held[iri] = _Held(change.entry.token, change.description, change.live, look.number, size)
        if change.live:
            self._live.add(iri)
            if iri not in look.described:
                self._extras.add(iri)


def _is_small(changes: Mapping[str, _Change]) -> bool:
    return not changes or sum(change.size for change in changes.values()) <= _INLINE


def _size(held: _Held | None) -> int:
    """How large its graph was; one that is not known yet counts as large."""
    return _INLINE + 1 if held is None else held.size


def _replace(store: Store, changes: Mapping[str, _Change], backlog: Backlog) -> dict[str, int]:
    """Render what changed and replace it; the number of characters of each of `changes`. Runs in any thread."""
    edits: Sequence[Edit] = backlog.edits
    if not changes and not backlog.graphs and not edits:
        return {}
    # What the robot itself says is not asked about: the sizes of its graphs are not known, and they are small.
    MEMORY.require(backlog.size * DATASET_PER_CHARACTER, f"the dataset, for changes of {backlog.size} characters,")
    texts = _rendered(backlog.graphs)
    texts |= _rendered({iri: change.entry and change.entry.ntriples for iri, change in changes.items()})
    try:
        store.replace(texts, edits)
    except ValueError:
        # One graph that cannot be stored must not hide all others from every query.
        texts = {iri: text if text is None or _is_ntriples(iri, text) else None for iri, text in texts.items()}
        store.replace(texts, [edit for edit in edits if _is_possible(edit)])
    return {iri: len(texts[iri] or "") for iri in changes}


def _rendered(graphs: Mapping[str, Callable[[], str] | None]) -> dict[str, str | None]:
    texts: dict[str, str | None] = {}
    pause = time.monotonic() + _SLICE
    for iri, ntriples in graphs.items():
        texts[iri] = None if ntriples is None else _render(iri, ntriples)
        if time.monotonic() > pause:
            time.sleep(_SLICE / 10)
            pause = time.monotonic() + _SLICE
    return texts


def _render(iri: str, ntriples: Callable[[], str]) -> str | None:
    try:
        return ntriples()
    except MemoryError:
        raise
    except Exception:  # a source's failure concerns one graph only
        _log.exception("%s cannot be rendered and is left out of the dataset", iri)
        return None


def _is_ntriples(iri: str, text: str) -> bool:
    return _is_stored({iri: text}, ())


def _is_possible(edit: Edit) -> bool:
    return _is_stored({}, (edit,))


def _is_stored(graphs: Mapping[str, str], edits: Sequence[Edit]) -> bool:
    try:
        MemoryStore().replace(graphs, edits)
    except ValueError as error:
        _log.error("%s is left out of the dataset: %s", next(iter(graphs), edits and edits[0].graph), error)
        return False
    return True
