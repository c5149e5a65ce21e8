"""A query worker: a fork of the query process that takes changes and jobs, one at a time in their order.

It has the datasets as they were at the fork, and lives until its socket ends or it is killed. A job writes its result
in frames; a worker that ends without a last frame crashed.
"""

from __future__ import annotations

import ctypes
import gc
import io
import os
import resource
import signal
import socket
import sys
import threading
from collections.abc import Mapping
from contextlib import suppress
from typing import BinaryIO, NoReturn, cast

from rosld.server.dataset.memory_store import MemoryStore
from rosld.server.sparql.process.frames import (
    Change,
    Data,
    Done,
    Drop,
    FrameBuffer,
    Job,
    Raised,
    Ready,
    pack,
    pickle_error,
)
from rosld.server.sparql.query_limits import too_many_queries

_CHUNK = 64 * 1024
_RECEIVED = 256 * 1024
_NICENESS = 5
"""The nice increment: whoever moves or stops the robot never waits for a query's processor."""
_MAX_GROWTH = 64 * 1024 * 1024
"""Bytes that a worker may have grown by since its start: what a large query frees need not go back to the system."""
OUT_OF_MEMORY = 86
"""The exit status of a worker that was refused memory."""
_PR_SET_PDEATHSIG = 1


def live(connection: int, stores: Mapping[int, MemoryStore], parent: int) -> NoReturn:
    """Be a worker of these datasets, in the fork; `parent` is the query process."""
    codes: list[int] = []
    try:
        gc.freeze()
        _be_alone(connection, parent)
        # The store draws what is random from a state of each thread: a new thread's is seeded anew, a fork's is not.
        worker = _Worker(socket.socket(fileno=connection), stores)
        thread = threading.Thread(target=lambda: codes.append(worker.run()))
        thread.start()
        thread.join()
    except (MemoryError, RuntimeError):  # there can be no thread
        codes.append(OUT_OF_MEMORY)
    finally:
        os._exit(codes[0] if codes else 1)


def _be_alone(connection: int, parent: int) -> None:
    """Close every other socket and file, and end with the parent."""
    signal.set_wakeup_fd(-1)
    for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGCHLD, signal.SIGALRM):
        signal.signal(number, signal.SIG_DFL)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:
            os._exit(1)
    os.closerange(3, connection)
    os.closerange(connection + 1, resource.getrlimit(resource.RLIMIT_NOFILE)[0])
    os.dup2(os.open(os.devnull, os.O_RDWR), 0)
    os.nice(_NICENESS)


class _Worker:
    """The loop of a worker, in a thread of its own."""

    def __init__(self, connection: socket.socket, stores: Mapping[int, MemoryStore]) -> None:
        self._connection = connection
        self._stores = {**stores}
        for store in stores.values():
            store.keep_garbage()
        self._memory = resource.getrlimit(resource.RLIMIT_AS)
        self._statm = -1
        with suppress(OSError):
            self._statm = os.open("/proc/self/statm", os.O_RDONLY)
        self._first_size = self._size

    def run(self) -> int:
        """Do what comes; return the exit status."""
        buffer = FrameBuffer()
        try:
            self._connection.sendall(pack(Ready()))
            while data := self._connection.recv(_RECEIVED):
                for message in buffer.feed(data):
                    match message:
                        case Change(dataset, graphs, edits):
                            self._stores.setdefault(dataset, MemoryStore()).replace_valid(graphs, edits)
                        case Drop(dataset):
                            self._stores.pop(dataset, None)
                        case Job() if not self._do(message):
                            return 0
        except MemoryError:
            return OUT_OF_MEMORY
        except (BrokenPipeError, ConnectionResetError):
            return 0
        except BaseException:
            return 1
        return 0

    def _do(self, job: Job) -> bool:
        """Do a job; whether there may be another one."""
        output = _Output(self._connection)
        signal.setitimer(signal.ITIMER_REAL, job.seconds + 1)
        self._limit_memory(job.memory)
        error: bytes | None = None
        try:
            store = self._stores.get(job.dataset)
            if store is None:
                raise too_many_queries()
            job.work(store, cast("BinaryIO", output))
        except (MemoryError, BrokenPipeError, ConnectionResetError):
            raise
        except Exception as raised:
            error = pickle_error(raised)
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
            if self._statm >= 0:
                resource.setrlimit(resource.RLIMIT_AS, self._memory)
        is_last = any(each.is_spoiled for each in self._stores.values()) or self._size > self._first_size + _MAX_GROWTH
        self._connection.sendall(pack(output.last(is_last) if error is None else Raised(error, is_last)))
        return not is_last

    @property
    def _size(self) -> int:
        """The bytes of address space that are used; 0 where nothing tells."""
        return int(os.pread(self._statm, 64, 0).split()[0]) * resource.getpagesize() if self._statm >= 0 else 0

    def _limit_memory(self, memory: int) -> None:
        """Let a job take so much memory beyond what is used now."""
        if self._statm < 0:
            return
        soft, hard = self._memory
        limit = self._size + memory
        resource.setrlimit(resource.RLIMIT_AS, (limit if soft == resource.RLIM_INFINITY else min(limit, soft), hard))


class _Output(io.RawIOBase):
    """Sends a result in frames, small writes joined."""

    def __init__(self, connection: socket.socket) -> None:
        super().__init__()
        self._connection = connection
        self._buffer = bytearray()

    def writable(self) -> bool:
        return True

    def write(self, data: bytes) -> int:  # type: ignore[override]
        """Take bytes of the result."""
        self._buffer += data
        if len(self._buffer) >= _CHUNK:
            self._connection.sendall(pack(Data(bytes(self._buffer))))
            self._buffer.clear()
        return len(data)

    def last(self, is_last: bool) -> Done:
        """Return the frame that ends the result."""
        return Done(bytes(self._buffer), is_last)
