"""The query process: does what comes on the socket that is its standard input, until that ends."""

from __future__ import annotations

import ctypes
import gc
import io
import os
import select
import signal
import socket
import sys
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO, cast

from rosld.server.dataset.memory_store import MemoryStore
from rosld.server.runtime.process_memory import PROCESS_MEMORY, trim
from rosld.server.sparql.process.fork import Fork, pickle_error
from rosld.server.sparql.process.frames import (
    Cancel,
    Change,
    Drop,
    FrameBuffer,
    Job,
    Kind,
    ReduceMemory,
    Reply,
    SharedStatus,
    pack,
)
from rosld.server.sparql.query_limits import too_many_queries

_MAX_BYTES = 1024 * 1024
"""Bytes of a result that is not made in a fork."""
_SECONDS = 2.0
"""What work may take that is not done in a fork: hundreds of times what it takes. It ends this process."""
_MIN_MEMORY = 32 * 1024 * 1024
"""Bytes of memory without which no fork is begun."""
_MOST_GATHERED = 64 * 1024
"""Bytes of replies that are gathered."""
_M_ARENA_MAX = -8
_RECEIVED = 256 * 1024


class _TooMuch(Exception):
    """A result is larger than was thought."""


class _Few(io.BytesIO):
    """A buffer that raises _TooMuch rather than take more than `_MAX_BYTES`."""

    def write(self, data: bytes) -> int:  # type: ignore[override]
        if self.tell() + len(data) > _MAX_BYTES:
            raise _TooMuch
        return super().write(data)


class QueryProcessMain:
    """Datasets by number, and what is being done over them. `limit` forks work at a time, `waiting` jobs may wait."""

    def __init__(self, connection: socket.socket, at_work: SharedStatus, limit: int, waiting: int) -> None:
        self._connection = connection
        self._at_work = at_work
        self._limit = limit
        self._waiting = waiting
        self._stores: dict[int, MemoryStore] = {0: MemoryStore()}
        self._forks: dict[int, Fork] = {}  # by the number of the job
        self._queue: deque[Job] = deque()
        self._buffer = FrameBuffer()
        self._replies = bytearray()

    def run(self) -> None:
        """Until the server is gone."""
        woken, waking = os.pipe()
        os.set_blocking(woken, False)
        os.set_blocking(waking, False)
        signal.set_wakeup_fd(waking, warn_on_full_buffer=False)
        signal.signal(signal.SIGCHLD, lambda number, frame: None)
        poll = select.poll()
        poll.register(self._connection, select.POLLIN)
        poll.register(woken, select.POLLIN)
        try:
            while True:
                ready = poll.poll(0 if self._renew() else None)
                for descriptor, _ in ready:
                    if descriptor == woken:
                        with suppress(BlockingIOError):
                            os.read(woken, 4096)
                        self._reap()
                    elif not self._receive():
                        return
        finally:
            for fork in self._forks.values():
                os.kill(fork.pid, signal.SIGKILL)

    def _renew(self) -> bool:
        return sum(store.compact_step() for store in self._stores.values()) > 0

    def _receive(self) -> bool:
        """Do what has come; False where nothing comes any more, or another process is to go on."""
        try:
            data = self._connection.recv(_RECEIVED)
        except ConnectionResetError:
            return False
        for message in self._buffer.feed(data):
            match message:
                case Change():
                    self._flush()  # it may take a while
                    self._change(message)
                case Job():
                    self._begin(message)
                case Cancel(number):
                    self._cancel(number)
                case Drop(dataset):
                    self._stores.pop(dataset, None)
                case ReduceMemory():
                    if any(store.is_mostly_garbage for store in self._stores.values()):
                        return False
                    trim()
        self._flush()
        return bool(data)

    def _send(self, kind: Kind, number: int, value: object = None) -> None:
        self._gather(pack(Reply(kind, number, value)))

    def _gather(self, reply: bytes) -> None:
        """Reply together with what else came at once: waking the server costs more than a small query does."""
        self._replies += reply
        if len(self._replies) > _MOST_GATHERED:
            self._flush()

    def _flush(self) -> None:
        if self._replies:
            self._connection.sendall(self._replies)
            self._replies.clear()

    # --- changes

    def _change(self, change: Change) -> None:
        store = self._stores.get(change.dataset)
        if store is None:
            store = self._stores[change.dataset] = MemoryStore()
        for refused in store.replace_valid(change.graphs, change.edits):
            self._send(Kind.REFUSED, change.dataset, refused)
        self._at_work.count_change()

    # --- work

    def _begin(self, job: Job) -> None:
        store = self._stores[job.dataset]
        self._at_work.set_job(job.number)
        is_done = not job.work.may_take_long(store) and self._do_here(job, store)
        self._at_work.set_job(0)
        if is_done:
            return
        if len(self._forks) < self._limit:
            self._fork(job)
        elif len(self._queue) < self._waiting:
            self._queue.append(job)
            self._send(Kind.WAITING, job.number)
        else:
            self._send(Kind.RAISED, job.number, pickle_error(too_many_queries()))

    def _do_here(self, job: Job, store: MemoryStore) -> bool:
        """Do a job here; False where it turns out to be too much."""
        output = _Few()
        signal.setitimer(signal.ITIMER_REAL, _SECONDS)
        try:
            job.work(store, cast("BinaryIO", output))
            reply = Reply(Kind.DONE, job.number, output.getvalue())
        except _TooMuch:
            return False
        except Exception as error:
            reply = Reply(Kind.RAISED, job.number, pickle_error(error))
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
        self._gather(pack(reply))
        return True

    def _fork(self, job: Job) -> None:
        store = self._stores.get(job.dataset)
        if store is None:
            self._send(Kind.RAISED, job.number, pickle_error(too_many_queries()))
            return
        try:
            PROCESS_MEMORY.require(_MIN_MEMORY, "a query")
            fork = Fork(lambda output: job.work(store, output), job.seconds, job.memory)
        except (OSError, MemoryError) as error:
            self._send(Kind.RAISED, job.number, pickle_error(error))
            return
        self._forks[job.number] = fork
        self._flush()
        message = pack(Reply(Kind.FORKED, job.number))
        sent = socket.send_fds(self._connection, [message], [fork.reading])
        self._connection.sendall(message[sent:])
        os.close(fork.reading)

    def _cancel(self, number: int) -> None:
        fork = self._forks.get(number)
        if fork is not None:
            os.kill(fork.pid, signal.SIGKILL)
        for job in [job for job in self._queue if job.number == number]:
            self._queue.remove(job)

    def _reap(self) -> None:
        """See which forks have ended, and begin what waits for them."""
        for number, fork in [*self._forks.items()]:
            ended = fork.reap()
            if ended is not None:
                del self._forks[number]
                self._send(Kind.ENDED, number, ended)
        while self._queue and len(self._forks) < self._limit:
            self._fork(self._queue.popleft())
        self._flush()


def main() -> None:
    """Arguments: where it notes what it is at, the forks that may be at work at a time, and the jobs that may wait."""
    _prepare()
    connection = socket.socket(fileno=0)
    descriptor, limit, waiting = map(int, sys.argv[-3:])
    with suppress(BrokenPipeError, ConnectionResetError):  # the server has gone
        QueryProcessMain(connection, SharedStatus(descriptor), limit, waiting).run()
    os._exit(0)  # what it holds need not be taken apart


def _prepare() -> None:
    """Be the first to be ended where the machine is short of memory, and leave no core. One heap is enough."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # ^C is for the server, whose end is this one's
    with suppress(ImportError, OSError, ValueError, AttributeError):
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        Path("/proc/self/oom_score_adj").write_text("1000")
        ctypes.CDLL(None).mallopt(_M_ARENA_MAX, 1)
    gc.freeze()  # forks write to none of it
