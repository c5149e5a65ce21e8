"""The types that all parts of the dataset share: terms, functions, results and changes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeAlias

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
