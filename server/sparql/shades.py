"""Shades: the dataset as those see it who may not read all of it. Each is a store of its own, kept up as it is asked.

An explicit dataset of the graphs that may be read would hide these graphs, but not what other graphs say of them, and
costs every query anew. A shade costs a copy of what changed, once for all agents of the same rights, and is then asked
as the dataset itself is: its default graph is the plain union of its graphs.
"""

from __future__ import annotations

import asyncio
import threading
from collections import OrderedDict
from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from itertools import islice

from pyoxigraph import RdfFormat, parse, serialize

from rosld.ontology.document import Document
from rosld.server.access.judge import Judge
from rosld.server.access.veil import veiled
from rosld.server.store import Edit, MemoryStore

_MOST = 8
"""Shades at a time; the one that was asked longest ago goes first."""

_PART = 64
"""Graphs that are looked at while nothing changes."""


class Shades:
    """The shades of one store. Belongs to one loop; `revision` changes whenever what has which type may have."""

    def __init__(self, store: MemoryStore, revision: Callable[[], Hashable]) -> None:
        self._store = store
        self._revision = revision
        self._kept: OrderedDict[str, _Shade] = OrderedDict()
        self._watched = False

    async def of(self, judge: Judge) -> MemoryStore:
        """The dataset as the judge lets it be seen, of now."""
        if not self._watched:
            self._watched = True
            self._store.watch(self._told)
        shade = self._kept.get(judge.key)
        revision = self._revision() if judge.rights.is_typed else None
        if shade is None or shade.revision != revision:
            shade = self._kept[judge.key] = _Shade(self._store, judge, revision)
            if len(self._kept) > _MOST:
                self._kept.popitem(last=False)
        self._kept.move_to_end(judge.key)
        async with shade.turn:
            if shade.is_behind:
                await asyncio.to_thread(shade.catch_up)
        return shade.store

    def _told(self, graphs: Collection[str], edits: Sequence[Edit]) -> None:
        """The store has changed; in any thread."""
        changed = {*graphs, *(edit.graph for edit in edits)}
        for shade in tuple(self._kept.values()):
            shade.note(changed)


class _Shade:
    """The dataset as one set of rights lets it be seen."""

    def __init__(self, store: MemoryStore, judge: Judge, revision: Hashable) -> None:
        self.store = MemoryStore()
        self.revision = revision
        self.turn = asyncio.Lock()
        self._whole = store
        self._judge = judge
        self._lock = threading.Lock()
        self._behind: set[str] = set(store.graphs())
        self._is_new = True

    @property
    def is_behind(self) -> bool:
        """Whether something has changed that is not here."""
        return bool(self._behind)

    def note(self, changed: Collection[str]) -> None:
        """These graphs have changed."""
        with self._lock:
            self._behind |= set(changed)

    def catch_up(self) -> None:
        """Bring here what has changed, all of one moment. Runs in a thread.

        What is new comes part by part first, while nobody asks it yet, so that nobody else is held up.
        """
        while self._is_new and len(self._behind) > _PART:
            self.store.replace(self._seen(self._texts(_PART)))
        self._is_new = False
        with self._whole.still():
            texts = self._texts(None)
        self.store.replace(self._seen(texts))

    def _texts(self, most: int | None) -> dict[str, str | None]:
        """At most so many graphs that have changed, as they are now: None for those that are not there to be seen."""
        with self._lock:
            part = set(islice(self._behind, most))
            self._behind -= part
        return {graph: self._whole.ntriples(graph) if self._judge.may_read(graph) else None for graph in part}

    def _seen(self, texts: Mapping[str, str | None]) -> dict[str, str | None]:
        return {graph: None if text is None else _veiled(graph, text, self._judge) for graph, text in texts.items()}


def _veiled(graph: str, text: str, judge: Judge) -> str:
    """The N-Triples of a graph as they may be read."""
    triples = tuple(quad.triple for quad in parse(text.encode(), RdfFormat.N_TRIPLES))
    left = veiled(Document(graph, triples), judge).triples
    if len(left) == len(triples):
        return text
    return (serialize(left, format=RdfFormat.N_TRIPLES) or b"").decode()
