"""One piece of work for the query process: sent, waited for within its time, its bytes passed on as they come."""

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
from rosld.server.sparql.process.fork import FRAME_HEADER as FRAME
from rosld.server.sparql.process.fork import OUT_OF_MEMORY, ExitStatus, FrameKind
from rosld.server.sparql.process.work import Work
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
_CHUNK = 256 * 1024


class Aborted(Exception):
    """Results that had begun to be sent cannot be completed; the connection must break, or they would look whole."""


class PendingJob:
    """A job under way. `first` comes to the result where it is made in the process, else to a fork's pipe."""

    __slots__ = ("ended", "first", "is_over", "on_wait", "work")

    def __init__(self, loop: asyncio.AbstractEventLoop, work: Work, on_wait: Callable[[], None]) -> None:
        self.first: asyncio.Future[bytes | int] = loop.create_future()
        self.ended: asyncio.Future[ExitStatus] | None = None
        self.is_over = False
        self.on_wait = on_wait
        self.work = work


class JobRunner(Protocol):
    """What does the work: the query process."""

    def begin(self, work: Work, limits: Limits, dataset: int, on_wait: Callable[[], None]) -> tuple[int, PendingJob]:
        """Have work begun. Raises Problem 503 where there is no process, or no memory for it."""
        ...

    @property
    def is_behind(self) -> bool:
        """Whether changes are still to be made before what was begun last is looked at."""
        ...

    def cancel(self, number: int) -> None:
        """End a job that is not wanted any more."""
        ...

    def forget(self, number: int) -> None:
        """Expect nothing more of a job."""
        ...


def crash_reason(status: int) -> Problem:
    return process_crashed(f"signal {-status}" if status < 0 else f"exit {status}")


def _why_ended(ended: ExitStatus, limits: Limits) -> Problem:
    """Why a fork ended that did not say so."""
    status, words = ended
    if "memory allocation of" in words or (os.WIFEXITED(status) and os.WEXITSTATUS(status) == OUT_OF_MEMORY):
        return out_of_memory(limits.memory)
    if not os.WIFSIGNALED(status):
        return process_crashed(f"exit {os.WEXITSTATUS(status)}")
    number = os.WTERMSIG(status)
    return out_of_time(limits.seconds) if number == signal.SIGALRM else process_crashed(f"signal {number}")


class Evaluation:
    """One piece of work: sent, waited for within its time, and its bytes passed on as they come."""

    def __init__(
        self, process: JobRunner, work: Work, limits: Limits, until: float, disconnected: Disconnected | None
    ) -> None:
        self._process = process
        self._work = work
        self._limits = limits
        self._until = until
        self._hung_up = disconnected
        self._watch: asyncio.Future[None] | None = None
        self._number = 0
        self._transport: asyncio.ReadTransport | None = None

    async def run(self, dataset: int) -> bytes | AsyncIterator[bytes]:
        """The result. Raises Problems, and as the work does."""
        loop = asyncio.get_running_loop()
        seconds = max(0.0, self._until - time.monotonic())
        limits = self._limits._replace(seconds=seconds)
        self._number, self._pending = self._process.begin(self._work, limits, dataset, self._watch_client)
        timer = loop.call_later(seconds, self._give_up)
        body: bytes | AsyncIterator[bytes] | None = None
        try:
            first = await self._pending.first
            body = first if isinstance(first, bytes) else await self._from_fork(first)
            return body
        finally:
            timer.cancel()
            if body is None or isinstance(body, bytes):
                self._end()

    def _give_up(self) -> None:
        """The time is over."""
        first = self._pending.first
        if not first.done():
            first.set_exception(self._why_late())
            self._process.cancel(self._number)

    def _why_late(self) -> Problem:
        """Why the work has not even begun, or has taken too long."""
        if self._watch is not None:
            return too_many_queries()
        return dataset_behind() if self._process.is_behind else out_of_time(self._limits.seconds)

    def _watch_client(self) -> None:
        """It takes a while: see whether the client hangs up."""
        if self._hung_up is not None and self._watch is None:
            self._watch = asyncio.ensure_future(self._hung_up())
            self._watch.add_done_callback(self._on_disconnect)

    def _on_disconnect(self, watch: asyncio.Future[None]) -> None:
        """The client has hung up, unless the watch was ended."""
        if watch.cancelled() or watch.exception() is not None:
            return
        self._process.cancel(self._number)
        if not self._pending.first.done():
            self._pending.first.set_exception(_client_gone())
        elif self._transport is not None:
            self._reader.set_exception(_client_gone())

    def _end(self) -> None:
        if self._watch is not None:
            self._watch.cancel()
        if self._transport is not None:
            self._transport.close()
        self._process.cancel(self._number)
        self._process.forget(self._number)

    # --- a fork's result

    async def _from_fork(self, descriptor: int) -> bytes | AsyncIterator[bytes]:
        self._watch_client()
        self._reader = asyncio.StreamReader(_CHUNK)
        protocol = asyncio.StreamReaderProtocol(self._reader)
        pipe = os.fdopen(descriptor, "rb", 0)
        self._transport, _ = await asyncio.get_running_loop().connect_read_pipe(lambda: protocol, pipe)
        head: list[bytes] = []
        size = 0
        while size < MAX_FIRST_BYTES:
            data = await self._next()
            if data is None:
                return b"".join(head)
            head.append(data)
            size += len(data)
        return self._stream(b"".join(head))

    async def _stream(self, head: bytes) -> AsyncIterator[bytes]:
        try:
            yield head
            while (data := await self._next_or_abort()) is not None:
                yield data
        finally:
            self._end()

    async def _next_or_abort(self) -> bytes | None:
        try:
            return await self._next()
        except Problem as problem:
            raise Aborted(problem.detail) from problem
        except Exception as error:
            raise Aborted(str(error)) from error

    async def _next(self) -> bytes | None:
        """The next bytes; None at the end. Raises what the work raised, and why it ended early."""
        try:
            return await asyncio.wait_for(self._piece(), max(0.0, self._until - time.monotonic()))
        except asyncio.TimeoutError as error:
            raise out_of_time(self._limits.seconds) from error

    async def _piece(self) -> bytes | None:
        try:
            kind, size = FRAME.unpack(await self._reader.readexactly(FRAME.size))
            data = await self._reader.readexactly(size)
        except asyncio.IncompleteReadError:
            assert self._pending.ended is not None
            raise _why_ended(await self._pending.ended, self._limits) from None
        if kind == FrameKind.DATA.value:
            return data
        if kind == FrameKind.RAISED.value:
            error: Exception = pickle.loads(data)  # from our own process
            raise error
        return None


def _client_gone() -> Problem:
    return Problem(503, "The client has hung up.")
