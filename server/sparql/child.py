"""A process of its own for a query: the one thing that can be stopped at any moment.

A query may sort a cross product of everything: it takes all time and all memory there is, and the store cannot be told
to stop. So each query that is not known to be small is answered in a child of this process, which sees the dataset as
it is at that moment, has a limit on its memory, and is killed when the time is over or nobody reads any more. It sends
what it writes through a pipe, in frames: bytes, and at last how it ended. A child that ends without saying so crashed.
"""

from __future__ import annotations

import contextlib
import fcntl
import io
import os
import pickle
import re
import select
import signal
import struct
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from enum import Enum
from pathlib import Path
from queue import Queue
from typing import BinaryIO, NoReturn, TypeAlias, cast

from rosld.server.http.problem import Problem
from rosld.server.memory import MEMORY
from rosld.server.sparql.limits import Limits, crashed, out_of_memory, out_of_time
from rosld.server.sparql.results import Check
from rosld.server.store import QueryError

AVAILABLE = sys.platform == "linux"
"""Elsewhere a process with threads cannot be forked safely, and queries run in threads."""
_FRAME = struct.Struct("<cI")
_MIB = 1024 * 1024
_CHUNK = 64 * 1024
_PIPE = 1024 * 1024
"""Bytes that a child may be ahead of its reader."""
_GLANCE = 0.05
"""Seconds between looks at whether the time is over."""
_BEHIND = 5
"""How much nicer than the server a child is: whoever moves or stops the robot never waits for a query's processor."""
_LEAST = 32 * _MIB
"""Bytes of memory without which no query is begun."""
_NO_MEMORY = 86
"""How a child exits that was refused memory."""

# Python 3.12 and later warn of every fork in a process with threads, for the child may find locks held for ever. The
# child here runs the query and nothing else, and its time is limited. Only this fork is silent, any other one warns.
# The filter goes when queries run in a process of their own.
warnings.filterwarnings(
    "ignore", r".*multi-threaded, use of fork", DeprecationWarning, module=rf"{re.escape(__name__)}\Z"
)


Work: TypeAlias = Callable[[BinaryIO], None]
"""What a child does: write an answer."""


class _Kind(Enum):
    """What a frame is: a piece of the answer, its end, the store's words, a refusal of ours."""

    DATA = b"d"
    END = b"e"
    WORDS = b"w"
    PROBLEM = b"p"


class Leash:
    """What a child is killed by, at once and from any thread: before it began, while it is at work, or too late."""

    def __init__(self) -> None:
        self._child: int | None = None
        self._pulled = False
        self._lock = threading.Lock()

    def pull(self) -> None:
        """Kill the child, or whichever comes to be held."""
        with self._lock:
            self._pulled = True
            if self._child is not None:
                os.kill(self._child, signal.SIGKILL)

    def hold(self, child: int) -> None:
        """From now on it is killed by `pull`."""
        with self._lock:
            self._child = child
            if self._pulled:
                os.kill(child, signal.SIGKILL)

    def let_go(self) -> None:
        """It is about to be waited for: its number may be another's then."""
        with self._lock:
            self._child = None


def answer(
    work: Work,
    output: BinaryIO,
    check: Check,
    limits: Limits,
    still: AbstractContextManager[None],
    leash: Leash,
) -> None:
    """Have a child write to `output` what `work` writes. To be called in a worker thread.

    Within `still` the store does not change, so that the child gets it whole. Raises what `check` raises (looked at
    many times a second, and as soon as the leash was pulled), QueryError and Problem as `work` does; Problems 503 where
    the memory did not suffice and 500 where the child crashed.
    """
    MEMORY.require(_LEAST, "a query")
    reading, writing = os.pipe()
    with contextlib.suppress(OSError):  # an ordinary pipe does as well
        fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, _PIPE)
    with still:
        child = os.fork()
        if child == 0:
            _live(work, writing, limits)
    leash.hold(child)
    os.close(writing)
    said = True
    try:
        with io.FileIO(reading, "rb") as pipe:
            said = _copy(pipe, output, check)
    finally:
        leash.let_go()
        if said:
            os.kill(child, signal.SIGKILL)
            _undertaker.bury(child)
    if not said:
        _, status = os.waitpid(child, 0)
        check()
        raise _why(status, limits)


def _why(status: int, limits: Limits) -> Problem:
    """Why a child ended that did not say so."""
    if os.WIFSIGNALED(status):
        number = os.WTERMSIG(status)
        if number == signal.SIGABRT:  # what an allocator does that gets no memory
            return out_of_memory(limits.memory)
        return out_of_time(limits.seconds) if number == signal.SIGALRM else crashed(f"signal {number}")
    code = os.WEXITSTATUS(status)
    return out_of_memory(limits.memory) if code == _NO_MEMORY else crashed(f"exit {code}")


class _Undertaker:
    """Waits for children whose answer is there: their memory takes the system longer than a small answer."""

    def __init__(self) -> None:
        self._ended: Queue[int] = Queue()
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None

    def bury(self, child: int) -> None:
        with self._lock:
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, name="sparql-undertaker", daemon=True)
                self._thread.start()
        self._ended.put(child)

    def done(self) -> None:
        """Return when all are buried."""
        self._ended.join()

    def _work(self) -> None:
        while True:
            child = self._ended.get()
            with contextlib.suppress(ChildProcessError):
                os.waitpid(child, 0)
            self._ended.task_done()


_undertaker = _Undertaker()


def buried() -> None:
    """Return when no child is left that has ended."""
    _undertaker.done()


# --- in the child


def _live(work: Work, writing: int, limits: Limits) -> NoReturn:
    """The child's whole life. It shares nothing that it could harm, and ends by itself should its parent be gone."""
    code = 1
    try:
        _be_alone(writing, limits)
        frames = _Frames(writing)
        try:
            work(cast("BinaryIO", frames))
            frames.flush()
        except QueryError as error:
            frames.send(_Kind.WORDS, str(error).encode("utf-8", "replace"))
        except Problem as problem:
            told = (problem.status, problem.detail, problem.headers, problem.extra)
            frames.send(_Kind.PROBLEM, pickle.dumps(told))
        else:
            frames.send(_Kind.END, b"")
        code = 0
    except MemoryError:
        code = _NO_MEMORY
    finally:
        os._exit(code)


def _be_alone(writing: int, limits: Limits) -> None:
    """Let go of every socket and file, and take the limits on."""
    import resource

    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGQUIT):
        signal.signal(number, signal.SIG_DFL)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_REAL, limits.seconds + 1)
    os.closerange(3, writing)
    os.closerange(writing + 1, resource.getrlimit(resource.RLIMIT_NOFILE)[0])
    os.nice(_BEHIND)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most, hard = pages * resource.getpagesize() + limits.memory, resource.getrlimit(resource.RLIMIT_AS)[1]
    if hard != resource.RLIM_INFINITY:
        most = min(most, hard)
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


def _copy(pipe: io.FileIO, output: BinaryIO, check: Check) -> bool:
    """Copy the answer; whether all of it came."""
    for kind, data in _frames(pipe, check):
        if kind is _Kind.DATA:
            output.write(data)
        elif kind is _Kind.WORDS:
            raise QueryError(data.decode())
        elif kind is _Kind.PROBLEM:
            status, detail, headers, extra = pickle.loads(data)  # our own child's
            raise Problem(status, detail, headers=headers, extra=extra)
        else:
            return True
    return False


def _frames(pipe: io.FileIO, check: Check) -> Iterator[tuple[_Kind, bytes]]:
    """The frames as they come; they end early where the child did."""
    waiting = select.poll()
    waiting.register(pipe, select.POLLIN | select.POLLHUP)
    buffer = bytearray()
    while True:
        check()
        if not waiting.poll(_GLANCE * 1000):
            continue
        found = pipe.read(_PIPE)
        if not found:
            return
        buffer += found
        while len(buffer) >= _FRAME.size:
            kind, size = _FRAME.unpack_from(buffer)
            if len(buffer) < _FRAME.size + size:
                break
            yield _Kind(kind), bytes(buffer[_FRAME.size : _FRAME.size + size])
            del buffer[: _FRAME.size + size]
