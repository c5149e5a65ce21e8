"""A worker process: does one piece of work after another, and is killed if one takes too long.

It shares with the server only a socket, which carries work and results as pickles, each after its length. A thread in
the server would not do: the RDF parser and the serializers hold the interpreter's lock while they work, and so does
freeing a million triples, for a fifth of a second.
"""

from __future__ import annotations

import gc
import os
import pickle
import resource
import signal
import socket
import struct
import sys
import traceback
from collections.abc import Callable
from contextlib import suppress
from enum import Enum
from pathlib import Path

LENGTH = struct.Struct("<Q")
"""Header of a result: its length in bytes."""
ORDER = struct.Struct("<Qd")
"""Header of work: its length in bytes, and its time limit in seconds."""
_NICENESS = 5
"""The nice increment of workers, so that moving or stopping the robot never waits for the processor."""
_LARGE = 256 * 1024 * 1024
"""Bytes of memory above which a worker ends after its work, to return the memory for certain."""
_PIECE = 1024 * 1024


class Outcome(Enum):
    """Outcome of work: its value, an expected exception, or the description of an unexpected one."""

    VALUE = "value"
    RAISED = "raised"
    FAILED = "failed"


def main() -> None:
    """Run the work received on standard input (a socket) until its end; the argument is the memory limit in bytes."""
    _take_limits(int(sys.argv[-1]))
    gc.disable()  # work is short, and its objects are freed at its end
    with socket.socket(fileno=0) as connection:
        while (order := _read(connection)) is not None:
            signal.setitimer(signal.ITIMER_REAL, order[1])
            reply = _do(order[0])
            del order
            signal.setitimer(signal.ITIMER_REAL, 0)
            connection.sendall(LENGTH.pack(len(reply)))
            connection.sendall(reply)
            del reply
            if _memory() > _LARGE:
                return
            gc.collect()


def _take_limits(memory: int) -> None:
    """Volunteer for the out-of-memory killer, and limit the memory in bytes."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    with suppress(OSError, ValueError):
        os.nice(_NICENESS)
        Path("/proc/self/oom_score_adj").write_text("1000")
        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _do(data: bytes) -> bytes:
    """Run work and return its pickled outcome."""
    outcome: tuple[Outcome, object]
    try:
        work: Callable[[], object] = pickle.loads(data)  # from the server, on a private socket
        outcome = Outcome.VALUE, work()
    except (MemoryError, OSError, ValueError, LookupError) as error:
        outcome = Outcome.RAISED, error
    except Exception as error:
        is_ours = type(error).__module__.startswith("rosld.")
        outcome = (Outcome.RAISED, error) if is_ours else (Outcome.FAILED, traceback.format_exc())
    try:
        return pickle.dumps(outcome, protocol=5)
    except Exception:
        return pickle.dumps((Outcome.FAILED, traceback.format_exc()))


def _memory() -> int:
    """Return the bytes of memory of this process, 0 if unknown."""
    with suppress(OSError, IndexError, ValueError):
        return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()
    return 0


def _read(connection: socket.socket) -> tuple[bytes, float] | None:
    """Read the next piece of work and its time limit in seconds; return None if the server has closed the socket."""
    head = _exactly(connection, ORDER.size)
    if head is None:
        return None
    size, seconds = ORDER.unpack(head)
    data = _exactly(connection, size)
    return None if data is None else (data, seconds)


def _exactly(connection: socket.socket, size: int) -> bytes | None:
    data, found = bytearray(size), 0
    while found < size:
        received = connection.recv_into(memoryview(data)[found : found + _PIECE])
        if not received:
            return None
        found += received
    return bytes(data)
