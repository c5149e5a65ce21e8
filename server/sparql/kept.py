"""What clients keep, as the dataset sees it: graphs that tell what changed in them since a version."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple, Protocol

from rosld.server.store import Edit


class Changes(NamedTuple):
    """A part of what changed: graphs replaced by what they say then (None: gone), after these the edits of others.

    `size` is about how many characters it comes to. What `graphs` holds is called in any thread.
    """

    graphs: Mapping[str, Callable[[], str] | None]
    edits: Sequence[Edit]
    size: int


class KeptSource(Protocol):
    """Graphs that clients keep. There may be very many, few of which change at a time. Called on the loop."""

    @property
    def version(self) -> int:
        """A number that rises with each change; 0 as long as there is nothing."""
        ...

    def changes(self, after: int) -> Iterator[Changes]:
        """What changed after a version, in parts that are found quickly each; the loop may have its turn in between.

        All parts together bring the graphs from that version to the one that is in force when the iterator ends. Doing
        them to graphs that are newer than `after` already is no harm. An edit counts only where it comes after the part
        that replaces its graph.
        """
        ...


class _Nothing:
    version = 0

    def changes(self, after: int) -> Iterator[Changes]:
        return iter(())


NOTHING: KeptSource = _Nothing()
"""Nothing is kept."""


class Backlog:
    """Parts of changes, put together: what they come to."""

    def __init__(self) -> None:
        self.graphs: dict[str, Callable[[], str] | None] = {}
        self.size = 0
        self._edits: dict[str, list[Edit]] = {}

    @property
    def edits(self) -> list[Edit]:
        """The edits to be done after the graphs are replaced."""
        return [edit for edits in self._edits.values() for edit in edits]

    def add(self, changes: Changes) -> None:
        """What follows all that was added before."""
        self.size += changes.size
        for iri, render in changes.graphs.items():
            self.graphs[iri] = render
            self._edits.pop(iri, None)
        for edit in changes.edits:
            self._edits.setdefault(edit.graph, []).append(edit)
