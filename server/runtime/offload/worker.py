"""A worker process: does one piece of work after the other, and is killed where one takes too long.

It shares nothing with the server but a socket, on which work and results go to and fro as pickles, each after its
length. A thread in the server would not do: the RDF parser and the serialisers hold the interpreter's lock for as long
as they work, and freeing a million triples does for a fifth of a second.
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
"""How much nicer than the server a worker is: whoever moves or stops the robot never waits for its processor."""
_LARGE = 256 * 1024 * 1024
"""Bytes of memory beyond which a worker ends after its work: what it took is given back for certain."""
_PIECE = 1024 * 1024


class Outcome(Enum):
    """What became of work: its value, an exception that it raised on purpose, or one that nobody foresaw, in words."""

    VALUE = "value"
    RAISED = "raised"
    FAILED = "failed"


def main() -> None:
    """Do what comes on the socket that is standard input, until it ends. The argument is the bytes of memory."""
    _take_limits(int(sys.argv[-1]))
    gc.disable()  # work is short, and what it made is freed at its end
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
    """Be the first to be ended where the machine is short of memory, and take no more than so many bytes."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    with suppress(OSError, ValueError):
        os.nice(_NICENESS)
        Path("/proc/self/oom_score_adj").write_text("1000")
        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _do(data: bytes) -> bytes:
    """Do work: its outcome, pickled."""
    outcome: tuple[Outcome, object]
    try:
        work: Callable[[], object] = pickle.loads(data)  # from the server, on a socket that nobody else has
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
    """The bytes of memory that this process has now; 0 where that cannot be told."""
    with suppress(OSError, IndexError, ValueError):
        return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()
    return 0


def _read(connection: socket.socket) -> tuple[bytes, float] | None:
    """The next piece of work and the seconds it may take; None where the server has gone."""
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
