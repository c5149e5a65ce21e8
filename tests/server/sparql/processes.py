"""The processes of a server according to the system."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.waiting import until

# `Served` of conftest.py is the value of its fixture.
Served = Any


def children_of(pid: int) -> set[int]:
    """Return the processes that a process has started and not awaited; empty if it has ended."""
    found: set[int] = set()
    for file in Path(f"/proc/{pid}/task").glob("*/children"):
        try:
            found |= set(map(int, file.read_text().split()))
        except (FileNotFoundError, ProcessLookupError):
            continue
    return found


def command_of(pid: int) -> str:
    """Return the command line of a process; empty if it has ended."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().decode("utf-8", "replace")
    except (FileNotFoundError, ProcessLookupError):
        return ""


def is_running(pid: int) -> bool:
    """Whether a thread of a process is running or waiting for a processor."""
    states = list[str]()
    for file in Path(f"/proc/{pid}/task").glob("*/stat"):
        try:
            states.append(file.read_text().rpartition(")")[2].split()[0])
        except (FileNotFoundError, ProcessLookupError):
            continue
    return "R" in states


def query_processes(served: Served) -> set[int]:
    """Return the query process of a server, if it has one now."""
    return {pid for pid in children_of(served.process.pid) if "sparql.process" in command_of(pid)}


def until_ready(served: Served) -> Served:
    """Return the server once its dataset is ready, which may exceed a short time limit."""
    until(lambda: served.http.get("/sparql", params={"query": "ASK {}"}).status_code == 200, "queries are answered")
    return served
