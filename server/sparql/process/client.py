"""The server's end of the query process: sends it changes and work, and starts it again where it dies."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import pickle
import signal
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from functools import partial
from itertools import count
from typing import cast

from rosld.server.dataset.base import Edit
from rosld.server.http.problem import Problem
from rosld.server.runtime.process_memory import DATASET_PER_CHARACTER, DATASET_PER_TRIPLE
from rosld.server.sparql.disconnect import Disconnected
from rosld.server.sparql.process.child import ChildProcess, spawn
from rosld.server.sparql.process.evaluation import Aborted, Evaluation, PendingJob, crash_reason
from rosld.server.sparql.process.fork import ExitStatus
from rosld.server.sparql.process.frames import Cancel, Change, Drop, Job, Kind, Reply, pack
from rosld.server.sparql.process.work import Work
from rosld.server.sparql.query_limits import Limits, process_restarting

_log = logging.getLogger("rosld.sparql")

_LARGE = 64 * 1024
"""Bytes of a job from which on memory is asked for: less is within the margin."""
_PER_BYTE = 3
"""Bytes that a job takes in the process before it is begun, for each of its own."""
_PATIENCE = 2.0
"""Seconds that a query waits for a process that is being started."""
_AT_ONCE = 1.0
"""A process that lives no longer is not started again at once."""
_LONGEST_PAUSE = 30.0


class QueryProcess:
    """The process. Belongs to one loop; `start` and `close` it there.

    `version` changes with each change of a dataset, `generation` with each start: a new process holds nothing, which is
    told to the listeners of `on_start`.
    """

    def __init__(self, concurrency: int, queue: int) -> None:
        self._spawn = partial(spawn, concurrency, queue)
        self._numbers = count(1)
        self._datasets = count(1)
        self.version = 0
        self.generation = 0
        self._jobs: dict[int, PendingJob] = {}
        self._child: ChildProcess | None = None
        self._up = asyncio.Event()
        self._restart: asyncio.Task[None] | None = None
        self._closed = False
        self._on_start: list[Callable[[], None]] = []
        self._on_change: list[Callable[[Mapping[str, str | None], Sequence[Edit]], None]] = []

    @property
    def pid(self) -> int | None:
        """The number of the process, None while there is none."""
        return None if self._child is None else self._child.popen.pid

    def on_start(self, listener: Callable[[], None]) -> None:
        """Call the listener whenever the process has been started again, and holds nothing."""
        self._on_start.append(listener)

    def on_change(self, listener: Callable[[Mapping[str, str | None], Sequence[Edit]], None]) -> None:
        """Call the listener with each change of the first dataset from now on."""
        self._on_change.append(listener)

    async def start(self) -> None:
        """Start the process; it need not be waited for. Raises OSError."""
        self._loop = asyncio.get_running_loop()
        spawned = await self._loop.run_in_executor(None, self._spawn)
        if self._closed:
            popen, connection, _ = spawned
            popen.kill()
            connection.close()
            return
        self._child = ChildProcess(spawned, self._loop, self._take, self._lost)
        self.generation += 1
        self.version += 1
        for told in self._on_start:
            told()
        self._up.set()

    async def close(self) -> None:
        """End the process, with all that it does. Idempotent."""
        self._closed = True
        if self._restart is not None:
            self._restart.cancel()
        self._up.clear()
        child, self._child = self._child, None
        if child is not None:
            child.close()
            child.popen.kill()
            await self._loop.run_in_executor(None, child.popen.wait)
        self._fail_all(process_restarting(1))

    @property
    def _running(self) -> ChildProcess:
        """The process. Raises Problem 503 where it is not there."""
        if self._child is None:
            raise process_restarting(1)
        return self._child

    async def wait_ready(self, until: float) -> None:
        """Wait a moment for the process to be there. Raises Problem 503 where it is not."""
        if self._up.is_set():
            return
        try:
            await asyncio.wait_for(self._up.wait(), max(0.0, min(_PATIENCE, until - time.monotonic())))
        except asyncio.TimeoutError as error:
            raise process_restarting(1) from error

    # --- what it is told

    def change(self, graphs: Mapping[str, str | None], edits: Sequence[Edit] = (), dataset: int = 0) -> None:
        """Replace graphs, then do edits, as `Store.replace`: all that is asked afterwards sees it.

        A graph that cannot be stored is left out, and told of in the log. Raises Problem 503 where there is no process,
        and NotEnoughMemory where the process has none for what is added.
        """
        if not graphs and not edits:
            return
        added = [*filter(None, graphs.values()), *(edit.added for edit in edits if edit.added)]
        characters = sum(map(len, added))
        needed = characters * DATASET_PER_CHARACTER + sum(text.count("\n") for text in added) * DATASET_PER_TRIPLE
        if needed:
            self._running.require_memory(needed, f"the dataset, for changes of {characters} characters,")
        self._running.send_change(pack(Change(dataset, dict(graphs), [*edits])), needed)
        if dataset == 0:
            self.version += 1
            for told in self._on_change:
                told(graphs, edits)

    def new_dataset(self) -> int:
        """The number of another dataset, with nothing in it."""
        return next(self._datasets)

    def drop(self, dataset: int) -> None:
        """Let go of another dataset."""
        with contextlib.suppress(Problem):
            self._running.send(pack(Drop(dataset)))

    async def answer(
        self,
        work: Work,
        limits: Limits,
        until: float,
        disconnected: Disconnected | None = None,
        dataset: int = 0,
    ) -> bytes | AsyncIterator[bytes]:
        """What the work writes: all bytes where they are few, else an iterator, which raises Aborted where it breaks.

        `until` is when the time is over (monotonic), `limits.seconds` is what this comes from. Whoever hangs up has the
        work ended. Raises what the work raises, and Problems: 503 where a limit is reached, too much is being done or
        the process must be started again, 500 where the work ended the process that did it.
        """
        return await Evaluation(self, work, limits, until, disconnected).run(dataset)

    async def result(self, work: Work, limits: Limits, until: float, disconnected: Disconnected | None = None) -> bytes:
        """All that the work writes. Raises as `answer` does."""
        found = await self.answer(work, limits, until, disconnected)
        if isinstance(found, bytes):
            return found
        try:
            return b"".join([chunk async for chunk in found])
        except Aborted as error:
            raise error.__cause__ or Problem(503, str(error)) from None

    def result_for_thread(self, work: Work, seconds: float) -> bytes:
        """The same for another thread. Raises TimeoutError."""
        coming = asyncio.run_coroutine_threadsafe(
            self.result(work, Limits(seconds), time.monotonic() + seconds), self._loop
        )
        return coming.result(seconds + 1)

    def begin(self, work: Work, limits: Limits, dataset: int, on_wait: Callable[[], None]) -> tuple[int, PendingJob]:
        """Have work begun. For `Evaluation`."""
        number, pending = next(self._numbers), PendingJob(self._loop, work, on_wait)
        data = pack(Job(number, dataset, work, limits.seconds, limits.memory))
        if len(data) > _LARGE:
            self._running.require_memory(len(data) * _PER_BYTE, f"a request of {len(data)} bytes")
        self._running.send(data)
        self._jobs[number] = pending
        return number, pending

    @property
    def is_behind(self) -> bool:
        """Whether the process is still to make changes that it was sent. For `Evaluation`."""
        return self._child is not None and self._child.is_behind

    def cancel(self, number: int) -> None:
        """End a job that is not wanted any more. For `Evaluation`."""
        pending = self._jobs.get(number)
        if pending is not None and not pending.is_over:
            pending.is_over = True
            with contextlib.suppress(Problem):
                self._running.send(pack(Cancel(number)))

    def forget(self, number: int) -> None:
        """Nothing more is expected of a job. For `Evaluation`."""
        self._jobs.pop(number, None)

    async def wait_drained(self) -> None:
        """Return when the process has taken most of what it was sent, or is gone."""
        if self._child is not None:
            await self._child.wait_drained()

    # --- what it tells

    def _take(self, reply: Reply, descriptors: deque[int]) -> None:
        kind, number, value = reply
        if kind is Kind.REFUSED:
            graph, why = cast("tuple[str, str]", value)
            _log.error("%s is left out of the dataset: %s", graph, why)
            return
        descriptor = descriptors.popleft() if kind is Kind.FORKED else -1
        pending = self._jobs.get(number)
        if pending is None or (pending.first.done() and kind is not Kind.ENDED):
            if descriptor >= 0:
                os.close(descriptor)
            return
        pending.is_over |= kind in (Kind.DONE, Kind.RAISED, Kind.ENDED)
        match kind:
            case Kind.DONE:
                pending.first.set_result(cast("bytes", value))
            case Kind.RAISED:
                pending.first.set_exception(pickle.loads(cast("bytes", value)))  # from our own process
            case Kind.FORKED:
                pending.ended = self._loop.create_future()
                pending.ended.add_done_callback(_looked_at)
                pending.first.set_result(descriptor)
            case Kind.WAITING:
                pending.on_wait()
            case Kind.ENDED:
                if pending.ended is not None and not pending.ended.done():
                    pending.ended.set_result(cast("ExitStatus", value))

    # --- its death

    def _lost(self) -> None:
        self._up.clear()
        if not self._closed:
            self._restart = self._loop.create_task(self._start_again())

    async def _start_again(self) -> None:
        """Tell of the death to whom it concerns, and start the process again."""
        child = self._child
        assert child is not None
        status = await self._loop.run_in_executor(None, child.popen.wait)
        self._blame(status, child.at_work.number)
        pause = 0.0 if time.monotonic() - child.started > _AT_ONCE else 0.1
        while not self._closed:
            await asyncio.sleep(pause)
            try:
                await self.start()
            except (OSError, MemoryError, RuntimeError) as error:  # no memory, no process, no thread
                _log.error("the query process cannot be started again now: %s", error)
                pause = min(_LONGEST_PAUSE, max(0.5, 2 * pause))
            else:
                return

    def _blame(self, status: int, number: int) -> None:
        """Fail all jobs: the one of this number, which it was at, where that ended it, all others with a 503."""
        guilty = None if status == -signal.SIGKILL else self._jobs.get(number)
        what = "" if guilty is None else f" by {_brief_work(guilty.work)}"
        how = f"signal {-status}" if status < 0 else f"exit {status}"
        _log.error("the query process was ended%s (%s); it is started again", what, how)
        if guilty is not None and not guilty.first.done():
            guilty.first.set_exception(crash_reason(status))
        self._fail_all(process_restarting(1))

    def _fail_all(self, problem: Problem) -> None:
        for pending in self._jobs.values():
            if not pending.first.done():
                pending.first.set_exception(problem)
            elif pending.ended is not None and not pending.ended.done():
                pending.ended.set_exception(problem)
        self._jobs.clear()


def _looked_at(future: asyncio.Future[ExitStatus]) -> None:
    """Nobody may ask for it."""
    if not future.cancelled():
        future.exception()


def _brief_work(work: Work) -> str:
    text = repr(work)
    return text if len(text) <= 2000 else text[:2000] + "..."
