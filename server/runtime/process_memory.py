"""Estimates of the memory available to a process, to refuse large operations in time.

An allocation that fails in native code (the RDF parser, the dataset) ends the process, and so does the kernel when a
container's memory is used up.
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
"""Bytes reserved for operations that do not check memory."""
PER_BYTE = 56
"""Bytes needed per byte of a body while it is read and stored, measured with short Turtle."""
DATASET_PER_TRIPLE = 1280
DATASET_PER_CHARACTER = 4
"""Bytes that the dataset needs to load a triple, and for each of its characters.

Measured with triples of 25 and of 113 characters: 1320 and 1400 bytes each.
"""
SENT_PER_CHARACTER = 6
"""Bytes per character of N-Triples sent to the query process: as text, pickled, and in a frame."""
PER_CHARACTER = 24
"""Bytes per character of a document's N-Triples while it is patched or rendered, measured likewise."""
CACHE_SECONDS = 0.25
"""Seconds for which a measurement is reused, reduced by the memory required since."""
_MIB = 1024 * 1024
_AVAILABLE = re.compile(rb"^(?:MemAvailable|SwapFree): +(\d+) kB", re.MULTILINE)


_INACTIVE_FILE = re.compile(rb"^inactive_file (\d+)", re.MULTILINE)
"""Bytes of cached files that the kernel can drop, in `memory.stat`."""


class NotEnoughMemory(MemoryError):
    """An operation was refused because it would need more memory than is available."""


class Memory:
    """Memory of a process; `measure` returns the available bytes. Thread-safe."""

    def __init__(self, measure: Callable[[], int | None]) -> None:
        self._measure = measure
        self._until = 0.0
        self._left = 0

    def require(self, needed: int, what: str) -> None:
        """Raise NotEnoughMemory if fewer bytes are available; `what` needs them, such as `a body of 9 bytes`."""
        if needed * 4 < self._left and time.monotonic() < self._until:
            self._left -= needed
            return
        left = self._refresh()
        if left is not None and needed > left:
            trim()
            left = self._refresh()
        if left is not None and needed > left:
            sizes = f"{_mebibytes(needed)} of memory, but {_mebibytes(max(0, left))} are left"
            raise NotEnoughMemory(f"{what[0].upper()}{what[1:]} may need {sizes}; nothing was done.")
        self._left -= needed

    def _refresh(self) -> int | None:
        """Measure the available bytes, less the margin; return None if unknown."""
        found = self._measure()
        left = None if found is None else found - MARGIN
        self._left = sys.maxsize if left is None else left
        self._until = time.monotonic() + CACHE_SECONDS
        return left


def available_bytes(pid: int | None = None) -> int | None:
    """Return the bytes available to a process by its own limits, those of its container, and the machine's memory.

    The process is this one or a child of it.
    """
    process = Path("/proc", "self" if pid is None else str(pid))
    found = [*_of_process(process, pid or 0), *_of_machine()]
    with contextlib.suppress(OSError, ValueError):
        found += cgroup_available_bytes((process / "cgroup").read_text(), Path("/sys/fs/cgroup"))
    return min(found) if found else None


def process_usage(pid: int) -> tuple[float, int]:
    """Return the CPU seconds of a process and its children, and its resident bytes; zeros if that is unknown."""
    seconds, size = 0.0, 0
    with contextlib.suppress(OSError, ValueError, IndexError):
        fields = _stat(pid)
        size = int(fields[21]) * os.sysconf("SC_PAGE_SIZE")
        ticks = sum(map(int, fields[11:15]))  # with those of ended children
        seconds = ticks / os.sysconf("SC_CLK_TCK")
        for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
            ticks += sum(map(int, _stat(int(child))[11:13]))
        seconds = ticks / os.sysconf("SC_CLK_TCK")
    return seconds, size


def _stat(pid: int) -> list[bytes]:
    """Return the fields of /proc/PID/stat after the name of the program (proc(5))."""
    return Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()


def trim() -> None:
    """Return the memory that the allocator retains to the system."""
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)


def is_out_of_memory(error: BaseException) -> bool:
    """Whether an error is a lack of memory for an object, a thread or a process."""
    if isinstance(error, OSError):
        return error.errno in (errno.ENOMEM, errno.EAGAIN)
    return isinstance(error, MemoryError) or (
        isinstance(error, RuntimeError) and "can't start new thread" in str(error)
    )


def _of_process(process: Path, pid: int) -> Iterator[int]:
    """Yield the rest of the address space limit; 0 is this process. Only Linux reports the usage."""
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
            limit = int((folder / "memory.max").read_text())  # `max`: no limit
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
"""Memory of this process."""
