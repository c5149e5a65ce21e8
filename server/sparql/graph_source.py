"""Where the graphs of the dataset come from: the contract of what the materializer brings into it."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from rosld.server.auth.permissions import Permissions
from rosld.server.rest.resource import Resource
from rosld.server.sparql.needs import Needs


class GraphEntry(NamedTuple):
    """A named graph as its source has it: `token` changes whenever `ntriples()` would (called in any thread)."""

    iri: str
    token: Hashable
    ntriples: Callable[[], str]


class LiveDocument(NamedTuple):
    """A document whose values a query can match.

    `is_named` by its IRI, its type or a predicate: then its values are of now. Unless it `subscribes`, it has those
    values alone that are at hand. `members` are the properties of a complex resource that are read, None for all.
    """

    url: str
    resource: Resource
    is_named: bool = False
    subscribes: bool = True
    members: frozenset[str] | None = None


@dataclass(frozen=True, slots=True)
class LiveGraphs:
    """Documents with their values, by URL, None for those that are not there; and why others could not be read."""

    entries: dict[str, GraphEntry | None]
    unread: dict[str, str]


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
        """Return all graphs, by IRI, without values."""
        ...

    async def prepare(self, needs: Needs) -> None:
        """Have everything described that the needs name."""
        ...

    def wanted(self, needs: Needs, permissions: Permissions) -> Sequence[LiveDocument]:
        """Return the documents whose values the needs can match, as far as they may be read."""
        ...

    async def read(self, documents: Sequence[LiveDocument], *, deadline: float) -> LiveGraphs:
        """Return documents with their values as of now, waiting for first ones until `deadline` (loop time) at most."""
        ...
