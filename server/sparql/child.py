"""A process of its own for a query: the one thing that can be stopped at any moment.

A query may sort a cross product of everything: it takes all time and all memory there is, and the store cannot be told
to stop. So each query that is not known to be small is answered in a child of this process, which sees the dataset as
it is at that moment, has a limit on its memory, and is killed when the time is over or nobody reads any more. It sends
what it writes through a pipe, in frames: bytes, and at last how it ended.
"""

from __future__ import annotations

import contextlib
import io
import os
import pickle
import select
import signal
import struct
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from enum import Enum
from pathlib import Path
from typing import BinaryIO, NamedTuple, NoReturn, TypeAlias, cast

from rosld.server.http.problem import Problem
from rosld.server.sparql.results import Check
from rosld.server.store import QueryError

AVAILABLE = sys.platform == "linux"
"""Elsewhere a process with threads cannot be forked safely, and queries run in threads."""
_FRAME = struct.Struct("<cI")
_CHUNK = 64 * 1024
_GLANCE = 0.05
"""Seconds between looks at whether somebody still wants the answer."""
_MIB = 1024 * 1024

warnings.filterwarnings("ignore", message=".*multi-threaded, use of fork.*", category=DeprecationWarning)


Work: TypeAlias = Callable[[BinaryIO], None]
"""What a child does: write an answer."""


class _Kind(Enum):
    """What a frame is: a piece of the answer, its end, the store's words, a refusal of ours."""

    DATA = b"d"
    END = b"e"
    WORDS = b"w"
    PROBLEM = b"p"


class Limits(NamedTuple):
    """What a child may use: seconds, and bytes of memory beyond what it begins with."""

    seconds: float
    memory: int


def answer(
    work: Work,
    output: BinaryIO,
    check: Check,
    limits: Limits,
    still: AbstractContextManager[None],
) -> None:
    """Have a child write to `output` what `work` writes. To be called in a worker thread.

    Within `still` the store does not change, so that the child gets it whole. Raises what `check` raises (looked at
    many times a second), QueryError and Problem as `work` does, and a 503 Problem where the memory did not suffice.
    """
    reading, writing = os.pipe()
    with still:
        child = os.fork()
        if child == 0:
            _live(work, writing, limits)
    os.close(writing)
    try:
        with io.FileIO(reading, "rb") as pipe:
            _copy(pipe, output, check, limits)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)


# --- in the child


def _live(work: Work, writing: int, limits: Limits) -> NoReturn:
    """The child's whole life. It shares nothing that it could harm, and ends by itself should its parent be gone."""
    try:
        _be_alone(writing, limits)
        frames = _Frames(writing)
        try:
            work(cast("BinaryIO", frames))
        except QueryError as error:
            frames.send(_Kind.WORDS, str(error).encode("utf-8", "replace"))
        except Problem as problem:
            frames.send(_Kind.PROBLEM, pickle.dumps((problem.status, problem.detail, problem.headers)))
        else:
            frames.flush()
            frames.send(_Kind.END, b"")
    finally:
        os._exit(0)


def _be_alone(writing: int, limits: Limits) -> None:
    """Let go of every socket and file, and take the limits on."""
    import resource

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, signal.SIG_DFL)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_REAL, limits.seconds + 1)
    os.closerange(3, writing)
    os.closerange(writing + 1, resource.getrlimit(resource.RLIMIT_NOFILE)[0])
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + limits.memory
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # the words of an allocator that gives up are for nobody


class _Frames(io.RawIOBase):
    """Writes frames to the parent, small writes joined."""

    def __init__(self, descriptor: int) -> None:
        super().__init__()
        self._descriptor = descriptor
        self._buffer = bytearray()

    def writable(self) -> bool:
        return True

    def write(self, data: bytes) -> int:  # type: ignore[override]
        """Take bytes of the answer."""
        self._buffer += data
        if len(self._buffer) >= _CHUNK:
            self.flush()
        return len(data)

    def flush(self) -> None:
        """Send what was taken."""
        if self._buffer:
            self.send(_Kind.DATA, bytes(self._buffer))
            self._buffer.clear()

    def send(self, kind: _Kind, data: bytes) -> None:
        """Send one frame."""
        view = memoryview(_FRAME.pack(kind.value, len(data)) + data)
        while view:
            view = view[os.write(self._descriptor, view) :]


# --- in the parent


def _copy(pipe: io.FileIO, output: BinaryIO, check: Check, limits: Limits) -> None:
    for kind, data in _frames(pipe, check):
        if kind is _Kind.DATA:
            output.write(data)
        elif kind is _Kind.WORDS:
            raise QueryError(data.decode())
        elif kind is _Kind.PROBLEM:
            status, detail, headers = pickle.loads(data)  # our own child's
            raise Problem(status, detail, headers=headers)
        else:
            return
    mebibytes = limits.memory // _MIB
    raise Problem(503, f"The query needed more than {mebibytes} MiB of memory, this server's limit: ask for less.")


def _frames(pipe: io.FileIO, check: Check) -> Iterator[tuple[_Kind, bytes]]:
    """The frames as they come; they end early where the child did."""
    waiting = select.poll()
    waiting.register(pipe, select.POLLIN | select.POLLHUP)
    buffer = bytearray()
    while True:
        check()
        if not waiting.poll(_GLANCE * 1000):
            continue
        found = pipe.read(_CHUNK)
        if not found:
            return
        buffer += found
        while len(buffer) >= _FRAME.size:
            kind, size = _FRAME.unpack_from(buffer)
            if len(buffer) < _FRAME.size + size:
                break
            yield _Kind(kind), bytes(buffer[_FRAME.size : _FRAME.size + size])
            del buffer[: _FRAME.size + size]
