"""Synchronisation of stored graphs with the query process: small changes at once, large ones in parts.

Without changes it costs a query the comparison of two numbers. Large changes are sent in the background; queries that
need them wait, or fail with the progress and the time to retry.
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
"""Number of changes that are sent without waiting for a query."""
_POLL_SECONDS = 1.0
"""Maximum number of seconds between checks for changes."""
_BATCH_SECONDS = 0.01
"""Seconds for which successive changes are gathered: a batch costs less than single changes."""
_NEEDED_SECONDS = 10.0
"""Seconds after a query during which small changes are sent as well: without queries a write costs half as much."""
_SHORT_OF_MEMORY = 30.0
"""Seconds until a retry after a lack of memory, unless a query asks earlier."""
_LONGEST_RETRY = 60


class Changes(NamedTuple):
    """Part of the changes: graphs to replace (None: to remove), then edits of other graphs.

    `size` is the approximate number of characters. The functions in `graphs` are called in any thread. `reached` is the
    version that this part completes, if known. The graph `unfinished` continues in the next part.
    """

    graphs: Mapping[str, Callable[[], str] | None]
    edits: Sequence[Edit]
    size: int
    reached: int = 0
    unfinished: str | None = None


class ChangeSource(Protocol):
    """Stored graphs: possibly very many, but few change at a time. Called on the loop."""

    @property
    def version(self) -> int:
        """A number that rises with each change; 0 while there are no graphs."""
        ...

    def may_match(self, needs: Needs) -> bool:
        """Whether a query of these needs can match a triple of the graphs."""
        ...

    def last_change(self, graph: str) -> int:
        """Return an upper bound of the version of the last change of a graph; 0 if it is certainly not one of these."""
        ...

    def changes(self, after: int) -> Iterator[Changes]:
        """Yield the changes after a version, in parts that are quick to find; the loop may run in between.

        Together the parts bring the graphs to the version at the time of the first part, or to what the last has
        `reached`. They may be applied to graphs newer than `after`. An edit counts only after the part that replaces
        its graph.
        """
        ...


class HeldGraph(NamedTuple):
    """A graph in the target.

    `token` is the token of the graph, `description` that of its description (None without one), `number` that of the
    reading it comes from, `size` its characters of N-Triples, `observed` whether it has observations of its messages.
    """

    token: Hashable
    description: Hashable
    has_values: bool
    number: int
    size: int
    observed: bool = False


class TargetState:
    """Contents of the target according to what was sent since its start; a restart empties it."""

    def __init__(self, target: QueryProcess, stores: int) -> None:
        self._target = target
        self._stores = stores
        self._forget()

    def _forget(self) -> None:
        self.versions = [0] * self._stores
        """The versions of the stored graphs in the target, one for each source."""
        self.ahead: dict[str, int] = {}
        """Stored graphs that are newer than these versions, with their own."""
        self.held: dict[str, HeldGraph] = {}
        """The graphs from the `GraphSource`."""
        self.live: set[str] = set()
        """Held graphs with live values."""
        self.transient: set[str] = set()
        """Held graphs that are present only for the queries that name them."""
        self.descriptions: Hashable = object()
        """The revision of the descriptions in the target."""
        self.generation = self._target.generation
        """The generation of the target that this state describes; set last, because other threads read it."""

    @property
    def is_outdated(self) -> bool:
        """Whether the target has restarted since."""
        return self.generation != self._target.generation

    def follow_restart(self) -> bool:
        """Reset if the target has restarted; return whether it has."""
        is_new = self.is_outdated
        if is_new:
            self._forget()
        return is_new

    def require(self, generation: int) -> None:
        """Raise Problem 503 if the target has restarted since this generation."""
        if not generation == self.generation == self._target.generation:
            raise process_restarting(1)


def render_graphs(graphs: Renderings, slice: float | None = None) -> dict[str, str | None]:
    """Return the N-Triples of graphs; None for removed ones and (logged) for those whose source fails.

    With a `slice` (seconds) the thread sleeps for a tenth of it after each slice. Raises MemoryError.
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
    """Run `render_graphs` in a thread that yields to the loop regularly. Raises MemoryError."""
    return await asyncio.to_thread(render_graphs, graphs, _SLICE)


def _render(iri: str, ntriples: Callable[[], str]) -> str | None:
    try:
        return ntriples()
    except MemoryError:
        raise
    except Exception:  # a source's failure concerns one graph only
        _log.exception("%s cannot be rendered and is omitted from the dataset", iri)
        return None


class _Transfer:
    """Stored graphs on their way to the process. `total` is the number of changes."""

    def __init__(self, total: int) -> None:
        self.task: asyncio.Future[None] | None = None
        self.total = max(1, total)
        self.done = 0
        self.begun = time.monotonic()

    @property
    def seconds_left(self) -> float:
        """Estimate of the remaining seconds."""
        passed = time.monotonic() - self.begun
        return passed * (self.total - self.done) / self.done if self.done else 0.0

    def __str__(self) -> str:
        share = min(99, 100 * self.done // self.total)
        return f"Stored resources are being loaded into the dataset: {share} % done."


class StoredSync:
    """Sends stored graphs from their sources to the target. Belongs to one loop."""

    def __init__(self, target: QueryProcess, state: TargetState, sources: Sequence[ChangeSource]) -> None:
        self._target = target
        self._state = state
        self._sources = sources
        self._transfer: _Transfer | None = None
        self._needed_at = [float("-inf")] * len(sources)
        """The time of the last query that needed each source."""

    @property
    def progress(self) -> str | None:
        """The progress of a transfer in words, None if little is missing (thread-safe)."""
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
        """Send changes for ever: many at once, few only while queries arrive, which then need not wait."""
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
                _log.error("stored resources cannot be loaded into the dataset now: %s", error)
                pause = _SHORT_OF_MEMORY
            except Problem:  # the process is being started
                pass
            except Exception:  # the next attempt or query may succeed
                _log.exception("stored resources cannot be loaded into the dataset now")

    def _soon_wanted(self) -> Sequence[int]:
        """Return the versions that the next query is likely to need, 0 for sources that no query needed lately."""
        since = time.monotonic() - _NEEDED_SECONDS
        pairs = zip(self._sources, self._needed_at, strict=True)
        return [source.version if needed_at > since else 0 for source, needed_at in pairs]

    async def _sync(self) -> None:
        """Send the stored graphs. Raises NotEnoughMemory, and Problem 503 if the process restarts meanwhile."""
        self._state.follow_restart()
        transfer = self._transfer or self._start(self.wanted_of_clients)
        assert transfer.task is not None
        await asyncio.shield(transfer.task)

    def wanted(self, needs: Needs) -> Sequence[int]:
        """Return the versions that a query must see: the current ones, 0 for a source that it cannot match."""
        now, found = time.monotonic(), []
        for place, source in enumerate(self._sources):
            is_wanted = source.may_match(needs)
            found.append(source.version if is_wanted else 0)
            if is_wanted:
                self._needed_at[place] = now
        return found

    @property
    def wanted_of_clients(self) -> Sequence[int]:
        """The version of the graphs that clients store, and 0 for the other sources."""
        return [source.version if place == 0 else 0 for place, source in enumerate(self._sources)]

    def _due(self, wanted: Sequence[int]) -> Sequence[int]:
        """Return the indexes of the sources that are behind the wanted versions."""
        versions = [0] * len(self._sources) if self._state.is_outdated else self._state.versions
        return [place for place, least in enumerate(wanted) if versions[place] < least]

    def is_current(self, scope: frozenset[str] | None, wanted: Sequence[int]) -> bool:
        """Whether these stored graphs (None: all) have at least the wanted versions in the target."""
        for source, version, least in zip(self._sources, self._state.versions, wanted, strict=True):
            if version >= least:
                continue
            ahead = self._state.ahead
            if scope is None or any(source.last_change(iri) > max(version, ahead.get(iri, 0)) for iri in scope):
                return False
        return True

    async def catch_up(self, scope: frozenset[str] | None, wanted: Sequence[int], deadline: float) -> None:
        """Wait until these graphs (None: all) are current.

        Raises Problem 503 with the progress if they are not by `deadline` (loop time).
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
                await asyncio.sleep(0)  # a callback, which may not have run yet, removes the transfer

    def _send_little(self, wanted: Sequence[int]) -> bool:
        """Send the wanted changes if they are small, else return False without sending any."""
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
        due = self._due(wanted)
        transfer = self._transfer = _Transfer(sum(wanted[place] - self._state.versions[place] for place in due))
        task = asyncio.ensure_future(self._send(due, transfer))
        task.add_done_callback(self._end)
        transfer.task = task
        return transfer

    def _end(self, task: asyncio.Future[None]) -> None:
        self._transfer = None
        if not task.cancelled():
            task.exception()  # everyone who awaits the task gets the exception too

    async def _send(self, places: Sequence[int], transfer: _Transfer) -> None:
        """Send the changes of the sources at these indexes, part by part."""
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
                    now = source.version  # read before the search for the next part
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
