"""Connections of the server to the query process and to its workers: frames out, messages in."""

from __future__ import annotations

import asyncio
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterable
from itertools import count, islice

from rosld.server.dataset.encoding import NAMESPACE, VARIABLE
from rosld.server.runtime.process_memory import Memory, NotEnoughMemory, available_bytes
from rosld.server.sparql.process.frames import FrameBuffer, ReduceMemory, SharedStatus, pack

_RECEIVED = 256 * 1024
_AHEAD = 4 * 1024 * 1024
"""Maximum number of bytes queued for the process before senders wait."""
_AT_ONCE = 64
"""Maximum number of frames in one system call."""
_START = "import sys; sys.path[:] = sys.argv[1:-1]; from rosld.server.sparql.process.keeper import main; main()"
"""The program of the process; it finds modules where the server does."""

SpawnedProcess = tuple["subprocess.Popen[bytes]", socket.socket, SharedStatus]


def spawn() -> SpawnedProcess:
    """Start a query process; return it, the socket to it and the memory with its count of changes. Raises OSError."""
    ours, theirs = socket.socketpair()
    with theirs, tempfile.TemporaryFile() as file:
        try:
            file.truncate(SharedStatus.SIZE)
            command = [sys.executable, "-c", _START, *sys.path, str(file.fileno())]
            popen = subprocess.Popen(
                command,
                stdin=theirs.fileno(),
                stdout=subprocess.DEVNULL,
                pass_fds=(file.fileno(),),
                env={**os.environ, VARIABLE: NAMESPACE},
                start_new_session=True,
            )
            status = SharedStatus(file.fileno())
        except BaseException:
            ours.close()
            raise
    ours.setblocking(False)
    return popen, ours, status


class Connection:
    """A socket on the server's loop.

    `on_message` is called with each message received, `on_lost` once, after the other end has closed.
    """

    def __init__(
        self,
        connection: socket.socket,
        loop: asyncio.AbstractEventLoop,
        on_message: Callable[[object], None],
        on_lost: Callable[[], None],
    ) -> None:
        connection.setblocking(False)
        self._socket: socket.socket | None = connection
        self._loop = loop
        self._on_message = on_message
        self._on_lost = on_lost
        self._output: deque[tuple[memoryview, int | None]] = deque()
        self._buffer = FrameBuffer()
        self._drained: asyncio.Future[None] | None = None
        self._is_paused = False
        loop.add_reader(connection, self._receive)

    @property
    def is_open(self) -> bool:
        """Whether the socket is open."""
        return self._socket is not None

    def close(self) -> None:
        """Close the socket, which ends the other side. Idempotent."""
        connection, self._socket = self._socket, None
        if connection is None:
            return
        self._loop.remove_reader(connection)
        self._loop.remove_writer(connection)
        connection.close()
        for _, descriptor in self._output:
            if descriptor is not None:
                os.close(descriptor)
        self._output.clear()
        self._notify_drained()

    def send(self, data: bytes, descriptor: int | None = None) -> None:
        """Queue a frame, with a descriptor that is closed after sending. Does nothing on a closed connection."""
        if self._socket is None:
            if descriptor is not None:
                os.close(descriptor)
            return
        if not self._output:
            self._loop.call_soon(self.flush)
        self._output.append((memoryview(data), descriptor))

    def flush(self) -> None:
        """Send what the socket accepts now; frames sent in one iteration of the loop wake the other side once."""
        if self._socket is None:
            return
        while self._output:
            sent = _send(self._socket, self._output)
            if sent is None:
                self._loop.add_writer(self._socket, self.flush)
                break
            while self._output and sent >= len(self._output[0][0]):
                sent -= len(self._output.popleft()[0])
            if sent:
                self._output[0] = (self._output[0][0][sent:], None)
        else:
            self._loop.remove_writer(self._socket)
        self._notify_drained()

    async def wait_drained(self) -> None:
        """Wait until the other side has received most of what was sent, or has closed the connection."""
        while sum(len(view) for view, _ in self._output) > _AHEAD:
            self._drained = self._drained or self._loop.create_future()
            await asyncio.shield(self._drained)

    def _notify_drained(self) -> None:
        drained, self._drained = self._drained, None
        if drained is not None and not drained.done():
            drained.set_result(None)

    def pause(self) -> None:
        """Receive nothing until `resume`; the other side blocks once the socket is full."""
        if self._socket is not None and not self._is_paused:
            self._is_paused = True
            self._loop.remove_reader(self._socket)

    def resume(self) -> None:
        """Receive again."""
        if self._socket is not None and self._is_paused:
            self._is_paused = False
            self._loop.add_reader(self._socket, self._receive)

    def _receive(self) -> None:
        """Receive until nothing is left.

        If the process was killed with requests unread, uvloop reports the socket as readable only once.
        """
        while self._socket is not None and not self._is_paused:
            self._read(self._socket)
            if self._socket is None or not _is_readable(self._socket):
                return

    def _read(self, connection: socket.socket) -> None:
        try:
            data = connection.recv(_RECEIVED)
        except (BlockingIOError, InterruptedError):
            return
        except OSError:
            data = b""
        if not data:
            self.close()
            self._on_lost()
            return
        for message in self._buffer.feed(data):
            self._on_message(message)


def _is_readable(connection: socket.socket) -> bool:
    """Whether there are bytes or an end of file to read."""
    try:
        connection.recv(1, socket.MSG_PEEK)
    except (BlockingIOError, InterruptedError):
        return False
    except OSError:
        return True
    return True


def _send(connection: socket.socket, output: Iterable[tuple[memoryview, int | None]]) -> int | None:
    """Send what the socket accepts now of the first frames; return the number of bytes, None if it would block.

    A frame with a descriptor is sent on its own.
    """
    views: list[memoryview] = []
    passed: int | None = None
    for view, descriptor in islice(output, _AT_ONCE):
        if descriptor is not None and views:
            break
        views.append(view)
        if descriptor is not None:
            passed = descriptor
            break
    try:
        sent = connection.sendmsg(views) if passed is None else socket.send_fds(connection, views, [passed])
    except (BlockingIOError, InterruptedError):
        return None
    except OSError:  # the process is dead, which is noticed by reading
        sent = sum(map(len, views))
    if passed is not None:
        os.close(passed)
    return sent


class ChildProcess(Connection):
    """A query process that has been spawned."""

    def __init__(
        self,
        spawned: SpawnedProcess,
        loop: asyncio.AbstractEventLoop,
        on_message: Callable[[object], None],
        on_lost: Callable[[], None],
    ) -> None:
        self.popen, connection, self._status = spawned
        self.started = time.monotonic()
        self._memory = Memory(lambda: available_bytes(self.popen.pid))
        self._changes = count(1)
        self._ahead: deque[tuple[int, int]] = deque()
        """Changes that may be pending in the process: the number of each since the start, and the bytes it needs."""
        super().__init__(connection, loop, on_message, on_lost)

    def send_change(self, data: bytes, needed: int) -> None:
        """Send a change for which the process needs `needed` bytes of memory."""
        self.send(data)
        self._ahead.append((next(self._changes), needed))

    def require_memory(self, needed: int, what: str) -> None:
        """Raise NotEnoughMemory if the process lacks memory for this in addition to the pending changes."""
        applied = self._status.changes
        while self._ahead and self._ahead[0][0] <= applied:
            self._ahead.popleft()
        try:
            self._memory.require(needed + sum(each for _, each in self._ahead), what)
        except NotEnoughMemory:
            self.send(pack(ReduceMemory()))
            raise
