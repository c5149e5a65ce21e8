"""The dataset of a query process within the process of the tests: for what is about neither processes nor time."""

from __future__ import annotations

import io
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import BinaryIO, cast

from rosld.server.dataset import Edit, MemoryStore
from rosld.server.sparql.disconnect import Disconnected
from rosld.server.sparql.process.client import QueryProcess
from rosld.server.sparql.process.work import Work
from rosld.server.sparql.query_limits import Limits


class LocalStore(MemoryStore):
    """A store to materialize graphs in, or to tell to another one."""

    generation = 0

    def __init__(self) -> None:
        super().__init__()
        self._told: list[Callable[[Collection[str], Sequence[Edit]], None]] = []

    def watch(self, changed: Callable[[Collection[str], Sequence[Edit]], None], restarted: Callable[[], None]) -> None:
        self._told.append(changed)

    def replace(self, graphs: Mapping[str, str | None], edits: Sequence[Edit] = ()) -> None:
        super().replace(graphs, edits)
        for told in self._told:
            told(graphs, edits)

    def change(self, graphs: Mapping[str, str | None], edits: Sequence[Edit] = ()) -> None:
        self.replace_valid(graphs, edits)

    async def wait_drained(self) -> None:
        pass


class LocalProcess(QueryProcess):
    """Does all work at once. Updates that ask what they have done themselves change its dataset."""

    def __init__(self) -> None:
        super().__init__(1, 1)
        self.store = LocalStore()

    async def wait_ready(self, until: float) -> None:
        pass

    def change(self, graphs: Mapping[str, str | None], edits: Sequence[Edit] = (), dataset: int = 0) -> None:
        self.store.replace_valid(graphs, edits)

    async def wait_drained(self) -> None:
        pass

    async def result(self, work: Work, limits: Limits, until: float, disconnected: Disconnected | None = None) -> bytes:
        output, store = io.BytesIO(), self.store
        if work.may_take_long(store):  # it may change the dataset, which is a fork's own
            store = LocalStore()
            store.replace({graph: self.store.ntriples(graph) for graph in self.store.graphs()})
        work(store, cast("BinaryIO", output))
        return output.getvalue()
