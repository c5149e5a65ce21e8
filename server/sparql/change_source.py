"""What clients keep, as the dataset sees it: graphs that tell what changed in them since a version."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple, Protocol

from rosld.server.dataset import Edit
from rosld.server.sparql.needs import Needs


class Changes(NamedTuple):
    """A part of what changed: graphs replaced by what they say then (None: gone), after these the edits of others.

    `size` is about how many characters it comes to. What `graphs` holds is called in any thread. `reached` is the
    version up to which changes have been told with this part, as far as that is known. The graph that is `unfinished`
    goes on in the next part.
    """

    graphs: Mapping[str, Callable[[], str] | None]
    edits: Sequence[Edit]
    size: int
    reached: int = 0
    unfinished: str | None = None


class ChangeSource(Protocol):
    """Graphs that clients keep. There may be very many, few of which change at a time. Called on the loop."""

    @property
    def version(self) -> int:
        """A number that rises with each change; 0 as long as there is nothing."""
        ...

    def may_match(self, needs: Needs) -> bool:
        """Whether a query of these needs can match a triple of the graphs."""
        ...

    def last_change(self, graph: str) -> int:
        """No less than the version of the last change of a graph; 0 for one that is certainly none of these."""
        ...

    def changes(self, after: int) -> Iterator[Changes]:
        """What changed after a version, in parts that are found quickly each; the loop may have its turn in between.

        All parts together bring the graphs from that version to the one that is in force when the first is asked for,
        or to what the last has `reached`. Doing them to graphs that are newer than `after` already is no harm. An edit
        counts only where it comes after the part that replaces its graph.
        """
        ...


class _Nothing:
    """A `ChangeSource` without graphs."""

    version = 0

    def may_match(self, needs: Needs) -> bool:
        return False

    def last_change(self, graph: str) -> int:
        return 0

    def changes(self, after: int) -> Iterator[Changes]:
        return iter(())


NOTHING: ChangeSource = _Nothing()
"""Nothing is kept."""
