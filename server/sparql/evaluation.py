"""One evaluation: a job for a worker, whose bytes come back to the loop in chunks and within a time limit."""

from __future__ import annotations

import asyncio
import io
import threading
import time
from collections.abc import AsyncIterator, Callable
from typing import BinaryIO, NamedTuple, cast

from rosld.server.http.problem import Problem
from rosld.server.sparql.results import Check
from rosld.server.sparql.workers import Workers, busy, call_soon
from rosld.server.store import QueryError

CHUNK = 64 * 1024
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


class Evaluation(io.RawIOBase):
    """Runs `job(output, check)` in a worker, being the output itself. Belongs to one loop; `write` to the worker."""

    def __init__(self, job: Callable[[BinaryIO, Check], None], limit: float) -> None:
        super().__init__()
        self._job = job
        self._limit = limit
        self._until = time.monotonic() + limit
        self._loop = asyncio.get_running_loop()
        self._head: asyncio.Future[_Head] = self._loop.create_future()
        self._chunks: asyncio.Queue[bytes | Exception | None] = asyncio.Queue()
        self._credit = threading.Semaphore(_AHEAD)
        self._stopped = False
        self._begun = False
        self._buffer: list[bytes] = []
        self._size = 0
        self._sent = False

    # --- on the loop

    async def run(self, workers: Workers) -> bytes | AsyncIterator[bytes]:
        """All bytes where they are few, else an iterator over chunks, which raises Aborted when it cannot go on.

        Raises Problems: 503 where no worker is free or the time is over before the first byte, 400 in the store's
        words.
        """
        workers.submit(self._work)
        timer = self._loop.call_later(self._limit, self._give_up)
        try:
            head = await self._head
        except BaseException:
            self._stopped = True  # a job that has not begun will not
            raise
        finally:
            timer.cancel()
        return head.chunk if head.complete else self._stream(head.chunk)

    async def _stream(self, chunk: bytes) -> AsyncIterator[bytes]:
        try:
            yield chunk
            while (found := await self._next()) is not None:
                yield found
        finally:
            self._stopped = True
            self._credit.release()

    async def _next(self) -> bytes | None:
        remaining = self._until - time.monotonic()
        try:
            found = await asyncio.wait_for(self._chunks.get(), max(0.0, remaining))
        except asyncio.TimeoutError as error:
            raise Aborted(self._words()) from error
        if isinstance(found, Exception):
            raise Aborted(str(found)) from found
        self._credit.release()
        return found

    def _give_up(self) -> None:
        if not self._head.done():
            self._head.set_exception(Problem(503, self._words()) if self._begun else busy())

    def _words(self) -> str:
        return f"The query took longer than {self._limit:g} s, which is this server's limit: ask for less at a time."

    # --- in the worker

    def _work(self) -> None:
        self._begun = True
        try:
            self._check()
            self._job(cast("BinaryIO", self), self._check)
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
        if self._size >= CHUNK:
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
            error = Problem(503, self._words())
        elif isinstance(error, QueryError):
            error = refused(error)
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
