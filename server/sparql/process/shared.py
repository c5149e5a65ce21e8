"""A query process that several robots share, each with datasets of its own, and the union of these datasets."""

from __future__ import annotations

import asyncio
import contextlib
import pickle
from collections.abc import Mapping, Sequence
from itertools import islice

from rosld.server.dataset.base import Edit
from rosld.server.http.problem import Problem
from rosld.server.sparql.process.client import QueryProcess
from rosld.server.sparql.process.work import DumpGraphs, ListGraphs
from rosld.server.sparql.query_limits import Limits

_PART = 256
"""Number of graphs copied at a time."""


class RobotProcess(QueryProcess):
    """The shared process as one robot sees it, whose datasets are empty at first.

    A process costs 150 MB, a robot's datasets in a shared one some megabytes.
    """

    def __init__(self, shared: QueryProcess) -> None:
        super().__init__(0, 0)
        self._shared = shared
        self._pool, self._ready, self._datasets = shared._pool, shared._ready, shared._datasets
        self._numbers: set[int] = set()
        self._first = self.new_dataset()
        self._watch = contextlib.ExitStack()

    async def start(self) -> None:
        """Use the shared process, which runs."""
        self._loop = asyncio.get_running_loop()
        self._watch.callback(self._shared.starts.watch(self._note_start).close)
        self._note_start()

    def _note_start(self) -> None:
        self.generation += 1
        self.starts.emit()

    async def close(self) -> None:
        """Discard the datasets. Idempotent."""
        self._watch.close()
        while self._numbers:
            self.drop(next(iter(self._numbers)))

    def new_dataset(self) -> int:
        self._numbers.add(number := super().new_dataset())
        return number

    def drop(self, dataset: int) -> None:
        self._numbers.discard(dataset)
        super().drop(dataset)


class UnionCopy:
    """Copy of a robot's dataset in the first dataset of the shared process, updated when that is queried.

    Only graphs below the robot's base are copied, so that robots never replace each other's graphs.
    """

    def __init__(self, shared: QueryProcess, own: RobotProcess, base: str) -> None:
        self._shared = shared
        self._own = own
        self._base = base
        self._turn = asyncio.Lock()
        self._generation = -1
        self._behind: dict[str, None] = {}
        self._copied: set[str] = set()
        own.on_change(self._note_changes)

    def _note_changes(self, graphs: Mapping[str, str | None], edits: Sequence[Edit]) -> None:
        if self._generation == self._own.generation:
            self._behind.update(dict.fromkeys((*graphs, *(edit.graph for edit in edits))))

    async def catch_up(self, limits: Limits, until: float) -> None:
        """Copy what has changed since the last query. Raises Problems."""
        async with self._turn:
            if self._generation != self._own.generation:
                self._generation, self._copied = self._own.generation, set()
                self._behind = dict.fromkeys(pickle.loads(await self._own.result(ListGraphs(), limits, until)))
            while self._behind:
                part = list(islice(self._behind, _PART))
                for graph in part:
                    del self._behind[graph]
                ours = tuple(graph for graph in part if graph.startswith(self._base))
                try:
                    if ours:
                        self._shared.change(pickle.loads(await self._own.result(DumpGraphs(ours), limits, until)))
                        self._copied.update(ours)
                except BaseException:
                    self._behind.update(dict.fromkeys(part))
                    raise

    def remove(self) -> None:
        """Remove the copy."""
        with contextlib.suppress(Problem):  # a process that restarts has no copy
            self._shared.change(dict.fromkeys(self._copied))
