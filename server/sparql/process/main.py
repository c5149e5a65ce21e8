"""The query process: holds the datasets, makes changes and forks workers, until the socket that is its stdin ends."""

from __future__ import annotations

import ctypes
import gc
import os
import resource
import select
import signal
import socket
import sys
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from rosld.server.dataset.memory_store import MemoryStore
from rosld.server.runtime.process_memory import PROCESS_MEMORY, trim
from rosld.server.sparql.process.frames import (
    Change,
    Drop,
    Ended,
    ExitStatus,
    Fork,
    FrameBuffer,
    Kill,
    ReduceMemory,
    Refused,
    SharedStatus,
    pack,
    pickle_error,
)
from rosld.server.sparql.process.worker import live

_MIN_MEMORY = 32 * 1024 * 1024
"""Bytes of memory without which no worker is forked."""
_MAX_WORDS = 4096
_M_ARENA_MAX = -8
_RECEIVED = 256 * 1024


class _Child(NamedTuple):
    """A worker, and the descriptor from which its stderr is read."""

    pid: int
    words: int


class QueryProcessMain:
    """Datasets by number, and workers. It has one thread, so that it can be forked."""

    def __init__(self, connection: socket.socket, status: SharedStatus) -> None:
        self._connection = connection
        self._status = status
        self._stores: dict[int, MemoryStore] = {0: MemoryStore()}
        self._workers: dict[int, _Child] = {}
        self._buffer = FrameBuffer()
        self._descriptors: deque[int] = deque()

    def run(self) -> None:
        """Do what comes until the server is gone."""
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
        """Do what has come; False if nothing more comes, or another process is to go on."""
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
        """Tell which workers have ended."""
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
    os._exit(0)  # what it holds need not be taken apart


def _prepare() -> None:
    """Be the first to be ended where the machine is short of memory, and leave no core. One heap is enough."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # ^C is for the server, whose end is this one's
    with suppress(OSError, ValueError, AttributeError):
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        Path("/proc/self/oom_score_adj").write_text("1000")
        ctypes.CDLL(None).mallopt(_M_ARENA_MAX, 1)
    gc.freeze()  # workers write to none of it
