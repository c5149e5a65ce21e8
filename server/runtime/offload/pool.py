"""Pool of worker processes, started on demand and ended when idle."""

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
"""Work of a worker: a `functools.partial` of a module's function with picklable arguments."""

MAX_WORKERS = max(1, min(2, (os.cpu_count() or 2) - 1))
"""Maximum number of workers: one processor is left to the server."""
WORK_SECONDS = 120.0
"""Default maximum seconds for one piece of work."""
WORKER_BYTES = 6 * 1024 * 1024 * 1024
"""Maximum bytes of address space of a worker."""
IDLE_SECONDS = 30.0
"""Seconds after which an idle worker ends."""
MAX_QUEUED = 32
"""Maximum number of waiting pieces of work."""
_BUFFER = 1024 * 1024
_AT_ONCE_SECONDS = 0.5
"""Seconds from the start of work within which the end of a used worker is not attributed to the work."""
_START = "import sys; sys.path[:] = sys.argv[1:-1]; from rosld.server.runtime.offload.worker import main; main()"
"""The program of a worker; it finds modules where the server does."""


class WorkerPool:
    """Pool that runs work in other processes. Belongs to one loop."""

    def __init__(
        self,
        limit: int = MAX_WORKERS,
        seconds: float = WORK_SECONDS,
        memory: int = WORKER_BYTES,
        subject: str = "document",
    ) -> None:
        """Initialize; `subject` is the name of the processed objects in error messages."""
        self._seconds = seconds
        self._memory = memory
        self._subject = subject
        self._free = asyncio.Semaphore(limit)
        self._waiting = 0
        self._idle: list[_Worker] = []
        self._busy: set[_Worker] = set()

    async def run(self, work: Work[_T], seconds: float | None = None) -> _T:
        """Return the result of work, or raise its exception (OSError, ValueError, LookupError or one of rosld).

        The worker is killed after `seconds` (None: those of the pool). Raises Problem 503 if too much work waits or a
        worker ended early, and 507 if its memory did not suffice.
        """
        data = _pickle(work)
        if data is None:  # such as rights that depend on types, which only this process knows
            return await asyncio.to_thread(work)
        if self._waiting >= MAX_QUEUED:
            words = f"Too many large {self._subject}s are being processed: try again."
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
                    continue  # it ended while idle: use another one
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
            words = f"This {self._subject} needs too much memory: split it into several."
            raise Problem(507, words) from value
        if isinstance(value, Exception):
            raise value
        _log.error("a worker process failed:\n%s", value)
        raise RuntimeError("a worker process failed")

    def _too_much(self, seconds: float) -> Problem:
        words = f"This {self._subject} takes more than {seconds:g} s to process, or too much memory"
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
        """Command line of a worker."""
        return [sys.executable, "-c", _START, *sys.path, str(self._memory)]

    async def close(self) -> None:
        """End all workers, including busy ones. Idempotent."""
        for worker in (*self._idle, *self._busy):
            worker.end()
        self._idle.clear()


class _Worker:
    """A worker process and the socket to it."""

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
        """Whether the worker can accept work."""
        return self._process.poll() is None and not self._reader.at_eof()

    async def done(self, data: bytes, seconds: float) -> tuple[Outcome, object]:
        """Run pickled work within these seconds. Raises OSError and EOFError if the worker ends meanwhile."""
        self.pieces += 1
        self._writer.writelines((ORDER.pack(len(data), seconds), data))
        await self._writer.drain()
        size = LENGTH.unpack(await self._reader.readexactly(LENGTH.size))[0]
        reply = await self._reader.readexactly(size)
        return cast("tuple[Outcome, object]", pickle.loads(reply))  # from our own worker

    def end(self) -> None:
        """Kill the worker without waiting."""
        with contextlib.suppress(OSError, RuntimeError):
            self._writer.close()
        with contextlib.suppress(OSError):
            self._process.kill()
        asyncio.get_running_loop().run_in_executor(None, self._process.wait)


def _pickle(work: Work[object]) -> bytes | None:
    """Pickle work for another process; return None if it must stay in this one."""
    try:
        return pickle.dumps(work, protocol=5)
    except (pickle.PicklingError, TypeError, AttributeError):
        return None


def _start(workers: WorkerPool) -> tuple[subprocess.Popen[bytes], socket.socket]:
    """Start a worker process; return it and our end of the socket. Raises OSError."""
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
