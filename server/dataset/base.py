"""The contract of stores, which any SPARQL 1.1 store can implement. `tests/server/dataset` tests it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import NamedTuple, Protocol, TypeAlias

from pyoxigraph import BlankNode, Literal, NamedNode, QueryBoolean, QuerySolutions, QueryTriples, Triple

Results: TypeAlias = QuerySolutions | QueryBoolean | QueryTriples
Term: TypeAlias = NamedNode | BlankNode | Literal | Triple
Function: TypeAlias = Callable[..., Term | None]
"""A SPARQL function: from terms to a term, None being SPARQL's type error. It must not raise."""


class QueryError(ValueError):
    """The store cannot answer this query, in the words of its parser."""


class TripleChanges(NamedTuple):
    """Change that a patch, a merge or an update makes to a large graph."""

    removed: Sequence[Triple]
    added: Sequence[Triple]


class Edit(NamedTuple):
    """A change within one graph that leaves the rest of it alone: N-Triples without blank nodes.

    What is `removed` goes first, as far as it is there; then comes what is `added`.
    """

    graph: str
    added: str = ""
    removed: str = ""


class Store(Protocol):
    """A dataset of named graphs; its default graph is their union. One in memory belongs to one thread.

    Queries see the dataset as it was when `query` returned, whatever is replaced while their results are read.
    """

    @property
    def version(self) -> int:
        """A number that another one follows whenever the dataset has changed."""
        ...

    def graphs(self) -> Collection[str]:
        """The IRIs of all named graphs."""
        ...

    def replace(self, graphs: Mapping[str, str | None], edits: Sequence[Edit] = ()) -> None:
        """Replace each graph by its N-Triples, or drop it (None), then do the edits in their order: ONE transaction.

        No query ever sees some of it done and the rest not. Labels of blank nodes hold within one text. Raises
        ValueError, with nothing changed, for text that is no N-Triples or an IRI that is none.
        """
        ...

    def query(
        self,
        text: str,
        *,
        base: str | None = None,
        prefixes: Mapping[str, str] = {},
        functions: Mapping[str, Function] = {},
        default_graphs: Sequence[str] = (),
        named_graphs: Sequence[str] = (),
    ) -> Results:
        """Begin to answer a query; results come as they are read. Raises QueryError.

        `default_graphs` and `named_graphs` are the dataset (SPARQL 1.1, 13.2): with either given, only these graphs are
        there. FROM in the text has no say: who asks gives its graphs here.
        """
        ...
