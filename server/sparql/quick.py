"""Queries so small that they are answered at once, on the loop: they follow single values from constants. Pure."""

from __future__ import annotations

from rosld.ontology.vocab import ros
from rosld.server.sparql.patterns import Group, Iri, Pattern, Variable
from rosld.server.sparql.terms import Terms

_MOST = 6
_SINGLE = frozenset(
    term.value
    for term in (ros.name, ros.messageType, ros.latest, ros.rate, ros.received, ros.sequence, ros.dateTime, ros.value)
)


def is_quick(group: Group, terms: Terms) -> bool:
    """Whether the patterns of a WHERE, in the order they stand, each have few matches, found at once.

    Every subject is a constant or was the object of a pattern before, and every predicate has one value for a subject.
    """
    if group.filters or group.bound or isinstance(group.graph, Variable):
        return False
    if not group.patterns and len(group.children) == 1:
        return is_quick(group.children[0].group, terms)
    if group.children or not 0 < len(group.patterns) <= _MOST:
        return False
    reached: set[str] = set()
    return all(_follows(pattern, reached, terms) for pattern in group.patterns)


def _follows(pattern: Pattern, reached: set[str], terms: Terms) -> bool:
    """Whether the pattern begins at what is reached already; its object is reached then."""
    known = isinstance(pattern.subject, Iri) or (
        isinstance(pattern.subject, Variable) and pattern.subject.name in reached
    )
    if isinstance(pattern.object, Variable):
        reached.add(pattern.object.name)
    return known and not pattern.repeated and is_single(pattern.predicates, terms)


def is_single(predicates: frozenset[str] | None, terms: Terms) -> bool:
    """Whether a subject has one value at most for these predicates."""
    if predicates is None or len(predicates) != 1:
        return False
    [predicate] = predicates
    return predicate in _SINGLE or predicate.startswith(terms.types)
