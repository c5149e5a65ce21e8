"""Estimate of the memory that a store in memory still holds for removed triples.

Oxigraph frees nothing in memory. A triple that goes stays in the lists of its graph, its subject and so on, and whoever
looks through one of these walks past it: a graph that is replaced ten thousand times takes milliseconds to look at. The
one remedy is a new store, which costs as much as all that is there.
"""

from __future__ import annotations

from collections import Counter

_FREE = 4000
"""Triples that a store may have without anything being worth a thought."""
_STEPS = 32
"""Steps over removed triples (65 ns in each of two graphs) that take as long as copying one triple (4 us)."""
_MAX_GARBAGE_RATIO = 4
"""Triples that are no more, for each that is: what memory may be lost to them."""


class GarbageEstimate:
    """A rough count of what a store still holds for removed triples, in lines of N-Triples."""

    def __init__(self) -> None:
        self._sizes: dict[str, int] = {}
        self._gone: Counter[str] = Counter()
        self._size = 0
        self._lost = 0
        self._walked = 0

    @property
    def is_due(self) -> bool:
        """Whether walking past what is no more has cost as much as a new store would, or it takes too much memory."""
        size = max(self._size, _FREE)
        return self._walked > _STEPS * size or self._lost > _MAX_GARBAGE_RATIO * size

    @property
    def is_mostly_garbage(self) -> bool:
        """Whether a new store would take less than half the memory."""
        return self._lost > max(self._size, _FREE)

    def size(self, graph: str) -> int:
        """The lines of a graph."""
        return self._sizes.get(graph, 0)

    def note(self, graph: str, lost: int, gained: int) -> None:
        """So many lines of a graph went, and so many came."""
        self._sizes[graph] = max(0, self.size(graph) + gained - lost)
        if not self._sizes[graph]:
            del self._sizes[graph]
        self._size += gained - lost
        if lost:
            self._gone[graph] += lost
            self._lost += lost
            self._walked += self._gone[graph]

    def reset(self) -> None:
        """What is no more is gone for good."""
        self._gone.clear()
        self._lost = self._walked = 0
