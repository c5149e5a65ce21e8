"""Synchronisation of stored graphs with the query process: at once where little has changed, else part by part.

As long as nothing changes it costs a query the comparison of two numbers. Where there is very much it is brought in the
background, and queries that need it are told how far it is, and to come again.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Sequence
from itertools import islice

from rosld.server.http.problem import Problem
from rosld.server.runtime.process_memory import PROCESS_MEMORY, SENT_PER_CHARACTER
from rosld.server.sparql.change_source import Changes, ChangeSource
from rosld.server.sparql.graph_rendering import INLINE, render_graphs, render_in_thread
from rosld.server.sparql.query_limits import process_restarting
from rosld.server.sparql.sync_target import SyncTarget, TargetState

_log = logging.getLogger("rosld.sparql")

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
_PATIENCE = 5.0
"""Seconds that a query waits."""
_LONGEST_RETRY = 60


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

    def __init__(self, target: SyncTarget, state: TargetState, sources: Sequence[ChangeSource]) -> None:
        self._target = target
        self._state = state
        self._sources = sources
        self._transfer: _Transfer | None = None
        self._asked = float("-inf")

    @property
    def progress(self) -> str | None:
        """How far what clients keep is on its way to the dataset, None where little is missing; from any thread."""
        if self._transfer is not None:
            return str(self._transfer)
        missing = self._missing()
        return str(_Transfer(missing)) if missing >= _MUCH else None

    def _missing(self) -> int:
        """How many changes of the first source the target was not sent yet."""
        return self._sources[0].version - (0 if self._state.is_outdated else self._state.versions[0])

    async def run(self) -> None:
        """Bring what changes, for ever: much at once, little only while queries come, which then find it there."""
        pause = 0.0
        while True:
            await asyncio.sleep(pause)
            pause = min(_POLL_SECONDS, 2 * pause + _BATCH_SECONDS)
            missing = self._missing()
            if missing == 0 or (missing < _MUCH and time.monotonic() - self._asked > _ASKED_SECONDS):
                continue
            try:
                await self._sync()
                pause = _BATCH_SECONDS
            except MemoryError as error:
                _log.error("what clients keep cannot be brought to the dataset now: %s", error)
                pause = _SHORT_OF_MEMORY
            except Problem:  # the process is being started
                pass
            except Exception:  # the next query, or the next time, may have more luck
                _log.exception("what clients keep cannot be brought to the dataset now")

    async def _sync(self) -> None:
        """Bring what there is. Raises Problem 503 if the process starts anew meanwhile, and NotEnoughMemory."""
        self._state.follow_restart()
        if self._transfer is None and self._send_little():
            return
        transfer = self._transfer or self._start(self._sources)
        assert transfer.task is not None
        await asyncio.shield(transfer.task)

    @property
    def versions(self) -> Sequence[int]:
        """The versions of all sources, which whoever asks now is to see: all that was written before."""
        return [source.version for source in self._sources]

    def is_current(self, scope: frozenset[str] | None, wanted: Sequence[int]) -> bool:
        """Whether the target holds what clients keep in these graphs (None: in all) as of the versions wanted."""
        for source, version, least in zip(self._sources, self._state.versions, wanted, strict=True):
            if version >= least:
                continue
            if scope is None or any(source.last_change(iri) > self._state.ahead.get(iri, version) for iri in scope):
                return False
        return True

    async def catch_up(self, scope: frozenset[str] | None, wanted: Sequence[int], deadline: float) -> None:
        """Wait until these graphs (None: all) are current.

        Raises Problem 503 with the progress where that takes too long: longer than until `deadline` (loop time), or
        than a query is to wait.
        """
        self._asked = time.monotonic()
        if self._transfer is None and self._send_little():
            return
        loop = asyncio.get_running_loop()
        until = min(deadline, loop.time() + _PATIENCE)
        while not self.is_current(scope, wanted):
            transfer = self._transfer or self._start(self._sources)
            assert transfer.task is not None
            if not transfer.task.done():
                now = loop.time()
                if now < until and transfer.seconds_left < _PATIENCE:
                    await asyncio.wait([transfer.task], timeout=min(until, now + _POLL_SECONDS) - now)
                else:
                    raise process_restarting(min(_LONGEST_RETRY, 1 + int(transfer.seconds_left)), str(transfer))
            if transfer.task.done():
                transfer.task.result()
                await asyncio.sleep(0)  # it is put away by a callback, which may not have had its turn

    def _send_little(self) -> bool:
        """Send here and now what changed, if that is little. False, with nothing sent, where it is not."""
        parts: list[Changes] = []
        versions = [source.version for source in self._sources]
        for source, before, version in zip(self._sources, self._state.versions, versions, strict=True):
            found = source.changes(before) if version != before else iter(())
            parts += islice(found, 1)
            if next(found, None) is not None:
                return False
        if sum(part.size for part in parts) > INLINE:
            return False
        self._state.require(self._state.generation)
        for part in parts:
            self._target.change(render_graphs(part.graphs), part.edits)
        self._state.versions = versions
        self._state.ahead.clear()
        return True

    def _start(self, sources: Sequence[ChangeSource]) -> _Transfer:
        """Begin to send what changed in these sources."""
        total = sum(source.version - before for source, before in zip(sources, self._state.versions, strict=False))
        transfer = self._transfer = _Transfer(total)
        task = asyncio.ensure_future(self._send(sources, transfer))
        task.add_done_callback(self._end)
        transfer.task = task
        return transfer

    def _end(self, task: asyncio.Future[None]) -> None:
        self._transfer = None
        if not task.cancelled():
            task.exception()  # whoever waits for it sees it too

    async def _send(self, sources: Sequence[ChangeSource], transfer: _Transfer) -> None:
        """Send what changed in these sources by now, part by part."""
        generation, done = self._state.generation, 0
        for place, source in enumerate(sources):
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
        if len(sources) == len(self._sources):
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
