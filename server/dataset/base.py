"""Types shared by all parts of the dataset: terms, functions, results and changes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol, TypeAlias

from pyoxigraph import BlankNode, Literal, NamedNode, QueryBoolean, QuerySolutions, QueryTriples, Triple

Results: TypeAlias = QuerySolutions | QueryBoolean | QueryTriples
Term: TypeAlias = NamedNode | BlankNode | Literal | Triple
Function: TypeAlias = Callable[..., Term | None]
"""A SPARQL function of terms; None is SPARQL's type error. Must not raise."""


class Aggregate(Protocol):
    """Accumulator of the values of a group."""

    def accumulate(self, term: Term) -> None:
        """Add a value. Must not raise."""

    def finish(self) -> Term | None:
        """Return the result, None for an error. Must not raise."""


AggregateFunction: TypeAlias = Callable[[], Aggregate]


class QueryError(ValueError):
    """A query that the store cannot answer, with its parser's message."""


class TripleChanges(NamedTuple):
    """Change of a large graph by a patch, a merge or an update."""

    removed: Sequence[Triple]
    added: Sequence[Triple]


class Edit(NamedTuple):
    """Partial change of a graph, as N-Triples without blank nodes.

    `removed` triples are removed first, as far as they exist; then `added` ones are added.
    """

    graph: str
    added: str = ""
    removed: str = ""
