"""A few worker processes, started when there is work for them and ended when there has been none for a while."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import pickle
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from typing import TypeAlias, TypeVar, cast

from rosld.server.http.problem import Problem
from rosld.server.runtime.offload.worker import LENGTH, ORDER, Outcome

_T = TypeVar("_T")
_log = logging.getLogger("rosld")

Work: TypeAlias = Callable[[], _T]
"""What a worker does: a `functools.partial` of a function of a module, whose arguments can be pickled."""

MAX_WORKERS = max(1, min(2, (os.cpu_count() or 2) - 1))
"""Workers at a time: a processor is left for the server."""
WORK_SECONDS = 120.0
"""The longest that one piece of work may take."""
WORKER_BYTES = 6 * 1024 * 1024 * 1024
"""Bytes of address space that a worker may have."""
IDLE_SECONDS = 30.0
"""How long a worker without work is kept."""
MAX_QUEUED = 32
"""The most pieces of work that wait."""
_BUFFER = 1024 * 1024
_AT_ONCE_SECONDS = 0.5
"""A worker that ends within these did not end by its work."""
_START = "import sys; sys.path[:] = sys.argv[1:-1]; from rosld.server.runtime.offload.worker import main; main()"
"""What a worker runs: with the same modules as the server, wherever that found them."""


class WorkerPool:
    """Does work in other processes. Belongs to one loop."""

    def __init__(
        self,
        limit: int = MAX_WORKERS,
        seconds: float = WORK_SECONDS,
        memory: int = WORKER_BYTES,
        subject: str = "document",
    ) -> None:
        """`subject` is the word for what is worked on."""
        self._seconds = seconds
        self._memory = memory
        self._subject = subject
        self._free = asyncio.Semaphore(limit)
        self._waiting = 0
        self._idle: list[_Worker] = []
        self._busy: set[_Worker] = set()

    async def run(self, work: Work[_T], seconds: float | None = None) -> _T:
        """Do work in a worker: what it returns, or what it raises of OSError, ValueError, LookupError and of rosld.

        The worker is killed after `seconds` (None: those of the pool). Raises Problems: 503 where too much waits or a
        worker ended early, 507 where its memory did not suffice.
        """
        data = _pickle(work)
        if data is None:  # such as rights that depend on types, which only this process knows
            return await asyncio.to_thread(work)
        if self._waiting >= MAX_QUEUED:
            words = f"Too many large {self._subject}s are being worked on: try again."
            raise Problem(503, words, headers={"Retry-After": "5"})
        self._waiting += 1
        try:
            await self._free.acquire()
        finally:
            self._waiting -= 1
        try:
            return cast("_T", await self._run(data, self._seconds if seconds is None else seconds))
        finally:
            self._free.release()

    async def _run(self, data: bytes, seconds: float) -> object:
        for is_new in (False, True):
            worker = await self._worker(anew=is_new)
            self._busy.add(worker)
            begun = time.monotonic()
            try:
                outcome, value = await asyncio.wait_for(worker.done(data, seconds), seconds + 1)
            except (asyncio.TimeoutError, OSError, EOFError) as error:
                worker.end()
                if worker.has_worked and not is_new and time.monotonic() - begun < _AT_ONCE_SECONDS:
                    continue  # it had ended since its last work: another one does it
                raise self._too_much(seconds) from error
            except BaseException:
                worker.end()
                raise
            finally:
                self._busy.discard(worker)
            worker.has_worked = True
            self._keep(worker)
            return self._result(outcome, value)
        raise AssertionError

    def _result(self, outcome: Outcome, value: object) -> object:
        if outcome is Outcome.VALUE:
            return value
        if isinstance(value, MemoryError):
            words = f"This {self._subject} needs more memory than there is for one: split it into several."
            raise Problem(507, words) from value
        if isinstance(value, Exception):
            raise value
        _log.error("a worker process failed:\n%s", value)
        raise RuntimeError("a worker process failed")

    def _too_much(self, seconds: float) -> Problem:
        words = f"This {self._subject} takes more than {seconds:g} s to be worked on, or more memory than there is"
        return Problem(503, f"{words}: split it into several.", headers={"Retry-After": "60"})

    async def _worker(self, *, anew: bool) -> _Worker:
        while self._idle and not anew:
            worker = self._idle.pop()
            if worker.is_alive:
                return worker
            worker.end()
        try:
            process, connection = await asyncio.get_running_loop().run_in_executor(None, _start, self)
        except OSError as error:
            raise Problem(503, f"No process can be started for a large {self._subject}: {error.strerror}.") from error
        reader, writer = await asyncio.open_unix_connection(sock=connection, limit=_BUFFER)
        return _Worker(process, reader, writer)

    def _keep(self, worker: _Worker) -> None:
        self._idle.append(worker)
        asyncio.get_running_loop().call_later(IDLE_SECONDS, self._end_idle, worker, worker.pieces)

    def _end_idle(self, worker: _Worker, pieces: int) -> None:
        if worker in self._idle and worker.pieces == pieces:
            self._idle.remove(worker)
            worker.end()

    @property
    def command(self) -> list[str]:
        """What starts a worker."""
        return [sys.executable, "-c", _START, *sys.path, str(self._memory)]

    async def close(self) -> None:
        """End all workers, also those at work. Idempotent."""
        for worker in (*self._idle, *self._busy):
            worker.end()
        self._idle.clear()


class _Worker:
    """One worker process, and the socket to it."""

    def __init__(
        self, process: subprocess.Popen[bytes], reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        self._process = process
        self._reader = reader
        self._writer = writer
        self.pieces = 0
        self.has_worked = False

    @property
    def is_alive(self) -> bool:
        """Whether it may take work."""
        return self._process.poll() is None and not self._reader.at_eof()

    async def done(self, data: bytes, seconds: float) -> tuple[Outcome, object]:
        """Have it do pickled work within these seconds. Raises OSError and EOFError where it ends meanwhile."""
        self.pieces += 1
        self._writer.writelines((ORDER.pack(len(data), seconds), data))
        await self._writer.drain()
        size = LENGTH.unpack(await self._reader.readexactly(LENGTH.size))[0]
        reply = await self._reader.readexactly(size)
        return cast("tuple[Outcome, object]", pickle.loads(reply))  # our own worker's

    def end(self) -> None:
        """Kill it, at once and without waiting."""
        with contextlib.suppress(OSError, RuntimeError):
            self._writer.close()
        with contextlib.suppress(OSError):
            self._process.kill()
        asyncio.get_running_loop().run_in_executor(None, self._process.wait)


def _pickle(work: Work[object]) -> bytes | None:
    """Work for another process; None where it must stay in this one."""
    try:
        return pickle.dumps(work, protocol=5)
    except (pickle.PicklingError, TypeError, AttributeError):
        return None


def _start(workers: WorkerPool) -> tuple[subprocess.Popen[bytes], socket.socket]:
    """A new worker process and our end of the socket to it. Raises OSError."""
    ours, theirs = socket.socketpair()
    with theirs:
        try:
            process = subprocess.Popen(
                workers.command, stdin=theirs.fileno(), stdout=subprocess.DEVNULL, start_new_session=True
            )
        except BaseException:
            ours.close()
            raise
    ours.setblocking(False)
    return process, ours
