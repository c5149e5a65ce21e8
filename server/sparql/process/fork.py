"""A fork of the query process: it does one piece of work, within limits, and writes the result to a pipe.

It has the dataset as it is at that moment, and can be killed at any. What it writes are frames: pieces of the result,
and at last how it ended. A fork that ends without saying so crashed.
"""

from __future__ import annotations

import ctypes
import fcntl
import gc
import io
import os
import pickle
import signal
import struct
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from enum import Enum
from pathlib import Path
from typing import BinaryIO, NamedTuple, NoReturn, TypeAlias, cast

FRAME_HEADER = struct.Struct("<cI")
"""What a frame begins with: what it is, and its bytes."""
_CHUNK = 64 * 1024
_PIPE = 1024 * 1024
"""Bytes that a fork may be ahead of its reader."""
_BEHIND = 5
"""How much nicer than the server it is: whoever moves or stops the robot never waits for a query's processor."""
OUT_OF_MEMORY = 86
"""How a fork exits that was refused memory."""
_MAX_WORDS = 4096
_PR_SET_PDEATHSIG = 1

Task: TypeAlias = Callable[[BinaryIO], None]


class FrameKind(Enum):
    """What a frame is: bytes of the result, its end, a pickled exception."""

    DATA = b"d"
    END = b"e"
    RAISED = b"r"


class ExitStatus(NamedTuple):
    """How a fork ended: its status as `os.waitpid` has it, and what native code said last, if anything."""

    status: int
    words: str


class Fork:
    """A fork at work: its process, and the ends of the pipes that its result and its stderr are read from."""

    def __init__(self, do: Task, seconds: float, memory: int) -> None:
        """Begin. Raises OSError where there can be no further process."""
        self.reading, writing = os.pipe()
        self._words, words = os.pipe()
        with suppress(OSError, AttributeError):  # an ordinary pipe does as well
            fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, _PIPE)
        parent = os.getpid()
        try:
            self.pid = os.fork()
        except OSError:
            for descriptor in (self.reading, self._words, writing, words):
                os.close(descriptor)
            raise
        if self.pid == 0:
            os.dup2(words, 2)
            _live(do, writing, seconds, memory, parent)
        os.close(writing)
        os.close(words)

    def reap(self) -> ExitStatus | None:
        """How it ended; None while it is at work."""
        pid, status = os.waitpid(self.pid, os.WNOHANG)
        if not pid:
            return None
        words = os.read(self._words, _MAX_WORDS)
        os.close(self._words)
        return ExitStatus(status, words.decode("utf-8", "replace"))


# --- in the fork


def _live(do: Task, writing: int, seconds: float, memory: int, parent: int) -> NoReturn:
    """Its whole life. It shares nothing that it could harm."""
    codes: list[int] = []
    try:
        gc.disable()
        _be_alone(writing, parent)
        _take_limits(seconds, memory)
        # The store draws what is random from a state of each thread: a new thread's is seeded anew, a fork's is not.
        thread = threading.Thread(target=lambda: codes.append(_work(do, writing)))
        thread.start()
        thread.join()
    except (MemoryError, RuntimeError):  # there can be no thread
        codes.append(OUT_OF_MEMORY)
    finally:
        os._exit(codes[0] if codes else 1)


def _work(do: Task, writing: int) -> int:
    """Do it; how to exit."""
    try:
        frames = _Frames(writing)
        try:
            do(cast("BinaryIO", frames))
            frames.flush()
        except (MemoryError, BrokenPipeError):
            raise
        except Exception as error:
            frames.send(FrameKind.RAISED, pickle_error(error))
        else:
            frames.send(FrameKind.END, b"")
    except MemoryError:
        return OUT_OF_MEMORY
    except BaseException:
        return 1
    return 0


def pickle_error(error: Exception) -> bytes:
    """An exception as bytes, without where it came from; one that cannot be, in words."""
    bare = error.with_traceback(None)
    bare.__cause__ = bare.__context__ = None
    try:
        data = pickle.dumps(bare, protocol=5)
        pickle.loads(data)
    except Exception:
        return pickle.dumps(RuntimeError(f"{type(error).__name__}: {error}"))
    return data


def _be_alone(writing: int, parent: int) -> None:
    """Let go of every socket and file, and end with the parent."""
    import resource

    signal.set_wakeup_fd(-1)
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGQUIT, signal.SIGCHLD, signal.SIGALRM):
        signal.signal(number, signal.SIG_DFL)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:
            os._exit(1)
    os.closerange(3, writing)
    os.closerange(writing + 1, resource.getrlimit(resource.RLIMIT_NOFILE)[0])
    os.dup2(os.open(os.devnull, os.O_RDWR), 0)


def _take_limits(seconds: float, memory: int) -> None:
    import resource

    signal.setitimer(signal.ITIMER_REAL, seconds + 1)
    os.nice(_BEHIND)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with suppress(OSError, ValueError):
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        limit, hard = pages * resource.getpagesize() + memory, resource.getrlimit(resource.RLIMIT_AS)[1]
        if hard != resource.RLIM_INFINITY:
            limit = min(limit, hard)
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


class _Frames(io.RawIOBase):
    """Writes frames, small writes joined."""

    def __init__(self, descriptor: int) -> None:
        super().__init__()
        self._descriptor = descriptor
        self._buffer = bytearray()

    def writable(self) -> bool:
        return True

    def write(self, data: bytes) -> int:  # type: ignore[override]
        """Take bytes of the result."""
        self._buffer += data
        if len(self._buffer) >= _CHUNK:
            self.flush()
        return len(data)

    def flush(self) -> None:
        """Send what was taken."""
        if self._buffer:
            self.send(FrameKind.DATA, bytes(self._buffer))
            self._buffer.clear()

    def send(self, kind: FrameKind, data: bytes) -> None:
        """Send one frame."""
        view = memoryview(FRAME_HEADER.pack(kind.value, len(data)) + data)
        while view:
            view = view[os.write(self._descriptor, view) :]
