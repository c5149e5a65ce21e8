"""The query process, which holds the datasets and forks workers, and the workers, which do jobs one at a time."""

from __future__ import annotations

import ctypes
import gc
import io
import os
import resource
import select
import signal
import socket
import sys
import threading
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO, NamedTuple, NoReturn, cast

from rosld.server.dataset.memory_store import MemoryStore
from rosld.server.runtime.process_memory import PROCESS_MEMORY, trim
from rosld.server.sparql.process.frames import (
    Change,
    Data,
    Done,
    Drop,
    Ended,
    ExitStatus,
    Fork,
    FrameBuffer,
    Job,
    Kill,
    Raised,
    Ready,
    ReduceMemory,
    Refused,
    SharedStatus,
    pack,
    pickle_error,
)
from rosld.server.sparql.query_limits import too_many_queries

_CHUNK = 64 * 1024
_RECEIVED = 256 * 1024
_NICENESS = 5
"""The nice increment of workers: queries never delay commands to the robot."""
_MAX_GROWTH = 64 * 1024 * 1024
"""Maximum growth of a worker in bytes: memory freed after a large query may not return to the system."""
OUT_OF_MEMORY = 86
"""The exit status of a worker that ran out of memory."""
_PR_SET_PDEATHSIG = 1
_MIN_MEMORY = 32 * 1024 * 1024
"""Bytes of memory required to fork a worker."""
_MAX_WORDS = 4096
_M_ARENA_MAX = -8


def live(connection: int, stores: Mapping[int, MemoryStore], parent: int) -> NoReturn:
    """Run a worker of these datasets in a fork of the query process, whose process ID is `parent`."""
    codes: list[int] = []
    try:
        gc.freeze()
        _isolate(connection, parent)
        # The store's random numbers have a state per thread: it is seeded in a new thread, but not in a fork.
        worker = _Worker(socket.socket(fileno=connection), stores)
        thread = threading.Thread(target=lambda: codes.append(worker.run()))
        thread.start()
        thread.join()
    except (MemoryError, RuntimeError):  # no thread can be started
        codes.append(OUT_OF_MEMORY)
    finally:
        os._exit(codes[0] if codes else 1)


def _isolate(connection: int, parent: int) -> None:
    """Close all other descriptors, and arrange to be killed with the parent."""
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
    """Loop of a worker, run in a thread of its own."""

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
        """Handle messages until the end; return the exit status."""
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
        """Do a job; return whether the worker can take another one."""
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
        is_last = any(each.is_modified for each in self._stores.values()) or self._size > self._first_size + _MAX_GROWTH
        self._connection.sendall(pack(output.last(is_last) if error is None else Raised(error, is_last)))
        return not is_last

    @property
    def _size(self) -> int:
        """Size of the address space in bytes; 0 if unknown."""
        return int(os.pread(self._statm, 64, 0).split()[0]) * resource.getpagesize() if self._statm >= 0 else 0

    def _limit_memory(self, memory: int) -> None:
        """Limit the memory that a job uses beyond the present size."""
        if self._statm < 0:
            return
        soft, hard = self._memory
        limit = self._size + memory
        resource.setrlimit(resource.RLIMIT_AS, (limit if soft == resource.RLIM_INFINITY else min(limit, soft), hard))


class _Output(io.RawIOBase):
    """Output that sends a result in frames, joining small writes."""

    def __init__(self, connection: socket.socket) -> None:
        super().__init__()
        self._connection = connection
        self._buffer = bytearray()

    def writable(self) -> bool:
        return True

    def write(self, data: bytes) -> int:  # type: ignore[override]
        """Add bytes of the result."""
        self._buffer += data
        if len(self._buffer) >= _CHUNK:
            self._connection.sendall(pack(Data(bytes(self._buffer))))
            self._buffer.clear()
        return len(data)

    def last(self, is_last: bool) -> Done:
        """Return the frame that ends the result."""
        return Done(bytes(self._buffer), is_last)


class _Child(NamedTuple):
    """Process ID of a worker, and the descriptor of its stderr."""

    pid: int
    words: int


class QueryProcessMain:
    """Datasets by number, and workers. Single-threaded, so that it can fork safely."""

    def __init__(self, connection: socket.socket, status: SharedStatus) -> None:
        self._connection = connection
        self._status = status
        self._stores: dict[int, MemoryStore] = {0: MemoryStore()}
        self._workers: dict[int, _Child] = {}
        self._buffer = FrameBuffer()
        self._descriptors: deque[int] = deque()

    def run(self) -> None:
        """Handle messages until the server closes the connection."""
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
                for descriptor, _ in poll.poll(0 if self._renew() else None):
                    if descriptor == woken:
                        with suppress(BlockingIOError):
                            os.read(woken, 4096)
                        self._reap()
                    elif not self._receive():
                        return
        finally:
            for child in self._workers.values():
                os.kill(child.pid, signal.SIGKILL)

    def _renew(self) -> bool:
        return sum(store.compact_step() for store in self._stores.values()) > 0

    def _receive(self) -> bool:
        """Handle received messages; return False at the end, or if a new process should take over."""
        try:
            data, descriptors, _, _ = socket.recv_fds(self._connection, _RECEIVED, 16)
        except ConnectionResetError:
            return False
        self._descriptors.extend(descriptors)
        for message in self._buffer.feed(data):
            match message:
                case Change():
                    self._change(message)
                case Drop(dataset):
                    self._stores.pop(dataset, None)
                case Fork(number):
                    self._fork(number, self._descriptors.popleft())
                case Kill(number) if number in self._workers:
                    os.kill(self._workers[number].pid, signal.SIGKILL)
                case ReduceMemory():
                    if any(store.is_mostly_garbage for store in self._stores.values()):
                        return False
                    trim()
        return bool(data)

    def _send(self, message: Refused | Ended) -> None:
        self._connection.sendall(pack(message))

    def _change(self, change: Change) -> None:
        store = self._stores.setdefault(change.dataset, MemoryStore())
        for refused in store.replace_valid(change.graphs, change.edits):
            self._send(Refused(*refused))
        self._status.count_change()

    # --- workers

    def _fork(self, number: int, connection: int) -> None:
        parent, pipe = os.getpid(), list[int]()
        try:
            PROCESS_MEMORY.require(_MIN_MEMORY, "a query")
            pipe += os.pipe()
            pid = os.fork()
        except (OSError, MemoryError) as error:
            self._send(Ended(number, pickle_error(error)))
        else:
            if pid == 0:
                os.dup2(pipe[1], 2)
                live(connection, self._stores, parent)
            self._workers[number] = _Child(pid, pipe.pop(0))
        for descriptor in (connection, *pipe):
            os.close(descriptor)

    def _reap(self) -> None:
        """Report the workers that have ended."""
        for number, child in [*self._workers.items()]:
            pid, status = os.waitpid(child.pid, os.WNOHANG)
            if pid:
                words = os.read(child.words, _MAX_WORDS)
                os.close(child.words)
                del self._workers[number]
                self._send(Ended(number, ExitStatus(status, words.decode("utf-8", "replace"))))


def main() -> None:
    """Run the query process; the last argument is the descriptor of its `SharedStatus`."""
    _prepare()
    connection = socket.socket(fileno=0)
    with suppress(BrokenPipeError, ConnectionResetError):  # the server has gone
        QueryProcessMain(connection, SharedStatus(int(sys.argv[-1]))).run()
    os._exit(0)  # skips the destruction of the datasets


def _prepare() -> None:
    """Volunteer for the out-of-memory killer, write no core dump, use one heap."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # ^C ends the server, which ends this process
    with suppress(OSError, ValueError, AttributeError):
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        Path("/proc/self/oom_score_adj").write_text("1000")
        ctypes.CDLL(None).mallopt(_M_ARENA_MAX, 1)
    gc.freeze()  # a collection in a worker would copy shared pages
