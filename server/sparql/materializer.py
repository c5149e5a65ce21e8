"""Synchronising: before a query is sent, the query process is sent what the query needs, and only that is paid for.

The source tells what there is by tokens: a graph whose token is as before is left alone, the others are rendered and
replaced in one transaction, so that no query sees a graph missing or two graphs of different moments. Of what clients
keep only the changes are told, before every query that may look at them: as long as there are none, they cost the
comparison of two numbers. Where there are very many they are told in the background, part by part, and queries that
need them are told to come again.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections import Counter
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, field
from itertools import count, islice
from typing import NamedTuple, Protocol, TypeAlias

from pyoxigraph import Triple

from rosld.server.dataset import Edit
from rosld.server.http.problem import Problem
from rosld.server.runtime.process_memory import PROCESS_MEMORY, SENT_PER_CHARACTER
from rosld.server.sparql.change_source import NOTHING, Changes, ChangeSource
from rosld.server.sparql.needs import Needs
from rosld.server.sparql.query_limits import process_restarting

_log = logging.getLogger("rosld.sparql")

WILDCARD_SECONDS = 0.2
"""Seconds for which a look at everything is good enough for the next query that looks at everything.

They count for what the robot did by itself: after a write through the server everything is looked at again.
"""
_INLINE = 64 * 1024
"""Characters of N-Triples up to which a change is rendered on the loop: a thread would cost more."""
_MUCH = 1000
"""Changes of what clients keep that are not left for a query to find."""
_GLANCE = 1.0
"""Seconds between looks at how many there are."""
_SHORT_OF_MEMORY = 30.0
"""Seconds until what there was no memory for is tried again, unless a query asks for it."""
_SLICE = 0.002
"""Seconds of rendering after which the loop gets its turn."""
_PATIENCE = 5.0
"""Seconds that a query waits for what clients keep."""
_LONGEST_RETRY = 60


class GraphEntry(NamedTuple):
    """A named graph as its source has it: `token` changes whenever `ntriples()` would (called in any thread).

    `triples` are the same as terms, where these are at hand. `passing`: it is so for the query that names it alone.
    """

    iri: str
    token: Hashable
    ntriples: Callable[[], str]
    triples: Callable[[], Iterable[Triple]] | None = None
    is_transient: bool = False


class GraphSource(Protocol):
    """Where the graphs of the dataset come from. Called on the loop."""

    @property
    def revision(self) -> Hashable:
        """Of the set of description graphs: while it is the same, none of them has changed."""
        ...

    @property
    def writes(self) -> int:
        """A number that rises with each write that the server carries out on the robot, before it is answered."""
        ...

    def descriptions(self) -> Mapping[str, GraphEntry]:
        """All graphs without live values, by IRI: the computation graph, containers, types, shapes, the ontology.

        That of a topic or a parameter is there too, without its values.
        """
        ...

    async def documents_of(self, terms: Collection[str]) -> Collection[str]:
        """The resources that these classes and predicates may be said of, and that are there only where named."""
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


MentionedDocuments: TypeAlias = Callable[[Collection[str]], frozenset[str] | None]
"""The live documents of which clients say any of these predicates or classes, None for all: of what was synced."""


class SyncTarget(Protocol):
    """Where the graphs go: what was sent is seen by all that is asked afterwards. Called on the loop."""

    @property
    def generation(self) -> int:
        """Another number whenever it holds nothing any more."""
        ...

    async def wait_drained(self) -> None:
        """Return when little is on its way that was not taken yet."""
        ...

    def change(self, graphs: Mapping[str, str | None], edits: Sequence[Edit] = ()) -> None:
        """Replace graphs, then do edits, as `Store.replace`. Raises Problem 503 and NotEnoughMemory."""
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
    """What the source said at one moment: `number` orders looks, `asked` is whether it was asked for live values.

    `writes` is how many writes had ended before it began, `ended` is when it had been told all (monotonic).
    """

    number: int
    revision: Hashable
    described: Mapping[str, GraphEntry]
    asked: bool
    entries: Sequence[GraphEntry]
    needs: Needs
    writes: int
    ended: float

    @property
    def extras(self) -> list[str]:
        """Graphs that are there only because they were named."""
        return [entry.iri for entry in self.entries if entry.is_transient or entry.iri not in self.described]

    @property
    def unnamed(self) -> list[str]:
        """Those of them that a look at everything brings although nobody names them."""
        return [iri for iri in self.extras if iri not in self.needs.documents]


class SeenVersions(NamedTuple):
    """The tokens of the graphs with live values, and the version of what clients keep, that a query sees."""

    tokens: Mapping[str, Hashable]
    stored: int


class _Synced:
    """One query's use of the dataset."""

    __slots__ = ("_deadline", "_extras", "_needs", "_scope", "_synchroniser")

    def __init__(self, synchroniser: Synchroniser, needs: Needs, scope: frozenset[str] | None, deadline: float) -> None:
        self._synchroniser = synchroniser
        self._needs = needs
        self._scope = scope
        self._deadline = deadline
        self._extras: Sequence[str] = ()

    async def __aenter__(self) -> None:
        self._extras = await self._synchroniser.begin(self._needs, self._scope, self._deadline)

    async def __aexit__(self, *error: object) -> None:
        self._synchroniser.end(self._extras)


class _Filling:
    """What clients keep, on its way to the process. `total` counts changes."""

    def __init__(self, total: int) -> None:
        self.task: asyncio.Future[None] | None = None
        self.total = max(1, total)
        self.done = 0
        self.begun = time.monotonic()

    @property
    def seconds_left(self) -> float:
        """About how long it will take."""
        passed = time.monotonic() - self.begun
        return passed * (self.total - self.done) / self.done if self.done else 0.0

    def __str__(self) -> str:
        share = min(99, 100 * self.done // self.total)
        return f"What clients keep is being read into the dataset: {share} % of it is there."


@dataclass(slots=True)
class _TargetState:
    """What the target holds, by what it was told since its start.

    `versions` are those of what is kept, `ahead` graphs of it that are newer than these. `live` of the graphs `held`
    have values that change by themselves, `extras` are there for one query only. `applied` is the revision of the
    descriptions, `everything` the last look at all of the source.
    """

    generation: int
    versions: list[int]
    ahead: dict[str, int] = field(default_factory=dict)
    held: dict[str, _Held] = field(default_factory=dict)
    live: set[str] = field(default_factory=set)
    extras: set[str] = field(default_factory=set)
    applied: Hashable = field(default_factory=object)
    everything: _Look | None = None


class Synchroniser:
    """Keeps a dataset in step with a source, as far as queries look. Belongs to one loop."""

    def __init__(
        self,
        target: SyncTarget,
        source: GraphSource,
        kept: ChangeSource = NOTHING,
        *more: ChangeSource,
        interval: float = WILDCARD_SECONDS,
        mentioned: MentionedDocuments | None = None,
    ) -> None:
        self._target = target
        self._source = source
        self._kept = (kept, *more)
        self._interval = interval
        self._mentioned = mentioned
        self._numbers = count(1)
        self._described: tuple[Hashable, Mapping[str, GraphEntry]] = (object(), {})
        self._pinned: Counter[str] = Counter()
        self._applying = asyncio.Lock()
        self._filling: _Filling | None = None
        self._forget()

    def _forget(self) -> None:
        """The target holds nothing."""
        self._state = _TargetState(self._target.generation, [0] * len(self._kept))

    def _require(self, generation: int) -> None:
        """Raise Problem 503 where the target holds nothing any more that it was told in this generation."""
        if not generation == self._state.generation == self._target.generation:
            raise process_restarting(1)

    @property
    def recorded_messages(self) -> Sequence[str]:
        """The graphs of single recorded messages that are in the dataset for some query."""
        return [iri for iri in self._state.extras if "/messages/" in iri]

    @property
    def source_graphs(self) -> Sequence[str]:
        """The graphs in the dataset that come from the source: all but those that clients keep."""
        return list(self._state.held)

    @property
    def progress(self) -> str | None:
        """How far what clients keep is on its way to the dataset, None where little is missing; from any thread."""
        if self._filling is not None:
            return str(self._filling)
        is_new = self._state.generation != self._target.generation
        missing = self._kept[0].version - (0 if is_new else self._state.versions[0])
        return str(_Filling(missing)) if missing >= _MUCH else None

    async def resolve_documents(self, needs: Needs) -> Needs:
        """The needs with the documents that their terms name, and those that clients mention: to be `synced`.

        Raises Problem 503 where what clients keep is to be read first.
        """
        if needs.terms:
            needs = needs.with_documents(await self._source.documents_of(needs.terms))
        if needs.rests_on and self._mentioned is not None:
            if self._state.generation != self._target.generation:
                self._forget()
            wanted = self._wanted
            if not self._is_current(None, wanted):
                await self._caught_up(None, wanted, float("inf"))
            mentioned = self._mentioned(needs.rests_on)
            needs = needs if mentioned == frozenset() else needs.with_mentions(mentioned)
        return needs

    def synchronised(
        self, needs: Needs, *, deadline: float, scope: frozenset[str] | None = None
    ) -> AbstractAsyncContextManager[None]:
        """Within it the dataset holds what the needs ask for: send the query there, at once.

        `scope` are the only graphs that are looked at, None for all. Raises what the source raises, and Problem 503
        where too much is to be brought first.
        """
        return _Synced(self, needs, scope, deadline)

    async def begin(self, needs: Needs, scope: frozenset[str] | None, deadline: float) -> Sequence[str]:
        """Bring the dataset to what the needs ask for. What is returned is kept until it is given to `leave`."""
        if self._state.generation != self._target.generation:
            self._forget()
        look = await self._look(needs, deadline)
        extras = look.extras
        self._pinned.update(extras)
        try:
            wanted = self._wanted
            if not self._is_current(scope, wanted):
                await self._caught_up(scope, wanted, deadline)
            if not self._at_once(look):  # it goes on even where the query is given up
                await asyncio.shield(asyncio.ensure_future(self._apply(look)))
            self._require(self._state.generation)
            if needs.is_everything and look.asked:
                self._state.everything = look
        except BaseException:
            self.end(extras)
            raise
        return extras

    def versions_of(self, graphs: frozenset[str] | None) -> SeenVersions:
        """What the dataset holds now of values that change by themselves (None: of all), and of what clients keep."""
        live = self._state.live if graphs is None else self._state.live & graphs
        wanted = self._wanted
        kept = wanted[0] if self._is_current(graphs, wanted) else self._state.versions[0]
        return SeenVersions({iri: self._state.held[iri].token for iri in live}, kept)

    def end(self, extras: Sequence[str]) -> None:
        """The query has begun: graphs that were there for it alone may go."""
        if extras:
            self._pinned.subtract(extras)
            self._pinned = +self._pinned

    async def _look(self, needs: Needs, deadline: float) -> _Look:
        writes = self._source.writes
        revision, described = self._descriptions()
        entries: Sequence[GraphEntry] = ()
        asked = self._must_ask(needs, described)
        if asked:
            entries = await self._source.live(needs, deadline=deadline)
            revision, described = self._descriptions()
        return _Look(next(self._numbers), revision, described, asked, entries, needs, writes, time.monotonic())

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
        last = self._recent
        return last is None or not needs.is_everything or not last.needs.covers(needs) or not self._holds(last)

    @property
    def _recent(self) -> _Look | None:
        """The last look at everything, where it is still good enough."""
        last = self._state.everything
        if last is None or last.writes != self._source.writes or time.monotonic() - last.ended >= self._interval:
            return None
        return last

    def _holds(self, last: _Look) -> bool:
        """Whether what is there for looks at everything alone is there."""
        return self._state.extras.issuperset(last.unnamed)

    # --- what differs

    def _changes(self, look: _Look) -> dict[str, _Change]:
        """What the store must be told, by graph. Nothing newer than the look is touched."""
        changes: dict[str, _Change] = {}
        if look.revision != self._state.applied:
            changes.update(self._changed_descriptions(look))
        changes.update(self._vanished(look))
        for entry in look.entries:
            description = look.described[entry.iri].token if entry.iri in look.described else None
            held = self._state.held.get(entry.iri)
            if held is None or (held.token, held.description, held.live) != (entry.token, description, True):
                if held is None or held.look < look.number:
                    changes[entry.iri] = _Change(entry, description, True, _size(held))
            else:
                changes.pop(entry.iri, None)
        return changes

    def _changed_descriptions(self, look: _Look) -> Iterator[tuple[str, _Change]]:
        for iri, entry in look.described.items():
            held = self._state.held.get(iri)
            if held is None or (held.description != entry.token and held.look < look.number):
                yield iri, _Change(entry, entry.token, False, _size(held))
        for iri, held in self._state.held.items():
            if iri not in look.described and iri not in self._state.extras and held.look < look.number:
                yield iri, _Change(None, None, False, 0)

    def _vanished(self, look: _Look) -> Iterator[tuple[str, _Change]]:
        """What was there for an earlier query only, and values that a look at everything no longer finds."""
        if not self._state.extras and not look.needs.is_everything:
            return
        found = {entry.iri for entry in look.entries}
        recent = self._recent
        for iri in self._state.extras.difference(found, () if recent is None else recent.unnamed):
            if iri not in self._pinned and self._state.held[iri].look < look.number:
                entry = look.described.get(iri)
                yield iri, _Change(entry, entry and entry.token, False, 0)
        if look.needs.is_everything and look.asked:
            for iri in self._state.live - found - self._state.extras:
                entry = look.described.get(iri)
                if entry is not None and self._state.held[iri].look < look.number:
                    yield iri, _Change(entry, entry.token, False, self._state.held[iri].size)

    # --- what the source says

    def _at_once(self, look: _Look) -> bool:
        """Make small changes here and now. False, with nothing changed, where they are not or others are being made."""
        if self._applying.locked():
            return False
        changes = self._changes(look)
        if not _is_small(changes):
            return False
        self._tell(look, changes, _rendered(_renderings(changes)))
        return True

    async def _apply(self, look: _Look) -> None:
        """One change at a time; what another query has brought meanwhile is not brought again."""
        async with self._applying:
            changes = self._changes(look)
            generation = self._state.generation
            texts = await asyncio.to_thread(_rendered, _renderings(changes), _SLICE)
            self._require(generation)
            self._tell(look, changes, texts)

    def _tell(self, look: _Look, changes: Mapping[str, _Change], texts: Mapping[str, str | None]) -> None:
        self._require(self._state.generation)
        self._target.change(texts)
        self._carried_out(look, changes, {iri: len(text or "") for iri, text in texts.items()})

    # --- what clients keep

    async def sync_stored(self) -> None:
        """Bring to the dataset what clients keep, before a query asks for it."""
        if self._state.generation != self._target.generation:
            self._forget()
        filling = self._filling or self._fill(self._kept[:1])
        assert filling.task is not None
        await asyncio.shield(filling.task)

    async def run(self) -> None:
        """Catch up whenever much has changed since a query asked, at once and then for ever: to be cancelled."""
        while True:
            is_new = self._state.generation != self._target.generation
            if self._kept[0].version - (0 if is_new else self._state.versions[0]) >= _MUCH:
                try:
                    await self.sync_stored()
                except MemoryError as error:
                    _log.error("what clients keep cannot be brought to the dataset now: %s", error)
                    await asyncio.sleep(_SHORT_OF_MEMORY)
                except Problem:  # the process is being started
                    pass
                except Exception:  # the next query, or the next time, may have more luck
                    _log.exception("what clients keep cannot be brought to the dataset now")
            await asyncio.sleep(_GLANCE)

    @property
    def _wanted(self) -> Sequence[int]:
        """What whoever asks now is to see of what clients keep: all that was written before."""
        return [kept.version for kept in self._kept]

    def _is_current(self, scope: frozenset[str] | None, wanted: Sequence[int]) -> bool:
        """Whether the dataset holds what these graphs (None: all) said of what clients keep in the versions wanted."""
        for kept, version, least in zip(self._kept, self._state.versions, wanted, strict=True):
            if version >= least:
                continue
            if scope is None or any(kept.last_change(iri) > self._state.ahead.get(iri, version) for iri in scope):
                return False
        return True

    async def _caught_up(self, scope: frozenset[str] | None, wanted: Sequence[int], deadline: float) -> None:
        """Wait until these graphs are current. Raises Problem 503 with the progress where that takes too long."""
        if self._filling is None and self._bring_at_once():
            return
        loop = asyncio.get_running_loop()
        until = min(deadline, loop.time() + _PATIENCE)
        while not self._is_current(scope, wanted):
            filling = self._filling or self._fill(self._kept)
            assert filling.task is not None
            if not filling.task.done():
                now = loop.time()
                if now < until and filling.seconds_left < _PATIENCE:
                    await asyncio.wait([filling.task], timeout=min(until, now + _GLANCE) - now)
                else:
                    raise process_restarting(min(_LONGEST_RETRY, 1 + int(filling.seconds_left)), str(filling))
            if filling.task.done():
                filling.task.result()
                await asyncio.sleep(0)  # it is put away by a callback, which may not have had its turn

    def _bring_at_once(self) -> bool:
        """Bring here and now what changed, if that is little. False, with nothing changed, where it is not."""
        parts: list[Changes] = []
        versions = [kept.version for kept in self._kept]
        for kept, before, version in zip(self._kept, self._state.versions, versions, strict=True):
            found = kept.changes(before) if version != before else iter(())
            parts += islice(found, 1)
            if next(found, None) is not None:
                return False
        if sum(part.size for part in parts) > _INLINE:
            return False
        self._require(self._state.generation)
        for part in parts:
            self._target.change(_rendered(part.graphs), part.edits)
        self._state.versions = versions
        self._state.ahead.clear()
        return True

    def _fill(self, sources: Sequence[ChangeSource]) -> _Filling:
        """Begin to bring what changed in these sources."""
        total = sum(kept.version - before for kept, before in zip(sources, self._state.versions, strict=False))
        filling = self._filling = _Filling(total)
        task = asyncio.ensure_future(self._bring(sources, filling))
        task.add_done_callback(self._filled)
        filling.task = task
        return filling

    def _filled(self, task: asyncio.Future[None]) -> None:
        self._filling = None
        if not task.cancelled():
            task.exception()  # whoever waits for it sees it too

    async def _bring(self, sources: Sequence[ChangeSource], filling: _Filling) -> None:
        """Bring what changed in these sources by now, part by part."""
        generation, done = self._state.generation, 0
        for place, kept in enumerate(sources):
            before, version = self._state.versions[place], kept.version
            if version != before:
                now = version
                for part in kept.changes(before):
                    await self._bring_part(part, now, generation)
                    version = max(version, part.reached)
                    filling.done = done + max(0, part.reached - before)
                    now = kept.version  # of before the search for the next part
                    await asyncio.sleep(0)
            self._require(generation)
            done += version - before
            self._state.versions[place] = version
        if len(sources) == len(self._kept):
            self._state.ahead.clear()

    async def _bring_part(self, part: Changes, version: int, generation: int) -> None:
        PROCESS_MEMORY.require(part.size * SENT_PER_CHARACTER, f"a part of {part.size} characters for the dataset")
        if part.size <= _INLINE:
            texts = _rendered(part.graphs)
        else:
            texts = await asyncio.to_thread(_rendered, part.graphs, _SLICE)
        await self._target.wait_drained()
        self._require(generation)
        self._target.change(texts, part.edits)
        for iri in part.graphs:
            if iri != part.unfinished:
                self._state.ahead[iri] = version

    # --- what is held

    def _carried_out(self, look: _Look, changes: Mapping[str, _Change], sizes: Mapping[str, int]) -> None:
        for iri, change in changes.items():
            self._note(iri, change, look, sizes[iri])
        self._state.applied = look.revision

    def _note(self, iri: str, change: _Change, look: _Look, size: int) -> None:
        self._state.live.discard(iri)
        self._state.extras.discard(iri)
        if change.entry is None:
            self._state.held.pop(iri, None)
            return
        self._state.held[iri] = _Held(change.entry.token, change.description, change.live, look.number, size)
        if change.live:
            self._state.live.add(iri)
            if change.entry.is_transient or iri not in look.described:
                self._state.extras.add(iri)


def _is_small(changes: Mapping[str, _Change]) -> bool:
    return not changes or sum(change.size for change in changes.values()) <= _INLINE


def _size(held: _Held | None) -> int:
    """How large its graph was; one that is not known yet counts as large."""
    return _INLINE + 1 if held is None else held.size


def _renderings(changes: Mapping[str, _Change]) -> dict[str, Callable[[], str] | None]:
    return {iri: None if change.entry is None else change.entry.ntriples for iri, change in changes.items()}


def _rendered(graphs: Mapping[str, Callable[[], str] | None], slice: float | None = None) -> dict[str, str | None]:
    """The texts of graphs. Whoever renders for longer than a `slice` lets others have their turn, in any thread."""
    texts: dict[str, str | None] = {}
    pause = None if slice is None else time.monotonic() + slice
    for iri, ntriples in graphs.items():
        texts[iri] = None if ntriples is None else _render(iri, ntriples)
        if slice is not None and pause is not None and time.monotonic() > pause:
            time.sleep(slice / 10)
            pause = time.monotonic() + slice
    return texts


def _render(iri: str, ntriples: Callable[[], str]) -> str | None:
    try:
        return ntriples()
    except MemoryError:
        raise
    except Exception:  # a source's failure concerns one graph only
        _log.exception("%s cannot be rendered and is left out of the dataset", iri)
        return None
