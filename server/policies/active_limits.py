"""Active limits: those of the robot and the settings, and those that clients store under `/shapes/`."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Iterator, Sequence

from pyoxigraph import RdfFormat, Triple, parse

from rosld.adapters.base import Adapter
from rosld.ontology.urls import Space
from rosld.server.settings import Settings
from rosld.server.storage.record_documents import unpack_triples
from rosld.server.storage.sqlite import Records
from rosld.shapes.limits import Limits, read_limits

ROUTE = "shapes/"
MAX_TRIPLES = 5000
"""Maximum number of triples of a stored document: each change validates all documents again."""
_log = logging.getLogger("rosld")


class ActiveLimits:
    """The limits of all documents together. Every change is atomic."""

    def __init__(self, initial: Sequence[Sequence[Triple]], space: Space) -> None:
        self.current = Limits.from_graphs(initial, space)
        """All limits; each change replaces this object."""
        self.lock = asyncio.Lock()
        """Lock held while a write is validated and applied."""
        self._given = tuple(initial)
        self._stored: dict[str, tuple[Triple, ...]] = {}
        self._space = space

    def check(self, url: str, triples: bytes) -> tuple[Triple, ...]:
        """Return the shapes graph of a document for a URL, given as N-Triples.

        Raises ValueError with a sentence if it is invalid, alone or together with the others.
        """
        graph = tuple(quad.triple for quad in parse(triples, RdfFormat.N_TRIPLES))
        if len(graph) > MAX_TRIPLES:
            raise ValueError(f"it has {len(graph)} triples, but the limit is {MAX_TRIPLES}: split it")
        try:
            if not Limits.from_graphs([graph], self._space):
                raise ValueError("it limits nothing: it has no shape with a sh:targetNode or a sh:targetClass")
            Limits.from_graphs(self._with(url, graph), self._space)
        except RecursionError as error:
            raise ValueError("its shapes are nested too deeply") from error
        return graph

    def replace(self, url: str, graph: tuple[Triple, ...]) -> None:
        """Activate a checked document, replacing that of the same URL."""
        self._stored[url] = graph
        self.current = Limits.from_graphs(self._with(), self._space)

    def remove(self, url: str) -> None:
        """Deactivate the document of this URL, if any."""
        if self._stored.pop(url, None) is not None:
            self.current = Limits.from_graphs(self._with(), self._space)

    def load_stored(self, records: Records) -> None:
        """Activate the documents stored by an earlier run. Invalid ones are logged and skipped."""
        last = 0
        while found := records.members(ROUTE, after=last):
            last = found[-1].number
            for member in found:
                record, url = records.get(member.path), self._space.base + member.path
                if record is None or record.model.is_container:
                    continue
                try:
                    self.replace(url, self.check(url, unpack_triples(record.triples)))
                except ValueError as error:
                    _log.error("The limits %s are stored but not in force: %s", url, error)

    def _with(self, url: str = "", graph: tuple[Triple, ...] = ()) -> list[Sequence[Triple]]:
        stored = {**self._stored, url: graph} if url else self._stored
        return [*self._given, *stored.values()]


def initial_limits(settings: Settings, adapter: Adapter, space: Space) -> Iterator[tuple[Triple, ...]]:
    """Yield the initial limits: the robot's own, and those of the settings. Raises ValueError with the file's name."""
    shipped = adapter.capabilities.limits
    for path in (*((shipped,) if shipped is not None else ()), *settings.shapes):
        try:
            graph = read_limits(path.read_bytes(), space.base, space.shape("limits"))
            Limits.from_graphs([graph], space)
        except ValueError as error:
            raise ValueError(f"{path} does not contain valid limits: {error}") from error
        yield graph
