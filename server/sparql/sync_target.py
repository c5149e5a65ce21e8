"""Where the graphs of the dataset go: the contract of the query process, and what is known to be in it."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from typing import NamedTuple, Protocol

from rosld.server.dataset import Edit
from rosld.server.sparql.query_limits import process_restarting


class SyncTarget(Protocol):
    """Where the graphs go: what was sent is seen by all that is asked afterwards. Called on the loop."""

    @property
    def generation(self) -> int:
        """Another number whenever it holds nothing any more."""
        ...

    async def wait_drained(self) -> None:
        """Return when little is on its way that was not taken yet."""
        ...

    def change(self, graphs: Mapping[str, str | None], edits: Sequence[Edit] = ()) -> None:
        """Replace graphs, then do edits, as `MemoryStore.replace`. Raises Problem 503 and NotEnoughMemory."""
        ...


class HeldGraph(NamedTuple):
    """A graph as the target holds it.

    `token` is its own, `description` that of its description then, None for a graph without one. `number` is that of
    the reading it is of, `size` is in characters of N-Triples.
    """

    token: Hashable
    description: Hashable
    has_values: bool
    number: int
    size: int


class TargetState:
    """What the target holds, by what it was sent since its start: nothing again once it has started anew."""

    def __init__(self, target: SyncTarget, stores: int) -> None:
        self._target = target
        self._stores = stores
        self._forget()

    def _forget(self) -> None:
        self.versions = [0] * self._stores
        """The versions of what clients keep, by its place among the sources."""
        self.ahead: dict[str, int] = {}
        """Graphs that clients keep which are newer than these versions."""
        self.held: dict[str, HeldGraph] = {}
        """The graphs that come from the `GraphSource`."""
        self.live: set[str] = set()
        """Those of them that have values which change by themselves."""
        self.transient: set[str] = set()
        """Those of them that are there for the queries that name them."""
        self.descriptions: Hashable = object()
        """The revision of the descriptions that it holds."""
        self.generation = self._target.generation
        """That of the target to which all this belongs; the last to be set, for those who look from another thread."""

    @property
    def is_outdated(self) -> bool:
        """Whether the target has started anew, and holds nothing of this."""
        return self.generation != self._target.generation

    def follow_restart(self) -> bool:
        """Hold nothing where the target has started anew; whether it has."""
        is_new = self.is_outdated
        if is_new:
            self._forget()
        return is_new

    def require(self, generation: int) -> None:
        """Raise Problem 503 where the target holds nothing any more that it was sent in this generation."""
        if not generation == self.generation == self._target.generation:
            raise process_restarting(1)
