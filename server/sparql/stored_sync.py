"""Synchronisation of stored graphs with the query process: at once where little has changed, else part by part.

As long as nothing changes it costs a query the comparison of two numbers. Where there is very much it is brought in the
background, and queries that need it are told how far it is, and to come again.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from itertools import islice
from typing import NamedTuple, Protocol, TypeAlias

from rosld.server.dataset import Edit
from rosld.server.http.problem import Problem
from rosld.server.runtime.process_memory import PROCESS_MEMORY, SENT_PER_CHARACTER
from rosld.server.sparql.needs import Needs
from rosld.server.sparql.process.client import QueryProcess
from rosld.server.sparql.query_limits import process_restarting

_log = logging.getLogger("rosld.sparql")

INLINE = 64 * 1024
"""Characters of N-Triples up to which graphs are rendered on the loop: a thread would cost more."""
_SLICE = 0.002
"""Seconds of rendering in a thread after which the loop gets its turn: both need the interpreter's lock."""

Renderings: TypeAlias = Mapping[str, Callable[[], str] | None]
"""Functions that render graphs, by IRI; None for a graph that is removed."""

_MUCH = 1000
"""Changes that are not left for a query to find."""
_POLL_SECONDS = 1.0
"""Seconds between looks at how many there are, at most."""
_BATCH_SECONDS = 0.01
"""Seconds for which changes are gathered that come one after the other: a batch costs less than they do alone."""
_ASKED_SECONDS = 10.0
"""Seconds after a query for which few changes are brought, too: a write costs half as much where nobody asks."""
_SHORT_OF_MEMORY = 30.0
"""Seconds until what there was no memory for is tried again, unless a query asks for it."""
_LONGEST_RETRY = 60


class Changes(NamedTuple):
    """A part of what changed: graphs replaced by what they say then (None: gone), after these the edits of others.

    `size` is about how many characters it comes to. What `graphs` holds is called in any thread. `reached` is the
    version up to which changes have been told with this part, as far as that is known. The graph that is `unfinished`
    goes on in the next part.
    """

    graphs: Mapping[str, Callable[[], str] | None]
    edits: Sequence[Edit]
    size: int
    reached: int = 0
    unfinished: str | None = None


class ChangeSource(Protocol):
    """Graphs that clients keep. There may be very many, few of which change at a time. Called on the loop."""

    @property
    def version(self) -> int:
        """A number that rises with each change; 0 as long as there is nothing."""
        ...

    def may_match(self, needs: Needs) -> bool:
        """Whether a query of these needs can match a triple of the graphs."""
        ...

    def last_change(self, graph: str) -> int:
        """No less than the version of the last change of a graph; 0 for one that is certainly none of these."""
        ...

    def changes(self, after: int) -> Iterator[Changes]:
        """What changed after a version, in parts that are found quickly each; the loop may have its turn in between.

        All parts together bring the graphs from that version to the one that is in force when the first is asked for,
        or to what the last has `reached`. Doing them to graphs that are newer than `after` already is no harm. An edit
        counts only where it comes after the part that replaces its graph.
        """
        ...


class HeldGraph(NamedTuple):
    """A graph as the target holds it.

    `token` is its own, `description` that of its description then, None for a graph without one. `number` is that of
    the reading it is of, `size` is in characters of N-Triples.
    """

    token: Hashable
    description: Hashable
    has_values: bool
    number: int
    size: int


class TargetState:
    """What the target holds, by what it was sent since its start: nothing again once it has started anew."""

    def __init__(self, target: QueryProcess, stores: int) -> None:
        self._target = target
        self._stores = stores
        self._forget()

    def _forget(self) -> None:
        self.versions = [0] * self._stores
        """The versions of what clients keep, by its place among the sources."""
        self.ahead: dict[str, int] = {}
        """Graphs that clients keep which are newer than these versions."""
        self.held: dict[str, HeldGraph] = {}
        """The graphs that come from the `GraphSource`."""
        self.live: set[str] = set()
        """Those of them that have values which change by themselves."""
        self.transient: set[str] = set()
        """Those of them that are there for the queries that name them."""
        self.descriptions: Hashable = object()
        """The revision of the descriptions that it holds."""
        self.generation = self._target.generation
        """That of the target to which all this belongs; the last to be set, for those who look from another thread."""

    @property
    def is_outdated(self) -> bool:
        """Whether the target has started anew, and holds nothing of this."""
        return self.generation != self._target.generation

    def follow_restart(self) -> bool:
        """Hold nothing where the target has started anew; whether it has."""
        is_new = self.is_outdated
        if is_new:
            self._forget()
        return is_new

    def require(self, generation: int) -> None:
        """Raise Problem 503 where the target holds nothing any more that it was sent in this generation."""
        if not generation == self.generation == self._target.generation:
            raise process_restarting(1)


def render_graphs(graphs: Renderings, slice: float | None = None) -> dict[str, str | None]:
    """The N-Triples of graphs; None for those that go, and for those whose source fails, which is logged.

    With a `slice` (seconds) it pauses for a tenth of that after each. Raises MemoryError.
    """
    texts: dict[str, str | None] = {}
    pause = None if slice is None else time.monotonic() + slice
    for iri, ntriples in graphs.items():
        texts[iri] = None if ntriples is None else _render(iri, ntriples)
        if slice is not None and pause is not None and time.monotonic() > pause:
            time.sleep(slice / 10)
            pause = time.monotonic() + slice
    return texts


async def render_in_thread(graphs: Renderings) -> dict[str, str | None]:
    """`render_graphs` in a thread which lets the loop have its turn. Raises MemoryError."""
    return await asyncio.to_thread(render_graphs, graphs, _SLICE)


def _render(iri: str, ntriples: Callable[[], str]) -> str | None:
    try:
        return ntriples()
    except MemoryError:
        raise
    except Exception:  # a source's failure concerns one graph only
        _log.exception("%s cannot be rendered and is left out of the dataset", iri)
        return None


class _Transfer:
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


class StoredSync:
    """Brings what clients keep from its sources to the target. Belongs to one loop."""

    def __init__(self, target: QueryProcess, state: TargetState, sources: Sequence[ChangeSource]) -> None:
        self._target = target
        self._state = state
        self._sources = sources
        self._transfer: _Transfer | None = None
        self._asked = [float("-inf")] * len(sources)
        """When a query wanted each of the sources last."""

    @property
    def progress(self) -> str | None:
        """How far what clients keep is on its way to the dataset, None where little is missing; from any thread."""
        if self._transfer is not None:
            return str(self._transfer)
        missing = self._missing()
        return str(_Transfer(missing)) if missing >= _MUCH else None

    def _missing(self) -> int:
        """Return the number of changes of the first source that the target has yet to be sent."""
        if not self._sources:
            return 0
        return self._sources[0].version - (0 if self._state.is_outdated else self._state.versions[0])

    async def run(self) -> None:
        """Bring what changes, for ever: much at once, little only while queries come, which then find it there."""
        pause = 0.0
        while True:
            await asyncio.sleep(pause)
            pause = min(_POLL_SECONDS, 2 * pause + _BATCH_SECONDS)
            try:
                if self._missing() >= _MUCH:
                    await self._sync()
                elif self._due(wanted := self._soon_wanted()) and self._transfer is None:
                    self._state.follow_restart()
                    self._send_little(wanted)
                    pause = _BATCH_SECONDS
            except MemoryError as error:
                _log.error("what clients keep cannot be brought to the dataset now: %s", error)
                pause = _SHORT_OF_MEMORY
            except Problem:  # the process is being started
                pass
            except Exception:  # the next query, or the next time, may have more luck
                _log.exception("what clients keep cannot be brought to the dataset now")

    def _soon_wanted(self) -> Sequence[int]:
        """Return the versions that the next query is likely to want, 0 for those that none has wanted lately."""
        since = time.monotonic() - _ASKED_SECONDS
        pairs = zip(self._sources, self._asked, strict=True)
        return [source.version if asked > since else 0 for source, asked in pairs]

    async def _sync(self) -> None:
        """Bring what clients keep. Raises Problem 503 if the process starts anew meanwhile, and NotEnoughMemory."""
        self._state.follow_restart()
        transfer = self._transfer or self._start(self.wanted_of_clients)
        assert transfer.task is not None
        await asyncio.shield(transfer.task)

    def wanted(self, needs: Needs) -> Sequence[int]:
        """Return the versions that a query is to see: those of now, 0 for a source of which it can match nothing."""
        now, found = time.monotonic(), []
        for place, source in enumerate(self._sources):
            is_wanted = source.may_match(needs)
            found.append(source.version if is_wanted else 0)
            if is_wanted:
                self._asked[place] = now
        return found

    @property
    def wanted_of_clients(self) -> Sequence[int]:
        """The version of what clients keep, and 0 for the other sources."""
        return [source.version if place == 0 else 0 for place, source in enumerate(self._sources)]

    def _due(self, wanted: Sequence[int]) -> Sequence[int]:
        """Return the places of the sources that are not as wanted."""
        versions = [0] * len(self._sources) if self._state.is_outdated else self._state.versions
        return [place for place, least in enumerate(wanted) if versions[place] < least]

    def is_current(self, scope: frozenset[str] | None, wanted: Sequence[int]) -> bool:
        """Whether the target holds what clients keep in these graphs (None: in all) as of the versions wanted."""
        for source, version, least in zip(self._sources, self._state.versions, wanted, strict=True):
            if version >= least:
                continue
            ahead = self._state.ahead
            if scope is None or any(source.last_change(iri) > max(version, ahead.get(iri, 0)) for iri in scope):
                return False
        return True

    async def catch_up(self, scope: frozenset[str] | None, wanted: Sequence[int], deadline: float) -> None:
        """Wait until these graphs (None: all) are current.

        Raises Problem 503 with the progress where that takes longer than until `deadline` (loop time).
        """
        if self._transfer is None and self._send_little(wanted):
            return
        loop = asyncio.get_running_loop()
        while not self.is_current(scope, wanted):
            transfer = self._transfer or self._start(wanted)
            assert transfer.task is not None
            if not transfer.task.done():
                now = loop.time()
                if transfer.seconds_left < deadline - now:
                    await asyncio.wait([transfer.task], timeout=min(deadline, now + _POLL_SECONDS) - now)
                else:
                    raise process_restarting(min(_LONGEST_RETRY, 1 + int(transfer.seconds_left)), str(transfer))
            if transfer.task.done():
                transfer.task.result()
                await asyncio.sleep(0)  # it is put away by a callback, which may not have had its turn

    def _send_little(self, wanted: Sequence[int]) -> bool:
        """Send here and now what is wanted, if that is little. False, with nothing sent, where it is not."""
        parts: list[Changes] = []
        versions = list(self._state.versions)
        for place in self._due(wanted):
            found = self._sources[place].changes(versions[place])
            versions[place] = self._sources[place].version
            parts += islice(found, 1)
            if next(found, None) is not None:
                return False
        if sum(part.size for part in parts) > INLINE:
            return False
        self._state.require(self._state.generation)
        for part in parts:
            self._target.change(render_graphs(part.graphs), part.edits)
        self._state.versions = versions
        return True

    def _start(self, wanted: Sequence[int]) -> _Transfer:
        """Begin to send what is wanted."""
        due = self._due(wanted)
        transfer = self._transfer = _Transfer(sum(wanted[place] - self._state.versions[place] for place in due))
        task = asyncio.ensure_future(self._send(due, transfer))
        task.add_done_callback(self._end)
        transfer.task = task
        return transfer

    def _end(self, task: asyncio.Future[None]) -> None:
        self._transfer = None
        if not task.cancelled():
            task.exception()  # whoever waits for it sees it too

    async def _send(self, places: Sequence[int], transfer: _Transfer) -> None:
        """Send what changed by now in the sources of these places, part by part."""
        generation, done = self._state.generation, 0
        for place in places:
            source = self._sources[place]
            before, version = self._state.versions[place], source.version
            if version != before:
                now = version
                for part in source.changes(before):
                    await self._send_part(part, now, generation)
                    version = max(version, part.reached)
                    transfer.done = done + max(0, part.reached - before)
                    now = source.version  # of before the search for the next part
                    await asyncio.sleep(0)
            self._state.require(generation)
            done += version - before
            self._state.versions[place] = version
        if 0 in places:
            self._state.ahead.clear()

    async def _send_part(self, part: Changes, version: int, generation: int) -> None:
        PROCESS_MEMORY.require(part.size * SENT_PER_CHARACTER, f"a part of {part.size} characters for the dataset")
        if part.size <= INLINE:
            texts = render_graphs(part.graphs)
        else:
            texts = await render_in_thread(part.graphs)
        await self._target.wait_drained()
        self._state.require(generation)
        self._target.change(texts, part.edits)
        for iri in part.graphs:
            if iri != part.unfinished:
                self._state.ahead[iri] = version
