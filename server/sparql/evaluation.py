"""One evaluation: a job for a worker, whose bytes come back to the loop in chunks and within a time limit."""

from __future__ import annotations

import asyncio
import io
import threading
import time
from collections.abc import AsyncIterator
from typing import BinaryIO, NamedTuple, Protocol, cast

from rosld.server.errors import problem_of_shortage
from rosld.server.http.problem import Problem
from rosld.server.memory import is_shortage
from rosld.server.sparql.child import Leash
from rosld.server.sparql.hangup import HangUp
from rosld.server.sparql.limits import Limits, busy, out_of_time
from rosld.server.sparql.results import Check
from rosld.server.sparql.workers import Workers, call_soon
from rosld.server.store import QueryError

HEAD = 1024 * 1024
"""Bytes that are gathered before the first is sent: up to these, an answer is sent whole or refused."""
CHUNK = 256 * 1024
_AHEAD = 4
"""Chunks that a worker may be ahead of a slow reader."""


class Stopped(Exception):
    """A worker's writing was stopped: the time is over, or nobody reads any more."""


class Aborted(Exception):
    """Results that had begun to be sent cannot be completed; the connection must break, or they would look whole."""


def refused(error: QueryError) -> Problem:
    """The store's parser does not take the query: its words, for the client."""
    return Problem(400, f"The query cannot be answered: {error}.")


class _Head(NamedTuple):
    """The first bytes of an answer, which may be all."""

    chunk: bytes
    complete: bool


class Job(Protocol):
    """Writes an answer to `output`, in a worker; `check` raises once it is of no use, `leash` is to end a child."""

    def __call__(self, output: BinaryIO, check: Check, leash: Leash) -> None:
        """Raises QueryError and Problems, and what `check` and `output` raise."""
        ...


class Evaluation(io.RawIOBase):
    """Runs a job in a worker, being the output itself. Belongs to one loop; `write` to the worker.

    `until` is when the time is over (monotonic), `limits.seconds` is what this comes from.
    """

    def __init__(self, job: Job, limits: Limits, until: float) -> None:
        super().__init__()
        self._job = job
        self._limits = limits
        self._until = until
        self._loop = asyncio.get_running_loop()
        self._head: asyncio.Future[_Head] = self._loop.create_future()
        self._chunks: asyncio.Queue[bytes | Exception | None] = asyncio.Queue()
        self._credit = threading.Semaphore(_AHEAD)
        self._leash = Leash()
        self._watch: asyncio.Future[None] | None = None
        self._stopped = False
        self._buffer: list[bytes] = []
        self._size = 0
        self._sent = False

    # --- on the loop

    async def run(self, workers: Workers, hung_up: HangUp | None = None) -> bytes | AsyncIterator[bytes]:
        """All bytes where they are few, else an iterator over chunks, which raises Aborted when it cannot go on.

        Raises Problems: 503 where no worker is free or a limit is reached before the first byte, 400 in the store's
        words. Whoever hung up has it ended at once.
        """
        workers.submit(self._work)
        timer = self._loop.call_later(max(0.0, self._until - time.monotonic()), self._give_up, workers)
        if hung_up is not None:
            self._watch = asyncio.ensure_future(hung_up())
            self._watch.add_done_callback(self._left)
        head: _Head | None = None
        try:
            head = await self._head
        finally:
            timer.cancel()
            if head is None or head.complete:
                self._unwatch()
            if head is None:
                workers.withdraw(self._work)
                self._stop()
        return head.chunk if head.complete else self._stream(head.chunk)

    async def _stream(self, chunk: bytes) -> AsyncIterator[bytes]:
        try:
            yield chunk
            while (found := await self._next()) is not None:
                yield found
        finally:
            self._unwatch()
            self._stop()

    async def _next(self) -> bytes | None:
        remaining = self._until - time.monotonic()
        try:
            found = await asyncio.wait_for(self._chunks.get(), max(0.0, remaining))
        except asyncio.TimeoutError as error:
            raise Aborted(out_of_time(self._limits.seconds).detail) from error
        if isinstance(found, Exception):
            raise Aborted(found.detail if isinstance(found, Problem) else str(found)) from found
        self._credit.release()
        return found

    def _stop(self) -> None:
        """Nobody wants any more of it."""
        self._stopped = True
        self._leash.pull()
        self._credit.release()

    def _left(self, watch: asyncio.Future[None]) -> None:
        """The client has hung up, unless the watch was ended."""
        if watch.cancelled() or watch.exception() is not None:
            return
        self._stop()
        gone = Problem(503, "The client has hung up.")
        self._fail_head(gone)
        self._chunks.put_nowait(gone)

    def _unwatch(self) -> None:
        if self._watch is not None:
            self._watch.cancel()

    def _give_up(self, workers: Workers) -> None:
        waited = workers.withdraw(self._work) and workers.occupied
        self._fail_head(busy() if waited else out_of_time(self._limits.seconds))

    # --- in the worker

    def _work(self) -> None:
        try:
            self._check()
            self._job(cast("BinaryIO", self), self._check, self._leash)
        except Exception as error:  # told to whoever waits
            self._tell(error)
        else:
            self._end()

    def _check(self) -> None:
        if self._stopped or time.monotonic() > self._until:
            raise Stopped

    def writable(self) -> bool:
        return True

    def write(self, data: bytes) -> int:  # type: ignore[override]
        """Take bytes from the store's writer; raising from here is the one way to stop it."""
        self._check()
        self._buffer.append(bytes(data))
        self._size += len(data)
        if self._size >= (CHUNK if self._sent else HEAD):
            self._send()
        return len(data)

    def _taken(self) -> bytes:
        chunk = b"".join(self._buffer)
        self._buffer.clear()
        self._size = 0
        return chunk

    def _send(self) -> None:
        chunk = self._taken()
        if not self._sent:
            self._sent = True
            call_soon(self._loop, self._set_head, _Head(chunk, False))
            return
        if not self._credit.acquire(timeout=max(0.0, self._until - time.monotonic())):
            raise Stopped
        self._check()
        call_soon(self._loop, self._chunks.put_nowait, chunk)

    def _end(self) -> None:
        chunk = self._taken()
        if not self._sent:
            call_soon(self._loop, self._set_head, _Head(chunk, True))
            return
        call_soon(self._loop, self._chunks.put_nowait, chunk)
        call_soon(self._loop, self._chunks.put_nowait, None)

    def _tell(self, error: Exception) -> None:
        if self._stopped or time.monotonic() > self._until:
            error = out_of_time(self._limits.seconds)
        elif isinstance(error, QueryError):
            error = refused(error)
        elif is_shortage(error):
            error = problem_of_shortage(error, is_write=False)
        elif not isinstance(error, Problem):
            error = Problem(500, f"The query failed: {error}.")
        # What an error remembers of its way holds the store's results, which must end in the thread they began in.
        error = error.with_traceback(None)
        error.__cause__ = error.__context__ = None
        if self._sent:
            call_soon(self._loop, self._chunks.put_nowait, error)
        else:
            call_soon(self._loop, self._fail_head, error)

    def _set_head(self, head: _Head) -> None:
        if not self._head.done():
            self._head.set_result(head)

    def _fail_head(self, error: Exception) -> None:
        if not self._head.done():
            self._head.set_exception(error)
