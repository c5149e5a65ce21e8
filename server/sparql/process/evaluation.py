"""One job of a query worker: waited for within its time, and its bytes passed on as they come."""

from __future__ import annotations

import asyncio
import os
import pickle
import signal
import time
from collections.abc import AsyncIterator, Callable
from typing import Protocol

from rosld.server.http.problem import Problem
from rosld.server.sparql.disconnect import Disconnected
from rosld.server.sparql.process.frames import ExitStatus
from rosld.server.sparql.process.work import Work
from rosld.server.sparql.process.worker import OUT_OF_MEMORY
from rosld.server.sparql.query_limits import (
    Limits,
    dataset_behind,
    out_of_memory,
    out_of_time,
    process_crashed,
    too_many_queries,
)

MAX_FIRST_BYTES = 1024 * 1024
"""Bytes that are gathered before the first is sent: up to these, an answer is sent whole or refused."""
_MAX_AHEAD = 2 * MAX_FIRST_BYTES
"""Bytes that a worker may be ahead of the client."""
_QUIET = 0.05
"""Seconds after which the client of a job is watched: most answers are there by then."""


class Aborted(Exception):
    """Results that had begun to be sent cannot be completed; the connection must break, or they would look whole."""


class JobWorker(Protocol):
    """The worker that does a job."""

    is_ready: bool
    """Whether it exists: until then the changes are made that were sent before it was asked for."""

    def pause(self) -> None:
        """Receive nothing until `resume`."""
        ...

    def resume(self) -> None:
        """Receive again."""
        ...


class Evaluation:
    """A job: `data` is its frame, `work` what it is to do. `cancel` is called if it is not wanted any more.

    `worker` is there while one does it. `is_tried`: it was begun beyond the limit of workers.
    """

    def __init__(
        self, data: bytes, work: Work, limits: Limits, until: float, cancel: Callable[[Evaluation], None]
    ) -> None:
        self.data = data
        self.work = work
        self.worker: JobWorker | None = None
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
        """Return the result. Raises Problems, and as the work does."""
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
        """Wait until so many bytes have come, or the job is over."""
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

    # --- what happens to it

    def add(self, data: bytes) -> None:
        """Add bytes of the result."""
        self._received += data
        if len(self._received) > _MAX_AHEAD and self.worker is not None:
            self.worker.pause()
        self._notify()

    def end(self, data: bytes) -> None:
        """Complete the result by its last bytes."""
        worker, self.worker = self.worker, None
        if worker is not None:
            worker.resume()
        self._is_over = True
        self._end_timer()
        self.add(data)

    def start_over(self) -> bool:
        """Forget what has come, to be done again; whether that can be, as none of it was passed on."""
        if self._is_streaming or len(self._received) >= MAX_FIRST_BYTES:
            return False
        self._received.clear()
        self.worker = None
        return True

    def fail(self, error: Exception) -> None:
        """End without a result, or break it off."""
        if not self._is_over:
            self._error = error
            self.end(b"")

    def fail_ended(self, ended: ExitStatus | bytes) -> None:
        """Fail because the worker ended, or could not be forked."""
        if isinstance(ended, bytes):
            self.fail(pickle.loads(ended))  # from our own process
        else:
            self.fail(_why_ended(ended, self._limits))

    def _notify(self) -> None:
        wake, self._wake = self._wake, None
        if wake is not None and not wake.done():
            wake.set_result(None)

    @property
    def _seconds_left(self) -> float:
        return max(0.0, self._until - time.monotonic())

    def _look_after(self, seconds: float, disconnected: Disconnected | None) -> None:
        self._timer = asyncio.get_running_loop().call_later(seconds, self._look, disconnected)

    def _end_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()

    def _look(self, disconnected: Disconnected | None) -> None:
        """Watch the client, and end when the time is over."""
        if not self._seconds_left:
            self._give_up(self._why_late())
            return
        self._look_after(self._seconds_left, disconnected)
        if disconnected is not None and self._watch is None:
            self._watch = asyncio.ensure_future(disconnected())
            self._watch.add_done_callback(self._on_disconnect)

    def _why_late(self) -> Problem:
        if self.worker is not None and self.worker.is_ready:
            return out_of_time(self._limits.seconds)
        return too_many_queries() if self.worker is None or self.is_tried else dataset_behind()

    def _on_disconnect(self, watch: asyncio.Future[None]) -> None:
        """The client has hung up, unless the watch was ended."""
        if not watch.cancelled() and watch.exception() is None:
            self._give_up(Problem(503, "The client has hung up."))

    def _give_up(self, problem: Problem) -> None:
        if not self._is_over:
            self._cancel(self)
            self.fail(problem)


def _why_ended(ended: ExitStatus, limits: Limits) -> Problem:
    """Why a worker ended that did not say so."""
    status, words = ended
    if "memory allocation of" in words or (os.WIFEXITED(status) and os.WEXITSTATUS(status) == OUT_OF_MEMORY):
        return out_of_memory(limits.memory)
    if not os.WIFSIGNALED(status):
        return process_crashed(f"exit {os.WEXITSTATUS(status)}")
    number = os.WTERMSIG(status)
    return out_of_time(limits.seconds) if number == signal.SIGALRM else process_crashed(f"signal {number}")
