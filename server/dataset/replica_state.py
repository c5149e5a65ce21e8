"""What a replica holds, so that only the triples that differ are sent."""

from __future__ import annotations

from rosld.server.dataset.base import Edit

_GRAPH = 64 * 1024
"""Characters of a graph that are remembered; a larger one is told whole."""
_ALL = 32 * 1024 * 1024
"""Characters of all graphs that are remembered; the longest untold goes first."""


class ReplicaState:
    """The triples of each replicated graph; valid until a request fails, then they must be forgotten."""

    def __init__(self) -> None:
        self._texts: dict[str, str] = {}
        self._size = 0

    def difference(self, graph: str, text: str) -> Edit | None:
        """The edit from a graph as it was sent last to what the text says; None where it must be sent whole.

        The text is N-Triples, each triple on a line of its own and always written the same. It is remembered.
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
        held, said = set(old), set(new)
        return Edit(
            graph, "".join(line for line in new if line not in held), "".join(line for line in old if line not in said)
        )

    def forget(self, graph: str) -> None:
        """Forget the triples of a graph, which was sent something else or is gone."""
        self._size -= len(self._texts.pop(graph, ""))

    def clear(self) -> None:
        """It is not known any more what the store holds."""
        self._texts.clear()
        self._size = 0


def _lines(text: str) -> list[str]:
    """Each with its end. Only a line feed ends one (RDF 1.1 N-Triples, 2): Python knows more."""
    return [f"{line}\n" for line in text.split("\n") if line]
