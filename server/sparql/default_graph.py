"""What of a query is matched in the default graph. Pure."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from rosld.server.dataset.shared_triples import Lookup
from rosld.server.sparql.syntax.tree import Group, Iri, Pattern, Query, Term


def default_lookups(query: Query) -> tuple[Lookup, ...]:
    """What its patterns look for in the default graph."""
    found = dict.fromkeys(map(_lookup, _patterns(query.where)))
    return (*found, Lookup()) if query.form == "DESCRIBE" else tuple(found)


def names_graphs(group: Group) -> bool:
    """Whether there is a GRAPH in a group."""
    return group.graph is not None or any(map(names_graphs, (*group.children, *group.filters)))


def _patterns(group: Group) -> Iterator[Pattern]:
    """The patterns that stand in no GRAPH. Those of filters are matched in the graph around them."""
    if group.graph is None:
        yield from group.patterns
    for child in group.children:
        yield from _patterns(child)
    for inner in group.filters:
        yield from _patterns(inner if inner.graph is not None else replace(inner, graph=group.graph))


def _lookup(pattern: Pattern) -> Lookup:
    predicates = None if pattern.predicates is None else tuple(pattern.predicates)
    if pattern.repeated:  # along several triples, the ends of which may be any
        return Lookup(None, predicates)
    return Lookup(_iri(pattern.subject), predicates, _iri(pattern.object))


def _iri(term: Term) -> str | None:
    return term.value if isinstance(term, Iri) else None
