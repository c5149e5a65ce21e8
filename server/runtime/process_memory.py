"""How much memory a process may still take, asked before something large is begun.

An allocation that fails in native code (the RDF parser, the dataset) ends the process, and so does the system where a
container's memory is used up. So what is known to need much is refused in time.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import os
import re
import resource
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

MARGIN = 48 * 1024 * 1024
"""Bytes that are never asked for: what is not asked about needs some, too."""
PER_BYTE = 56
"""Bytes that a body may take while it is read and stored, for each of its own: measured with short Turtle."""
DATASET_PER_TRIPLE = 1280
DATASET_PER_CHARACTER = 4
"""Bytes that the dataset takes for a triple, and for each of its characters, while it takes them in.

Measured with triples of 25 and of 113 characters: 1320 and 1400 for one.
"""
SENT_PER_CHARACTER = 6
"""Bytes that a character of N-Triples takes on its way to the query process: as text, pickled, and in a frame."""
PER_CHARACTER = 24
"""Bytes that a document takes for a character of its N-Triples while it is patched or rendered, measured likewise."""
CACHE_SECONDS = 0.25
"""Seconds for which what was measured is gone by, less what was asked for since."""
_MIB = 1024 * 1024
_AVAILABLE = re.compile(rb"^(?:MemAvailable|SwapFree): +(\d+) kB", re.MULTILINE)


_INACTIVE_FILE = re.compile(rb"^inactive_file (\d+)", re.MULTILINE)
"""Bytes of cached files that the kernel can drop, in `memory.stat`."""


class NotEnoughMemory(MemoryError):
    """What was asked for would need more memory than is left; nothing of it was begun."""


class Memory:
    """The memory of a process, of which `measure` returns what is left. In any thread."""

    def __init__(self, measure: Callable[[], int | None]) -> None:
        self._measure = measure
        self._until = 0.0
        self._left = 0

    def require(self, needed: int, what: str) -> None:
        """Raise NotEnoughMemory where so many bytes are not left; `what` needs them, such as `a body of 9 bytes`."""
        if needed * 4 < self._left and time.monotonic() < self._until:
            self._left -= needed
            return
        left = self._refresh()
        if left is not None and needed > left:
            trim()
            left = self._refresh()
        if left is not None and needed > left:
            sizes = f"{_mebibytes(needed)} of memory, and {_mebibytes(max(0, left))} are left"
            raise NotEnoughMemory(f"{what[0].upper()}{what[1:]} may need {sizes}; nothing was done.")
        self._left -= needed

    def _refresh(self) -> int | None:
        """The bytes that may still be taken, less the margin; None where nothing is known."""
        found = self._measure()
        left = None if found is None else found - MARGIN
        self._left = sys.maxsize if left is None else left
        self._until = time.monotonic() + CACHE_SECONDS
        return left


def available_bytes(pid: int | None = None) -> int | None:
    """The bytes that a process may still take: by its own limits, its container's, and what the machine has.

    It is this process, or a child of it.
    """
    process = Path("/proc", "self" if pid is None else str(pid))
    found = [*_of_process(process, pid or 0), *_of_machine()]
    with contextlib.suppress(OSError, ValueError):
        found += cgroup_available_bytes((process / "cgroup").read_text(), Path("/sys/fs/cgroup"))
    return min(found) if found else None


def trim() -> None:
    """Return to the system what this process has freed and its allocator still holds."""
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)


def is_out_of_memory(error: BaseException) -> bool:
    """Whether an error says that the system gave no memory: for an object, a thread, a process."""
    if isinstance(error, OSError):
        return error.errno in (errno.ENOMEM, errno.EAGAIN)
    return isinstance(error, MemoryError) or (
        isinstance(error, RuntimeError) and "can't start new thread" in str(error)
    )


def _of_process(process: Path, pid: int) -> Iterator[int]:
    """What the limit of address space leaves; 0 is this process. Elsewhere than on Linux nothing tells what is used."""
    if sys.platform != "linux":
        return
    with contextlib.suppress(OSError, ValueError, IndexError):
        limit = resource.prlimit(pid, resource.RLIMIT_AS)[0]
        if limit != resource.RLIM_INFINITY:
            pages = int((process / "statm").read_bytes().split()[0])
            yield limit - pages * os.sysconf("SC_PAGE_SIZE")


def cgroup_available_bytes(groups: str, mounted: Path) -> Iterator[int]:
    """Yield the bytes that each control group (version 2) leaves, from that of /proc/self/cgroup (`groups`) upwards."""
    path = next((line[4:] for line in groups.splitlines() if line.startswith("0::/")), None)
    if path is None:
        return
    group = mounted / path
    for folder in (group, *group.parents):
        with contextlib.suppress(OSError, ValueError):
            limit = int((folder / "memory.max").read_text())  # `max` is no limit
            used = int((folder / "memory.current").read_text())
            files = _INACTIVE_FILE.search((folder / "memory.stat").read_bytes())
            yield limit - used + (int(files[1]) if files else 0)
        if folder == mounted:
            return


def _of_machine() -> Iterator[int]:
    with contextlib.suppress(OSError):
        found = _AVAILABLE.findall(Path("/proc/meminfo").read_bytes())
        if found:
            yield sum(map(int, found)) * 1024


def _mebibytes(size: int) -> str:
    return f"{size / _MIB:.0f} MiB"


PROCESS_MEMORY = Memory(available_bytes)
"""The memory of this process."""
