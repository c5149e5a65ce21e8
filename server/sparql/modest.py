"""Queries that start at one place and follow links: over graphs of the server's own making, solutions are few. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rosld.ontology.vocab import ros
from rosld.server.sparql.patterns import TYPE, Group, Iri, Pattern, Variable
from rosld.server.sparql.terms import Terms

_SINGLE = frozenset(
    term.value
    for term in (ros.name, ros.messageType, ros.latest, ros.rate, ros.received, ros.sequence, ros.dateTime, ros.value)
)
_MOST_PATTERNS = 16
_MOST_BRANCHING = 2
"""Patterns with any number of values for a subject: each multiplies the solutions."""
_MOST_UNIONS = 2
"""Each doubles the solutions."""
_GROWING = ("CONCAT", "REPLACE", "ENCODE_FOR_URI", "VALUES", "SERVICE")
"""What makes more of what goes in: text that grows at each nesting, tables that multiply each other."""


def is_modest(where: Group, words: Sequence[str], terms: Terms) -> bool:
    """Whether the solutions are at most about as many as there are triples; `words` are the query's, in capitals.

    All patterns hang together as one tree: there is one variable from which every subject is reached along links, from
    subject to object; nothing is repeated along a path, there is no subquery, hardly a UNION, and no text grows.
    """
    if any(each in word for word in words for each in _GROWING) or "".join(words).count("UNION") > _MOST_UNIONS:
        return False
    groups = list(_groups(where))
    patterns = [pattern for group in groups for pattern in group.patterns]
    if any(group.scoped for group in groups[1:]) or len(patterns) > _MOST_PATTERNS:
        return False
    if any(pattern.repeated or pattern.empty for pattern in patterns):
        return False
    if sum(not _is_narrow(pattern, terms) for pattern in patterns) > _MOST_BRANCHING:
        return False
    roots = {pattern.subject.name for pattern in patterns if isinstance(pattern.subject, Variable)}
    return not roots or any(_reaches_all(root, patterns) for root in roots)


def _groups(group: Group) -> Iterator[Group]:
    """A group and all within it."""
    yield group
    for inner in (*(child.group for child in group.children), *group.filters):
        yield from _groups(inner)


def _is_narrow(pattern: Pattern, terms: Terms) -> bool:
    """Whether a subject has one value for the predicate, or a few (its types)."""
    return pattern.predicates == frozenset({TYPE}) or is_single(pattern.predicates, terms)


def _reaches_all(root: str, patterns: list[Pattern]) -> bool:
    reached, waiting = {root}, list(patterns)
    while waiting:
        left = [pattern for pattern in waiting if not _is_reached(pattern, reached)]
        if len(left) == len(waiting):
            return False
        for pattern in waiting:
            if _is_reached(pattern, reached) and isinstance(pattern.object, Variable):
                reached.add(pattern.object.name)
        waiting = left
    return True


def _is_reached(pattern: Pattern, reached: set[str]) -> bool:
    subject = pattern.subject
    return isinstance(subject, Iri) or (isinstance(subject, Variable) and subject.name in reached)


def is_single(predicates: frozenset[str] | None, terms: Terms) -> bool:
    """Whether a subject has one value at most for these predicates."""
    if predicates is None or len(predicates) != 1:
        return False
    [predicate] = predicates
    return predicate in _SINGLE or predicate.startswith(terms.types)
