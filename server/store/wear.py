"""Wear: what a store in memory still carries of what was replaced.

Oxigraph frees nothing in memory. A triple that goes stays in the lists of its graph, its subject and so on, and whoever
looks through one of these walks past it: a graph that is replaced ten thousand times takes milliseconds to look at. The
one remedy is a new store, which costs as much as all that is there.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from rosld.server.store.base import Edit

_FREE = 4000
"""Triples that a store may have without anything being worth a thought."""
_STEPS = 16
"""Steps past what is no more that take as long as renewing one triple, walked by a change and by a query after it."""
_MOST = 4
"""Triples that are no more, for each that is: what memory may be lost to them."""


class Wear:
    """Counts, roughly, in lines of N-Triples."""

    def __init__(self) -> None:
        self._sizes: dict[str, int] = {}
        self._gone: Counter[str] = Counter()
        self._size = 0
        self._lost = 0
        self._walked = 0

    @property
    def worn(self) -> bool:
        """Whether walking past what is no more has cost as much as a new store would, or it takes too much memory."""
        size = max(self._size, _FREE)
        return self._walked > _STEPS * size or self._lost > _MOST * size

    def replaced(self, graphs: Mapping[str, str | None], edits: Sequence[Edit]) -> None:
        """Take note of a change."""
        for iri, text in graphs.items():
            before, now = self._sizes.pop(iri, 0), text.count("\n") if text else 0
            if now:
                self._sizes[iri] = now
            self._size += now - before
            self._lose(iri, before)
            self._walked += self._gone[iri]
        for edit in edits:
            added, removed = edit.added.count("\n"), edit.removed.count("\n")
            self._sizes[edit.graph] = max(0, self._sizes.get(edit.graph, 0) + added - removed)
            self._size += added - removed
            self._lose(edit.graph, removed)

    def renewed(self) -> None:
        """What is no more is gone for good."""
        self._gone.clear()
        self._lost = self._walked = 0

    def _lose(self, iri: str, lines: int) -> None:
        if lines:
            self._gone[iri] += lines
            self._lost += lines
