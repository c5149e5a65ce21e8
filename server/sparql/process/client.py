"""The server's side of the query process: sends changes, runs work in workers, restarts the process if it dies."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from itertools import count

from rosld.server.dataset.base import Edit
from rosld.server.http.problem import Problem
from rosld.server.runtime.process_memory import DATASET_PER_CHARACTER, DATASET_PER_TRIPLE
from rosld.server.runtime.tasks import Signal
from rosld.server.sparql.disconnect import Disconnected
from rosld.server.sparql.process.connection import ChildProcess, spawn
from rosld.server.sparql.process.frames import Change, Drop, Ended, Job, Refused, pack
from rosld.server.sparql.process.pool import Aborted, Evaluation, WorkerPool
from rosld.server.sparql.process.work import Work
from rosld.server.sparql.query_limits import Limits, process_restarting

_log = logging.getLogger("rosld.sparql")

_LARGE = 64 * 1024
"""Bytes of a job above which available memory is checked; smaller ones are within the margin."""
_PER_BYTE = 3
"""Bytes that the process needs for each byte of a job that waits."""
_PATIENCE = 2.0
"""Seconds that a query waits for a process that is starting."""
_AT_ONCE = 1.0
"""Minimum lifetime in seconds of a process that is restarted without a pause."""
_LONGEST_PAUSE = 30.0


class QueryProcess:
    """The process and its workers. Belongs to one loop; `start` and `close` it there.

    The process holds the datasets and makes changes; its workers, which are forks of it, do the work: at most
    `concurrency` at a time, while at most `queue` jobs wait. `generation` changes with each start: a new process has
    empty datasets, and `starts` is emitted.
    """

    def __init__(self, concurrency: int, queue: int) -> None:
        self._datasets = count(1)
        self._first = 0
        """Number of the dataset that 0 stands for."""
        self.generation = 0
        self._pool = WorkerPool(concurrency, queue)
        self._ready = asyncio.Event()
        self._restart: asyncio.Task[None] | None = None
        self._closed = False
        self.starts = Signal()
        self._on_change: list[Callable[[Mapping[str, str | None], Sequence[Edit]], None]] = []

    @property
    def pid(self) -> int | None:
        """The process ID, None while no process runs."""
        return None if self._pool.process is None else self._pool.process.popen.pid

    @property
    def is_running(self) -> bool:
        """Whether the process accepts work."""
        return self._ready.is_set()

    @property
    def running(self) -> int:
        """Number of jobs in progress."""
        return self._pool.busy

    @property
    def waiting(self) -> int:
        """Number of jobs that wait for a worker."""
        return self._pool.waiting

    def on_change(self, listener: Callable[[Mapping[str, str | None], Sequence[Edit]], None]) -> None:
        """Call the listener with each change of the first dataset from now on."""
        self._on_change.append(listener)

    async def start(self) -> None:
        """Start the process. Raises OSError."""
        self._loop = asyncio.get_running_loop()
        spawned = await self._loop.run_in_executor(None, spawn)
        if self._closed:
            popen, connection, _ = spawned
            popen.kill()
            connection.close()
            return
        child = ChildProcess(spawned, self._loop, self._take, self._on_lost)
        self._pool.start(child, self._loop)
        self.generation += 1
        self.starts.emit()
        self._ready.set()

    async def close(self) -> None:
        """End the process and its workers. Idempotent."""
        self._closed = True
        if self._restart is not None:
            self._restart.cancel()
        self._ready.clear()
        child = self._pool.process
        if child is not None:
            child.close()
            child.popen.kill()
            await self._loop.run_in_executor(None, child.popen.wait)
        self._pool.stop()

    @property
    def _running(self) -> ChildProcess:
        """The process. Raises Problem 503 if none runs."""
        child = self._pool.process
        if child is None or not child.is_open:
            raise process_restarting(1)
        return child

    async def wait_ready(self, until: float) -> None:
        """Wait up to two seconds for the process to start. Raises Problem 503 after that."""
        if self._ready.is_set():
            return
        try:
            await asyncio.wait_for(self._ready.wait(), max(0.0, min(_PATIENCE, until - time.monotonic())))
        except asyncio.TimeoutError as error:
            raise process_restarting(1) from error

    # --- requests

    def change(self, graphs: Mapping[str, str | None], edits: Sequence[Edit] = (), dataset: int = 0) -> None:
        """Replace graphs, then make edits, as `MemoryStore.replace` does; later jobs see the change.

        A graph that cannot be stored is left out and logged. Raises Problem 503 if no process runs, and NotEnoughMemory
        if the additions do not fit into memory.
        """
        if not graphs and not edits:
            return
        process = self._running
        added = [*filter(None, graphs.values()), *(edit.added for edit in edits if edit.added)]
        characters = sum(map(len, added))
        needed = characters * DATASET_PER_CHARACTER + sum(text.count("\n") for text in added) * DATASET_PER_TRIPLE
        if needed:
            process.require_memory(needed, f"the dataset, for changes of {characters} characters,")
        data = pack(Change(dataset or self._first, dict(graphs), [*edits]))
        process.send_change(data, needed)
        self._pool.note(data)
        if dataset == 0:
            for listener in self._on_change:
                listener(graphs, edits)

    def new_dataset(self) -> int:
        """Return the number of a new, empty dataset."""
        return next(self._datasets)

    def drop(self, dataset: int) -> None:
        """Discard a dataset that `new_dataset` returned."""
        with contextlib.suppress(Problem):
            data = pack(Drop(dataset))
            self._running.send(data)
            self._pool.note(data)

    async def answer(
        self,
        work: Work,
        limits: Limits,
        until: float,
        disconnected: Disconnected | None = None,
        dataset: int = 0,
    ) -> bytes | AsyncIterator[bytes]:
        """Return what the work writes: a small result whole, a larger one as an iterator that may raise Aborted.

        `until` is the deadline (monotonic) that follows from `limits.seconds`. The work ends when the client hangs up.
        Raises what the work raises, and Problems: 503 if a limit is reached, the workers are busy or the process
        restarts, 500 if the work crashed its worker.
        """
        data = pack(Job(dataset or self._first, work, max(0.0, until - time.monotonic()), limits.memory))
        if len(data) > _LARGE:
            self._running.require_memory(len(data) * _PER_BYTE, f"a request of {len(data)} bytes")
        return await Evaluation(data, work, limits, until, self._pool.cancel).run(self._pool.begin, disconnected)

    async def result(self, work: Work, limits: Limits, until: float, disconnected: Disconnected | None = None) -> bytes:
        """Return everything that the work writes. Raises as `answer` does."""
        found = await self.answer(work, limits, until, disconnected)
        if isinstance(found, bytes):
            return found
        try:
            return b"".join([chunk async for chunk in found])
        except Aborted as error:
            raise error.__cause__ or Problem(503, str(error)) from None

    def result_for_thread(self, work: Work, seconds: float) -> bytes:
        """Return the same from another thread than the loop's. Raises TimeoutError."""
        coming = asyncio.run_coroutine_threadsafe(
            self.result(work, Limits(seconds), time.monotonic() + seconds), self._loop
        )
        return coming.result(seconds + 1)

    async def wait_drained(self) -> None:
        """Wait until the process has received most of what was sent, or has ended."""
        if self._pool.process is not None:
            await self._pool.process.wait_drained()

    # --- messages and restart

    def _take(self, message: object) -> None:
        match message:
            case Refused(graph, reason):
                _log.error("%s is omitted from the dataset: %s", graph, reason)
            case Ended():
                self._pool.take_ended(message)

    def _on_lost(self) -> None:
        self._ready.clear()
        child = self._pool.process
        self._pool.stop()
        if child is not None and not self._closed:
            self._restart = self._loop.create_task(self._start_again(child))

    async def _start_again(self, child: ChildProcess) -> None:
        status = await self._loop.run_in_executor(None, child.popen.wait)
        how = f"signal {-status}" if status < 0 else f"exit {status}"
        _log.error("the query process died (%s); restarting it", how)
        pause = 0.0 if time.monotonic() - child.started > _AT_ONCE else 0.1
        while not self._closed:
            await asyncio.sleep(pause)
            try:
                await self.start()
            except (OSError, MemoryError, RuntimeError) as error:  # no memory, no process, no thread
                _log.error("the query process cannot be restarted now: %s", error)
                pause = min(_LONGEST_PAUSE, max(0.5, 2 * pause))
            else:
                return
