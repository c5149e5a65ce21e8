"""Changes that a mirror has yet to send, at most one entry per graph, and the known contents of its store."""

from __future__ import annotations

import threading
import time
from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import islice
from typing import NamedTuple, TypeAlias

from rosld.server.dataset.base import Edit

INITIAL_LIMIT = 100_000
"""Maximum number of waiting graphs beyond those in the dataset."""
_EDITS = 256 * 1024
"""Characters of edits above which the whole graph is sent instead."""
_ALL_EDITS = 8 * 1024 * 1024
"""The same limit for all graphs together."""
_GRAPH = 64 * 1024
"""Maximum characters of a remembered graph; a larger one is sent whole."""
_ALL = 32 * 1024 * 1024
"""Maximum characters of all remembered graphs; the one sent longest ago is forgotten first."""

Entry: TypeAlias = tuple[Edit, ...] | None
"""The edits of a graph in their order; None to send its content at that time, or its removal."""


class PendingBatch(NamedTuple):
    """Entries being sent, and the time (`time.monotonic`) of the oldest change among them."""

    entries: Mapping[str, Entry]
    since: float


class PendingChanges:
    """Graphs with unsent changes, in the order of their changes. Thread-safe.

    `limit` is the maximum number of waiting graphs beyond those in the dataset. Above it all are forgotten and
    `overflowed` is set: everything must be sent again.
    """

    def __init__(self, limit: int = INITIAL_LIMIT) -> None:
        self.limit = self._spare = limit
        self.overflowed = False
        self._entries: dict[str, Entry] = {}
        self._size = 0
        self.since: float | None = None
        """A lower bound of the time of the oldest waiting change; None if none waits."""
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self._entries)

    def add(self, graphs: Iterable[str], edits: Sequence[Edit] = ()) -> None:
        """Add replaced graphs, then edits."""
        with self._lock:
            for graph in graphs:
                self._put(graph, None)
            for edit in edits:
                before = self._entries.get(edit.graph, ())
                self._put(edit.graph, None if before is None else (*before, edit))
            if self._entries and self.since is None:
                self.since = time.monotonic()
            if len(self._entries) > self.limit:
                self._forget()
                self.overflowed = True

    def clear(self) -> None:
        """Forget waiting changes, because `replace_all` follows; changes in between are added as usual."""
        with self._lock:
            self._forget()
            self.overflowed = False

    def replace_all(self, graphs: Collection[str]) -> None:
        """Add all of these graphs, and raise the limit accordingly."""
        with self._lock:
            self.limit = self._spare + len(graphs)
            for graph in graphs:
                self._put(graph, None)
            if self._entries and self.since is None:
                self.since = time.monotonic()

    def take(self, limit: int) -> PendingBatch | None:
        """Remove and return the first waiting entries; None if nothing waits."""
        with self._lock:
            if not self._entries or self.since is None:
                return None
            batch = PendingBatch({graph: self._entries[graph] for graph in islice(self._entries, limit)}, self.since)
            for graph in batch.entries:
                self._size -= _size(self._entries.pop(graph))
            if not self._entries:
                self.since = None
            return batch

    def requeue(self, batch: PendingBatch) -> None:
        """Return unsent entries to the front."""
        with self._lock:
            if self.overflowed:
                return
            later = self._entries
            self._entries, self._size = {}, 0
            for graph, entry in batch.entries.items():
                self._put(graph, entry)
            for graph, entry in later.items():
                before = self._entries.get(graph, ())
                self._put(graph, None if before is None or entry is None else before + entry)
            self.since = batch.since if self.since is None else min(self.since, batch.since)

    def _put(self, graph: str, entry: Entry) -> None:
        before = self._entries.get(graph, ())
        size = _size(entry)
        if size > _EDITS or self._size - _size(before) + size > _ALL_EDITS:
            entry, size = None, 0
        self._size += size - _size(before)
        self._entries[graph] = entry

    def _forget(self) -> None:
        self._entries, self._size, self.since = {}, 0, None


def _size(entry: Entry) -> int:
    return sum(len(edit.added) + len(edit.removed) for edit in entry or ())


class ReplicaState:
    """The triples of each replicated graph; valid until a request fails, then they must be forgotten."""

    def __init__(self) -> None:
        self._texts: dict[str, str] = {}
        self._size = 0

    def difference(self, graph: str, text: str) -> Edit | None:
        """Return the edit from the last sent version of a graph to this text, None to send it whole.

        The text is remembered. It is N-Triples in a canonical form, one triple on each line.
        """
        before = self._texts.get(graph)
        self.forget(graph)
        if "_:" in text or len(text) > _GRAPH:
            return None
        self._texts[graph] = text
        self._size += len(text)
        while self._size > _ALL:
            self.forget(next(iter(self._texts)))
        if before is None:
            return None
        old, new = _lines(before), _lines(text)
        old_lines, new_lines = set(old), set(new)
        return Edit(
            graph,
            "".join(line for line in new if line not in old_lines),
            "".join(line for line in old if line not in new_lines),
        )

    def forget(self, graph: str) -> None:
        """Forget the triples of a graph that was changed otherwise or removed."""
        self._size -= len(self._texts.pop(graph, ""))

    def clear(self) -> None:
        """Forget all graphs."""
        self._texts.clear()
        self._size = 0


def _lines(text: str) -> list[str]:
    """Return the lines with their ends: only a line feed (RDF 1.1 N-Triples, 2), unlike `str.splitlines`."""
    return [f"{line}\n" for line in text.split("\n") if line]
