"""Jobs and the workers that do them, as the server sees them: which is idle, which changes each has yet to be sent."""

from __future__ import annotations

import asyncio
import logging
import os
import pickle
import signal
import socket
import time
from collections import deque
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from functools import partial
from itertools import count

from rosld.server.http.problem import Problem
from rosld.server.sparql.disconnect import Disconnected
from rosld.server.sparql.process.connection import ChildProcess, Connection
from rosld.server.sparql.process.frames import Data, Done, Ended, ExitStatus, Fork, Kill, Raised, Ready, pack
from rosld.server.sparql.process.keeper import OUT_OF_MEMORY
from rosld.server.sparql.process.work import Work
from rosld.server.sparql.query_limits import (
    Limits,
    dataset_behind,
    out_of_memory,
    out_of_time,
    process_crashed,
    process_restarting,
    too_many_queries,
)

MAX_FIRST_BYTES = 1024 * 1024
"""Bytes gathered before the response begins: a shorter answer is sent whole or refused."""
_MAX_AHEAD = 2 * MAX_FIRST_BYTES
"""Maximum number of bytes received from a worker that the client has not read."""
_QUIET = 0.05
"""Seconds before watching for a disconnect of the client: most jobs have ended by then."""
_MAX_BEHIND = 200
"""Unsent changes above which a worker is replaced: making them takes longer than a fork (about 3 ms)."""
_MAX_BYTES_BEHIND = 512 * 1024
"""Bytes of unsent changes above which a worker is replaced."""
_MAX_CHANGES = 4000
"""Maximum number of changes in the life of a worker, whose store never frees removed triples."""
_TRIAL_SECONDS = 0.5
"""Seconds that a job may take in the extra worker, so that short jobs need not wait for long ones."""
_IDLE_SECONDS = 10.0
"""Seconds after which an idle worker ends, unless it is the only one."""


class Aborted(Exception):
    """A streamed result cannot be completed: the connection must break, or the result would look complete."""


class Evaluation:
    """Evaluation of a job: `data` is its frame, `cancel` is called if its result is no longer needed.

    `worker` is the worker that does it, if any; `is_tried` means that the extra worker has begun it before.
    """

    def __init__(
        self, data: bytes, work: Work, limits: Limits, until: float, cancel: Callable[[Evaluation], None]
    ) -> None:
        self.data = data
        self.work = work
        self.worker: _Worker | None = None
        self.is_tried = False
        self._limits = limits
        self._until = until
        self._cancel = cancel
        self._timer: asyncio.TimerHandle | None = None
        self._watch: asyncio.Future[None] | None = None
        self._received = bytearray()
        self._is_over = self._is_streaming = False
        self._error: Exception | None = None
        self._wake: asyncio.Future[None] | None = None

    async def run(
        self, begin: Callable[[Evaluation], None], disconnected: Disconnected | None
    ) -> bytes | AsyncIterator[bytes]:
        """Return the result. Raises Problems and what the work raises."""
        body: bytes | AsyncIterator[bytes] = b""
        self._look_after(min(_QUIET, self._seconds_left), disconnected)
        try:
            begin(self)
            await self._gather(MAX_FIRST_BYTES)
            if self._error is not None:
                raise self._error
            self._is_streaming = not self._is_over
            body = self._stream() if self._is_streaming else self._take()
            return body
        finally:
            if isinstance(body, bytes):
                self._close()

    async def _stream(self) -> AsyncIterator[bytes]:
        try:
            while True:
                await self._gather(1)
                if self._received:
                    yield self._take()
                elif self._error is not None:
                    raise Aborted(str(getattr(self._error, "detail", self._error))) from self._error
                else:
                    return
        finally:
            self._close()

    async def _gather(self, size: int) -> None:
        """Wait until `size` bytes have arrived, or the job is over."""
        while not self._is_over and len(self._received) < size:
            self._wake = asyncio.get_running_loop().create_future()
            await self._wake

    def _take(self) -> bytes:
        taken = bytes(self._received)
        self._received.clear()
        if self.worker is not None:
            self.worker.resume()
        return taken

    def _close(self) -> None:
        self._end_timer()
        if self._watch is not None:
            self._watch.cancel()
        if not self._is_over:
            self._is_over = True
            self._cancel(self)

    # --- events

    def add(self, data: bytes) -> None:
        """Add bytes of the result."""
        self._received += data
        if len(self._received) > _MAX_AHEAD and self.worker is not None:
            self.worker.pause()
        self._notify()

    def end(self, data: bytes) -> None:
        """Complete the result with its last bytes."""
        worker, self.worker = self.worker, None
        if worker is not None:
            worker.resume()
        self._is_over = True
        self._end_timer()
        self.add(data)

    def start_over(self) -> bool:
        """Discard the result to evaluate again; return False if a part was already passed on."""
        if self._is_streaming or len(self._received) >= MAX_FIRST_BYTES:
            return False
        self._received.clear()
        self.worker = None
        return True

    def fail(self, error: Exception) -> None:
        """End with an error instead of a (complete) result."""
        if not self._is_over:
            self._error = error
            self.end(b"")

    def fail_ended(self, ended: ExitStatus | bytes) -> None:
        """Fail because the worker ended, or could not be forked."""
        if isinstance(ended, bytes):
            self.fail(pickle.loads(ended))  # from our own process
        else:
            self.fail(_exit_problem(ended, self._limits))

    def _notify(self) -> None:
        wake, self._wake = self._wake, None
        if wake is not None and not wake.done():
            wake.set_result(None)

    @property
    def _seconds_left(self) -> float:
        return max(0.0, self._until - time.monotonic())

    def _look_after(self, seconds: float, disconnected: Disconnected | None) -> None:
        self._timer = asyncio.get_running_loop().call_later(seconds, self._check_deadline, disconnected)

    def _end_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()

    def _check_deadline(self, disconnected: Disconnected | None) -> None:
        """Start watching the client; end the job at its deadline."""
        if not self._seconds_left:
            self._give_up(self._timeout_problem())
            return
        self._look_after(self._seconds_left, disconnected)
        if disconnected is not None and self._watch is None:
            self._watch = asyncio.ensure_future(disconnected())
            self._watch.add_done_callback(self._on_disconnect)

    def _timeout_problem(self) -> Problem:
        if self.worker is not None and self.worker.is_ready:
            return out_of_time(self._limits.seconds)
        return too_many_queries() if self.worker is None or self.is_tried else dataset_behind()

    def _on_disconnect(self, watch: asyncio.Future[None]) -> None:
        """Give up if the client has disconnected, rather than the watch having been cancelled."""
        if not watch.cancelled() and watch.exception() is None:
            self._give_up(Problem(503, "The client disconnected."))

    def _give_up(self, problem: Problem) -> None:
        if not self._is_over:
            self._cancel(self)
            self.fail(problem)


def _exit_problem(ended: ExitStatus, limits: Limits) -> Problem:
    """Return the problem of a job whose worker ended unexpectedly."""
    status, words = ended
    if "memory allocation of" in words or (os.WIFEXITED(status) and os.WEXITSTATUS(status) == OUT_OF_MEMORY):
        return out_of_memory(limits.memory)
    if not os.WIFSIGNALED(status):
        return process_crashed(f"exit {os.WEXITSTATUS(status)}")
    number = os.WTERMSIG(status)
    return out_of_time(limits.seconds) if number == signal.SIGALRM else process_crashed(f"signal {number}")


_log = logging.getLogger("rosld.sparql")


class _Worker(Connection):
    """The connection to a worker: `unsent` are the changes to send before its next job, `job` is the current one.

    `is_ready` once it exists; until then the query process carries out the changes sent before the order to fork.
    """

    def __init__(
        self,
        number: int,
        connection: socket.socket,
        loop: asyncio.AbstractEventLoop,
        on_message: Callable[[_Worker, object], None],
        on_lost: Callable[[_Worker], None],
    ) -> None:
        super().__init__(connection, loop, partial(on_message, self), partial(on_lost, self))
        self.number = number
        self.job: Evaluation | None = None
        self.unsent: list[bytes] = []
        self.is_outdated = False
        self.is_ready = False
        self.ended: ExitStatus | bytes | None = None
        self.turns = 0
        self._behind = 0
        self._changes = 0

    def note(self, change: bytes) -> None:
        """Queue a change for the worker, to be made before its next job."""
        self._changes += 1
        self._behind += len(change)
        self.unsent.append(change)
        if len(self.unsent) > _MAX_BEHIND or self._behind > _MAX_BYTES_BEHIND or self._changes > _MAX_CHANGES:
            self.is_outdated = True
            self.unsent.clear()

    def begin(self, job: Evaluation) -> None:
        """Send the changes and the job."""
        self.job, job.worker = job, self
        for data in (*self.unsent, job.data):
            self.send(data)
        self.unsent.clear()
        self._behind = 0
        self.turns += 1
        self.flush()


class WorkerPool:
    """Workers of a query process: at most `concurrency` are busy, and at most `waiting` jobs wait.

    While all are busy, one extra worker tries each new job: one that takes longer waits and starts again in its turn.
    """

    def __init__(self, concurrency: int, waiting: int) -> None:
        self._concurrency = concurrency
        self._max_waiting = waiting
        self._numbers = count(1)
        self.process: ChildProcess | None = None
        self._workers: dict[int, _Worker] = {}
        self._idle: list[_Worker] = []
        """Workers without a job; the last one used is used next."""
        self._queue: deque[Evaluation] = deque()

    def start(self, process: ChildProcess, loop: asyncio.AbstractEventLoop) -> None:
        """Use a new query process, and fork its first worker."""
        self.process, self._loop = process, loop
        with suppress(OSError):
            self._idle.append(self._fork(process))

    def stop(self) -> None:
        """Fail all jobs, because the query process and its workers are gone."""
        self.process = None
        workers, jobs = [*self._workers.values()], [*self._queue]
        for each in (self._workers, self._idle, self._queue):
            each.clear()
        for worker in workers:
            worker.close()
            if worker.job is not None:
                jobs.append(worker.job)
        for job in jobs:
            job.fail(process_restarting(1))

    def note(self, change: bytes) -> None:
        """Queue a change of a dataset for all workers."""
        for worker in [*self._workers.values()]:
            worker.note(change)
            if worker.is_outdated and worker.job is None:
                self._drop(worker)

    def begin(self, job: Evaluation) -> None:
        """Begin or queue a job. Raises Problem 503 if too many wait or no query process runs."""
        if self.process is None:
            raise process_restarting(1)
        self._queue.append(job)
        self._serve()
        if len(self._queue) > self._max_waiting and job in self._queue:
            self._queue.remove(job)
            raise too_many_queries()

    def cancel(self, job: Evaluation) -> None:
        """End a job whose result is no longer needed."""
        if job in self._queue:
            self._queue.remove(job)
            return
        for worker in [*self._workers.values()]:
            if worker.job is job:
                self._kill(worker)
                self._serve()

    def take_ended(self, ended: Ended) -> None:
        """Note how a worker has ended."""
        worker = self._workers.get(ended.number)
        if worker is not None:
            worker.ended = ended.why
            self._settle(worker)

    @property
    def busy(self) -> int:
        """Number of jobs in progress."""
        return len(self._workers) - len(self._idle)

    @property
    def waiting(self) -> int:
        """Number of jobs that wait for a worker."""
        return len(self._queue)

    def _serve(self) -> None:
        while self.process is not None and (job := self._next_job()) is not None:
            self._queue.remove(job)
            try:
                worker = self._idle.pop() if self._idle else self._fork(self.process)
            except OSError as error:  # there are no more descriptors
                job.fail(error)
                continue
            worker.begin(job)
            if self.busy > self._concurrency:
                job.is_tried = True
                self._loop.call_later(_TRIAL_SECONDS, self._end_trial, worker, worker.turns)

    def _next_job(self) -> Evaluation | None:
        """Return the job that may begin now, if any."""
        if self.busy < self._concurrency:
            return next(iter(self._queue), None)
        if self.busy > self._concurrency:
            return None
        return next((job for job in self._queue if not job.is_tried), None)

    def _end_trial(self, worker: _Worker, turns: int) -> None:
        job = worker.job
        if job is None or worker.turns != turns or self.busy <= self._concurrency or not job.start_over():
            return
        self._kill(worker)
        if len(self._queue) < self._max_waiting:
            self._queue.appendleft(job)
        else:
            job.fail(too_many_queries())
        self._serve()

    def _kill(self, worker: _Worker) -> None:
        worker.job = None
        if self.process is not None:
            self.process.send(pack(Kill(worker.number)))
        self._drop(worker)

    def _fork(self, process: ChildProcess) -> _Worker:
        ours, theirs = socket.socketpair()
        worker = _Worker(next(self._numbers), ours, self._loop, self._take, self._settle)
        self._workers[worker.number] = worker
        process.send(pack(Fork(worker.number)), theirs.detach())
        process.flush()
        return worker

    def _drop(self, worker: _Worker) -> None:
        """Forget a worker; an idle one ends when its connection closes."""
        worker.close()
        self._workers.pop(worker.number, None)
        if worker in self._idle:
            self._idle.remove(worker)

    # --- messages of workers

    def _take(self, worker: _Worker, message: object) -> None:
        job = worker.job
        match message:
            case Ready():
                worker.is_ready = True
            case Data(data) if job is not None:
                job.add(data)
            case Done(data, is_last) if job is not None:
                job.end(data)
                self._release(worker, is_last)
            case Raised(error, is_last) if job is not None:
                job.fail_ended(error)
                self._release(worker, is_last)

    def _release(self, worker: _Worker, is_last: bool) -> None:
        """Return a worker to the pool after its job."""
        worker.job = None
        if is_last or worker.is_outdated:
            self._drop(worker)
        else:
            self._idle.append(worker)
            if len(self._workers) > 1:
                self._loop.call_later(_IDLE_SECONDS, self._end_surplus, worker, worker.turns)
        self._serve()

    def _end_surplus(self, worker: _Worker, turns: int) -> None:
        if worker in self._idle and worker.turns == turns and len(self._workers) > 1:
            self._drop(worker)

    def _settle(self, worker: _Worker) -> None:
        """Fail the job of an ended worker, once all its output was received and its exit status is known."""
        if worker.number not in self._workers or worker.is_open:
            return
        if worker.ended is None and worker.job is not None:
            return
        self._drop(worker)
        job, worker.job = worker.job, None
        if job is not None and worker.ended is not None:
            _log_end(job, worker.ended)
            job.fail_ended(worker.ended)
        self._serve()


def _log_end(job: Evaluation, ended: ExitStatus | bytes) -> None:
    if isinstance(ended, ExitStatus) and os.WIFSIGNALED(ended.status):
        text = repr(job.work)
        text = text if len(text) <= 2000 else text[:2000] + "..."
        _log.error("a query worker was killed by signal %d while doing %s", os.WTERMSIG(ended.status), text)
