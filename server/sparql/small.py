"""Queries that are small: what the store has to look at is looked at here first, and counted.

No form of a query keeps it small by itself: whoever stores data can give a resource ten thousand values of any
property. So of queries whose form is simple the links are followed as the store will follow them, in its order (it
begins where most is constant, and goes on to what is cheapest of what hangs together), up to a few hundred. What is
found to be small so takes the store no longer than this took. All else may take any time, and gets a process that can
be killed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple, TypeAlias

from pyoxigraph import BlankNode, Literal, NamedNode, Quad, Triple

from rosld.server.sparql.functions import AGE
from rosld.server.sparql.patterns import Group, Iri, Pattern, Variable

_Term: TypeAlias = NamedNode | BlankNode | Literal | Triple
Lookup: TypeAlias = Callable[[_Term | None, NamedNode | None, _Term | None, int], Sequence[Quad]]
"""At most so many statements with a subject, a predicate, an object (None: any)."""

_MOST_PATTERNS = 8
_MOST_WORDS = 96
"""Keywords, operators and brackets of a query: what may be done for each solution."""
_MOST_GRAPHS = 8
_MOST_TEXT = 1024 * 1024
"""Characters of all literals of all solutions together."""
_AGE = frozenset({AGE})
"""What looks like a pattern in an expression, and is a call that costs nothing."""
_GROWING = ("CONCAT", "REPLACE", "ENCODE_FOR_URI", "REGEX", "VALUES", "EXISTS", "OPTIONAL", "MINUS", "UNION", "SERVICE")
"""What makes more of what goes in, or looks at more than the patterns; a regular expression may take long to read."""


class Step(NamedTuple):
    """One pattern: constants, or the names of variables ("" for what binds none)."""

    subject: NamedNode | str
    predicate: NamedNode | None
    object: NamedNode | str


Plan: TypeAlias = tuple[tuple[Step, ...], ...]
"""The patterns in the order in which they are joined; those that do not hang together stand apart."""


def plan(where: Group, words: Sequence[str], steps: int, graphs: int) -> Plan | None:
    """How to find out whether a query is small; None for one that is not simple enough for it.

    `words` are the query's, in capitals; `steps` its keywords, operators and brackets, `graphs` those of its dataset.
    """
    if steps > _MOST_WORDS or graphs > _MOST_GRAPHS or any(each in word for word in words for each in _GROWING):
        return None
    patterns = list(_patterns(where))
    if None in patterns or not 0 < len(patterns) <= _MOST_PATTERNS:
        return None
    return tuple(_ordered([_step(each) for each in patterns if each is not None]))


def _patterns(group: Group) -> Iterator[Pattern | None]:
    """The patterns of a group, and of the GRAPH that may be all that is in it; None for what is no plain pattern."""
    apart = group.children and (group.patterns or len(group.children) > 1)
    asking = any(pattern.predicates != _AGE for inner in group.filters for pattern in inner.patterns)
    if group.scoped or group.mixed or group.bound or apart or asking:
        yield None
        return
    for pattern in group.patterns:
        several = pattern.predicates is not None and len(pattern.predicates) != 1
        yield None if pattern.repeated or several else pattern
    for child in group.children:
        yield from _patterns(child.group)


def _step(pattern: Pattern) -> Step:
    subject, object = pattern.subject, pattern.object
    predicate = None if pattern.predicates is None else NamedNode(next(iter(pattern.predicates)))
    return Step(
        NamedNode(subject.value) if isinstance(subject, Iri) else subject.name if isinstance(subject, Variable) else "",
        predicate,
        NamedNode(object.value) if isinstance(object, Iri) else object.name if isinstance(object, Variable) else "=",
    )


def _ordered(steps: list[Step]) -> Iterator[tuple[Step, ...]]:
    """The steps as the store joins them, greedily."""
    left = list(steps)
    while left:
        known: set[str] = set()
        together: list[Step] = []
        candidates = left
        while candidates:
            step = min(candidates, key=lambda each: _estimate(each, known))
            left.remove(step)
            together.append(step)
            known |= _names(step)
            candidates = [each for each in left if _names(each) & known]
        yield tuple(together)


def _names(step: Step) -> set[str]:
    return {each for each in (step.subject, step.object) if isinstance(each, str) and each not in _NAMELESS}


_NAMELESS = ("", "=")


def _estimate(step: Step, known: set[str]) -> int:
    """What the store takes for the number of matches, by what is known of a pattern."""
    subject = step.subject == "" or not isinstance(step.subject, str) or step.subject in known
    object = step.object == "=" or not isinstance(step.object, str) or step.object in known
    return _ESTIMATES[subject, step.predicate is not None, object]


_ESTIMATES = {
    (True, True, True): 1,
    (True, False, True): 2,
    (True, True, False): 10,
    (True, False, False): 100,
    (False, True, True): 10_000,
    (False, False, True): 100_000,
    (False, True, False): 1_000_000,
    (False, False, False): 1_000_000_000,
}


def is_anchored(found: Plan) -> bool:
    """Whether all begins at constants, so that next to nothing is looked at."""
    return all(not isinstance(together[0].subject, str) for together in found)


def is_small(found: Plan, lookup: Lookup, most: int) -> bool:
    """Whether the patterns have few matches, and all that is looked at on the way to them is at most `most`."""
    solutions, text = 1, 0
    for together in found:
        counted = _count(together, lookup, most)
        if counted is None:
            return False
        number, size = counted
        text = text * max(1, number) + size * solutions
        solutions *= max(1, number)
        if solutions > most or text > _MOST_TEXT:
            return False
    return True


def _count(steps: Sequence[Step], lookup: Lookup, most: int) -> tuple[int, int] | None:
    """The solutions of patterns that hang together, and the characters of their literals; None for too many."""
    solutions: list[dict[str, _Term]] = [{}]
    looked = size = 0
    for step in steps:
        following: list[dict[str, _Term]] = []
        for solution in solutions:
            subject = solution.get(step.subject) if isinstance(step.subject, str) else step.subject
            object = solution.get(step.object) if isinstance(step.object, str) else step.object
            if isinstance(subject, Literal):
                continue
            quads = lookup(subject, step.predicate, object, most - looked)
            looked += len(quads) + 1
            if looked >= most:
                return None
            for quad in quads:
                one = {**solution}
                if isinstance(step.subject, str):
                    one[step.subject] = quad.subject
                if isinstance(step.object, str) and step.object not in _NAMELESS:
                    one[step.object] = quad.object
                following.append(one)
                if isinstance(quad.object, Literal):
                    size += len(quad.object.value)
        solutions = following
    return len(solutions), size * max(1, len(solutions))
