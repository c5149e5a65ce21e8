"""Where the graphs of the dataset come from: the contract of what the materializer brings into it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Iterable, Mapping, Sequence
from typing import NamedTuple, Protocol, TypeAlias

from pyoxigraph import Triple

from rosld.server.sparql.needs import Needs


class GraphEntry(NamedTuple):
    """A named graph as its source has it: `token` changes whenever `ntriples()` would (called in any thread).

    `triples` are the same as terms, where these are at hand. `is_transient`: it is in the dataset only for the query
    that names it.
    """

    iri: str
    token: Hashable
    ntriples: Callable[[], str]
    triples: Callable[[], Iterable[Triple]] | None = None
    is_transient: bool = False


class GraphSource(Protocol):
    """Where the graphs of the dataset come from. Called on the loop."""

    @property
    def revision(self) -> Hashable:
        """Of the set of description graphs: while it is the same, none of them has changed."""
        ...

    @property
    def writes(self) -> int:
        """A number that rises with each write that the server carries out on the robot, before it is answered."""
        ...

    def descriptions(self) -> Mapping[str, GraphEntry]:
        """All graphs without live values, by IRI: the computation graph, containers, types, shapes, the ontology.

        That of a topic or a parameter is there too, without its values.
        """
        ...

    async def documents_of(self, terms: Collection[str]) -> Collection[str]:
        """The resources that these classes and predicates may be said of, and that are there only where named."""
        ...

    async def live(self, needs: Needs, *, deadline: float) -> Sequence[GraphEntry]:
        """The graphs that the needs ask for, description included, with their values as of now.

        Subscribes on demand, and waits no longer than `deadline` (loop time) for first values. Whatever has been
        returned once comes again whenever it is asked for, with or without a value: what does not is taken as gone.
        A topic is asked for by `needs.wants_topic(url, types)`, a parameter by `needs.wants_parameter(url)`, any other
        document (a recorded message) by being one of `needs.documents`; `needs.graphs`, where it is not None, spares a
        walk over all topics. Where `needs.is_everything`, that is all topics subscribed to, with no new subscription.
        """
        ...


MentionedDocuments: TypeAlias = Callable[[Collection[str]], frozenset[str] | None]
"""The live documents of which clients say any of these predicates or classes, None for all: of what was synced."""


class Snapshot(NamedTuple):
    """The graphs of a source at one moment.

    `number` orders snapshots. `revision` is that of its descriptions, `described`. `entries` are the graphs with live
    values, `has_values` is whether the source was asked for these. `writes` is how many writes had ended before it was
    begun, `ended` is when it was complete (monotonic seconds). `lasting` are the extras of the last look at everything
    where that was still good enough: one for which nothing was looked at again rests on them.
    """

    number: int
    revision: Hashable
    described: Mapping[str, GraphEntry]
    has_values: bool
    entries: Sequence[GraphEntry]
    needs: Needs
    writes: int
    ended: float
    lasting: Sequence[str] = ()

    @property
    def extras(self) -> list[str]:
        """The graphs that are there only because they were named."""
        return [entry.iri for entry in self.entries if entry.is_transient or entry.iri not in self.described]

    @property
    def unnamed(self) -> list[str]:
        """Those of them that needs of everything include although no query names them."""
        return [iri for iri in self.extras if iri not in self.needs.documents]
