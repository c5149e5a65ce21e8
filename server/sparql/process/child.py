"""One query process from its start to its end: how it is started, what it is sent, what it tells."""

from __future__ import annotations

import asyncio
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Sequence
from itertools import count, islice
from typing import cast

from rosld.server.dataset.encoding import NAMESPACE, VARIABLE
from rosld.server.runtime.process_memory import Memory, NotEnoughMemory, available_bytes
from rosld.server.sparql.process.frames import FrameBuffer, ReduceMemory, Reply, SharedStatus, pack
from rosld.server.sparql.query_limits import process_restarting

_RECEIVED = 256 * 1024
_AHEAD = 4 * 1024 * 1024
"""Bytes that may be on their way to the process before others should be made."""
_AT_ONCE = 64
"""Frames that are sent by one system call."""
_START = "import sys; sys.path[:] = sys.argv[1:-3]; from rosld.server.sparql.process.main import main; main()"
"""What the process runs: with the same modules as the server, wherever that found them."""

SpawnedProcess = tuple["subprocess.Popen[bytes]", socket.socket, SharedStatus]


def spawn(concurrency: int, queue: int) -> SpawnedProcess:
    """Start a process, with the socket to it and the memory in which it notes what it is at. Raises OSError."""
    ours, theirs = socket.socketpair()
    with theirs, tempfile.TemporaryFile() as file:
        try:
            file.truncate(SharedStatus.SIZE)
            command = [sys.executable, "-c", _START, *sys.path, str(file.fileno()), str(concurrency), str(queue)]
            popen = subprocess.Popen(
                command,
                stdin=theirs.fileno(),
                stdout=subprocess.DEVNULL,
                pass_fds=(file.fileno(),),
                env={**os.environ, VARIABLE: NAMESPACE},
                start_new_session=True,
            )
            at_work = SharedStatus(file.fileno())
        except BaseException:
            ours.close()
            raise
    ours.setblocking(False)
    return popen, ours, at_work


class ChildProcess:
    """A process that has been spawned. Belongs to one loop.

    `on_reply` is called with each reply and the descriptors that have come and belong to this or later ones, `on_lost`
    once, when the process is gone.
    """

    def __init__(
        self,
        spawned: SpawnedProcess,
        loop: asyncio.AbstractEventLoop,
        on_reply: Callable[[Reply, deque[int]], None],
        on_lost: Callable[[], None],
    ) -> None:
        self.popen, connection, self.at_work = spawned
        self.started = time.monotonic()
        self._socket: socket.socket | None = connection
        self._loop = loop
        self._on_reply = on_reply
        self._on_lost = on_lost
        self._output: deque[memoryview] = deque()
        self._descriptors: deque[int] = deque()
        self._buffer = FrameBuffer()
        self._taken: asyncio.Future[None] | None = None
        self._memory = Memory(lambda: available_bytes(self.popen.pid))
        self._changes = count(1)
        self._ahead: deque[tuple[int, int]] = deque()
        """The changes that may not have been made yet: the number of each since the start, and the bytes for it."""
        loop.add_reader(connection, self._receive)

    def close(self) -> None:
        """Let go of the connection; the process ends by that. Idempotent."""
        connection, self._socket = self._socket, None
        if connection is None:
            return
        self._loop.remove_reader(connection)
        self._loop.remove_writer(connection)
        connection.close()
        self._output.clear()
        self._tell_taken()
        while self._descriptors:
            os.close(self._descriptors.popleft())

    def send(self, data: bytes) -> None:
        """Send frames, after all that was sent before. Raises Problem 503 where the process is gone."""
        if self._socket is None:
            raise process_restarting(1)
        if not self._output:
            self._loop.call_soon(self._flush)
        self._output.append(memoryview(data))

    def send_change(self, data: bytes, needed: int) -> None:
        """Send a change for which the process needs so many bytes. Raises as `send`."""
        self.send(data)
        self._ahead.append((next(self._changes), needed))

    def require_memory(self, needed: int, what: str) -> None:
        """Raise NotEnoughMemory where the process has none for this and the changes that it is still to make.

        Raises Problem 503 where the process is gone.
        """
        if self._socket is None:
            raise process_restarting(1)
        try:
            self._memory.require(needed + sum(each for _, each in self._still_ahead()), what)
        except NotEnoughMemory:
            self.send(pack(ReduceMemory()))
            raise

    @property
    def is_behind(self) -> bool:
        """Whether it is still to make changes that it was sent."""
        return len(self._still_ahead()) > 0

    def _still_ahead(self) -> Sequence[tuple[int, int]]:
        made = self.at_work.changes
        while self._ahead and self._ahead[0][0] <= made:
            self._ahead.popleft()
        return self._ahead

    async def wait_drained(self) -> None:
        """Return when the process has taken most of what it was sent, or is gone."""
        while sum(map(len, self._output)) > _AHEAD:
            self._taken = self._taken or self._loop.create_future()
            await asyncio.shield(self._taken)

    def _flush(self) -> None:
        """Send what was gathered in a turn of the loop: waking the process costs more than a small query does."""
        if self._socket is None:
            return
        while self._output:
            sent = _send(self._socket, [*islice(self._output, _AT_ONCE)])
            if sent is None:
                self._loop.add_writer(self._socket, self._flush)
                break
            while self._output and sent >= len(self._output[0]):
                sent -= len(self._output.popleft())
            if sent:
                self._output[0] = self._output[0][sent:]
        else:
            self._loop.remove_writer(self._socket)
        self._tell_taken()

    def _tell_taken(self) -> None:
        taken, self._taken = self._taken, None
        if taken is not None and not taken.done():
            taken.set_result(None)

    def _receive(self) -> None:
        """Take all that has come.

        To its end: where the process was killed with requests unread, uvloop tells of it once, and of nothing after.
        """
        while self._socket is not None:
            self._read(self._socket)
            if self._socket is None or not _is_readable(self._socket):
                return

    def _read(self, connection: socket.socket) -> None:
        try:
            data, descriptors, _, _ = socket.recv_fds(connection, _RECEIVED, 64, socket.MSG_CMSG_CLOEXEC)
        except (BlockingIOError, InterruptedError):
            return
        except OSError:
            data, descriptors = b"", []
        self._descriptors.extend(descriptors)
        if not data:
            self.close()
            self._on_lost()
            return
        for message in self._buffer.feed(data):
            self._on_reply(cast("Reply", message), self._descriptors)


def _is_readable(connection: socket.socket) -> bool:
    """Whether there are bytes, or an end, to be read."""
    try:
        connection.recv(1, socket.MSG_PEEK)
    except (BlockingIOError, InterruptedError):
        return False
    except OSError:
        return True
    return True


def _send(connection: socket.socket, views: Sequence[memoryview]) -> int | None:
    """Send what the socket takes now; the number of bytes, None where it takes none."""
    try:
        return connection.sendmsg(views)
    except (BlockingIOError, InterruptedError):
        return None
    except OSError:  # the process is dead, which is noticed by reading
        return sum(map(len, views))
