"""Restricted datasets for agents that may not read or do everything: one per set of rights, updated when queried.

Listing the readable graphs in FROM would hide the other graphs, but not what readable graphs say about them, and would
slow down every query. A restricted dataset costs one copy of the changes for all agents with the same rights, and is
then queried like the complete one: its default graph is the union of its graphs. The query process stores it; the
filtering happens here, where the types of all resources are known.
"""

from __future__ import annotations

import asyncio
import pickle
from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping, Sequence
from itertools import islice

from pyoxigraph import RdfFormat, parse, serialize

from rosld.ontology.document import Document
from rosld.server.auth.permissions import Permissions
from rosld.server.auth.redaction import redact_document
from rosld.server.dataset import Edit
from rosld.server.sparql.process.client import QueryProcess
from rosld.server.sparql.process.work import DumpGraphs, ListGraphs
from rosld.server.sparql.query_limits import Limits

_MAX_DATASETS = 8
"""Maximum number of restricted datasets; the least recently queried one is dropped first."""
_PART = 64
"""Number of graphs fetched and filtered at a time."""


class RestrictedDatasets:
    """Restricted datasets of one query process. Belongs to one loop.

    `revision` changes whenever the types of resources may have changed.
    """

    def __init__(self, process: QueryProcess, revision: Callable[[], Hashable]) -> None:
        self._process = process
        self._revision = revision
        self._datasets: OrderedDict[str, _Restricted] = OrderedDict()
        process.on_change(self._note_changes)

    async def dataset_for(self, permissions: Permissions, limits: Limits, until: float) -> int:
        """Return the number of the dataset that agents with these permissions may see now; query it at once.

        Raises Problems.
        """
        revision = self._revision() if permissions.rights.is_typed else None
        found = self._datasets.get(permissions.rights_key)
        if found is None or found.revision != revision or found.generation != self._process.generation:
            if found is not None:
                self._drop(permissions.rights_key)
            names: list[str] = pickle.loads(await self._process.result(ListGraphs(), limits, until))
            found = self._datasets[permissions.rights_key] = _Restricted(self._process, permissions, revision, names)
            while len(self._datasets) > _MAX_DATASETS:
                self._drop(next(iter(self._datasets)))
        self._datasets.move_to_end(permissions.rights_key)
        async with found.turn:
            await found.catch_up(limits, until)
        return found.number

    def _drop(self, key: str) -> None:
        dropped = self._datasets.pop(key)
        if dropped.generation == self._process.generation:
            self._process.drop(dropped.number)

    def _note_changes(self, graphs: Mapping[str, str | None], edits: Sequence[Edit]) -> None:
        for each in self._datasets.values():
            each.behind.update(dict.fromkeys((*graphs, *(edit.graph for edit in edits))))


class _Restricted:
    """The dataset as seen with one set of rights."""

    def __init__(
        self, process: QueryProcess, permissions: Permissions, revision: Hashable, names: Sequence[str]
    ) -> None:
        self.number = process.new_dataset()
        self.generation = process.generation
        self.revision = revision
        self.turn = asyncio.Lock()
        self.behind: dict[str, None] = dict.fromkeys(names)
        self._process = process
        self._permissions = permissions

    async def catch_up(self, limits: Limits, until: float) -> None:
        """Copy all changes, including those that happen meanwhile, so that the result is of a single moment."""
        while self.behind:
            part = tuple(islice(self.behind, _PART))
            for graph in part:
                del self.behind[graph]
            readable = tuple(filter(self._permissions.may_read, part))
            texts: dict[str, str | None] = dict.fromkeys(part)
            try:
                if readable:
                    texts |= pickle.loads(await self._process.result(DumpGraphs(readable), limits, until))
                    texts = await asyncio.to_thread(self._redact_all, texts)
                self._process.change(texts, dataset=self.number)
            except BaseException:
                self.behind.update(dict.fromkeys(part))
                raise

    def _redact_all(self, texts: Mapping[str, str | None]) -> dict[str, str | None]:
        return {
            graph: None if text is None else _redact_graph(graph, text, self._permissions)
            for graph, text in texts.items()
        }


def _redact_graph(graph: str, text: str, permissions: Permissions) -> str:
    triples = tuple(quad.triple for quad in parse(text.encode(), RdfFormat.N_TRIPLES))
    left = redact_document(Document(graph, triples), permissions).triples
    if len(left) == len(triples):
        return text
    return (serialize(left, format=RdfFormat.N_TRIPLES) or b"").decode()
