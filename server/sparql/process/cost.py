"""Estimate whether a query may take long: with false positives, without false negatives.

A query that is nothing but triple patterns from constants on, along links, is followed here as the store will follow
it (it begins where most is known, and goes on to what is cheapest of what hangs together), and what is looked at is
counted. One that stands in a single small graph, by its name, meets at most every combination of what is in it. All
else may take any time.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from typing import NamedTuple, Protocol, TypeAlias

from pyoxigraph import BlankNode, Literal, NamedNode, Quad, Triple

from rosld.server.sparql.syntax.tree import Group, Iri, Pattern, Term, Variable, graphs_around

_Node: TypeAlias = NamedNode | BlankNode | Literal | Triple


class Dataset(Protocol):
    """What is stored, as far as it is looked at here."""

    def lookup(
        self, subject: _Node | None, predicate: NamedNode | None, object: _Node | None, limit: int
    ) -> Sequence[Quad]:
        """At most so many statements with a subject, a predicate, an object (None: any)."""
        ...

    def extent(self, graph: NamedNode, limit: int) -> tuple[int, int]:
        """The number of triples of a graph, at most so many, and about the characters of their literals."""
        ...


MAX_STATEMENTS = 200
"""Statements that a query may look at that does not take long."""
_MAX_TEXT = 256 * 1024
"""Characters of all literals in its solutions."""
_MAX_PATTERNS = 8
_MAX_EVALUATED = 10_000
"""Tokens of a query that does not take long, times the statements that it looks at: what it may compute for them."""
_MAX_COMBINED = 20_000
"""The same, times all combinations of the statements of a graph, of which few meet."""
_SECONDS = 0.005
"""Of work, for finding out: on a busy machine it may be waited for much longer."""
_PLAIN = frozenset(
    {"SELECT", "ASK", "WHERE", "DISTINCT", "REDUCED", "GRAPH", "LIMIT", "OFFSET", "PREFIX", "BASE", "FROM", "NAMED"}
    | {"FILTER", "IN", "NOT", "ORDER", "GROUP", "BY", "ASC", "DESC", "HAVING"}
    | {"A", "AS", "TRUE", "FALSE", "BIND", "COUNT", "SUM", "AVG", "MIN", "MAX", "SAMPLE"}
    | {"CONTAINS", "STRSTARTS", "STRENDS", "STRBEFORE", "STRAFTER", "SUBSTR", "LCASE", "UCASE", "LANGMATCHES"}
    | {"RAND", "NOW", "UUID", "STRUUID", "STR", "STRLEN", "LANG", "DATATYPE", "IF", "COALESCE", "BOUND"}
    | {"ABS", "CEIL", "FLOOR", "ROUND", "ISIRI", "ISURI", "ISBLANK", "ISLITERAL", "ISNUMERIC", "SAMETERM"}
    | {"YEAR", "MONTH", "DAY", "HOURS", "MINUTES", "SECONDS", "TIMEZONE", "TZ"}
)
"""Keywords of a query whose work is that of its patterns: nothing that changes the order in which they are joined, as
OPTIONAL and EXISTS may, and nothing that makes more of what goes in, as CONCAT and REGEX may.
"""


class PlanStep(NamedTuple):
    """A triple pattern: IRIs in angle brackets, which are pickled faster than nodes, or the names of variables."""

    subject: str
    predicate: str | None
    """None for a variable."""
    object: str | None
    """None for a literal."""

    @property
    def names(self) -> set[str]:
        """Its variables."""
        return {each for each in (self.subject, self.object) if each is not None and not _is_iri(each)}


class JoinPlan(NamedTuple):
    """Patterns in the order in which they are joined, each from a constant on, or from what those before it bind.

    Empty where one must be looked for everywhere. There are as many `patterns`; all stand in `graph`, where it is one.
    `tokens` is how many the query has.
    """

    steps: tuple[PlanStep, ...]
    patterns: int
    graph: str | None
    tokens: int


def join_plan(where: Group, words: Sequence[str], tokens: int) -> JoinPlan | None:
    """The patterns of a query of so many tokens, to be followed; None where it may take long whatever is stored.

    `words` are its keywords, in capitals.
    """
    if not _PLAIN.issuperset(words):
        return None
    steps = [*_steps(where)]
    if None in steps or not 0 < len(steps) <= _MAX_PATTERNS:
        return None
    ordered = _join_order([step for step in steps if step is not None])
    graphs = graphs_around(where) or frozenset()
    graph = next(iter(graphs)) if len(graphs) == 1 else None
    return None if ordered is None and graph is None else JoinPlan(ordered or (), len(steps), graph, tokens)


def _steps(group: Group) -> Iterator[PlanStep | None]:
    """The patterns of a group, or of the one GRAPH that is all there is in it; None for what is no plain pattern."""
    is_apart = group.children and (group.patterns or len(group.children) > 1)
    if group.scoped or group.mixed or is_apart or isinstance(group.graph, Variable):
        yield None
    else:
        yield from map(_step, group.patterns)
        for child in group.children:
            yield from _steps(child)


def _step(pattern: Pattern) -> PlanStep | None:
    subject, predicates = _slot(pattern.subject), pattern.predicates
    if pattern.repeated or pattern.empty or subject is None or len(predicates or "1") != 1:
        return None
    predicate = None if predicates is None else next(iter(predicates))
    return PlanStep(subject, predicate, _slot(pattern.object))


def _slot(term: Term) -> str | None:
    if isinstance(term, Iri):
        return f"<{term.value}>"
    return term.name or None if isinstance(term, Variable) else None


def _join_order(steps: list[PlanStep]) -> tuple[PlanStep, ...] | None:
    """The steps as the store joins them, greedily; None where it must scan for one."""
    known: set[str] = set()
    ordered: list[PlanStep] = []
    while steps:
        connected = [step for step in steps if step.names & known] or steps
        step = min(connected, key=lambda each: _ESTIMATES[_known_terms(each, known)])
        if not _is_anchored(step, known):
            return None
        steps.remove(step)
        ordered.append(step)
        known |= step.names
    return tuple(ordered)


def _is_anchored(step: PlanStep, known: set[str]) -> bool:
    subject, predicate, object = _known_terms(step, known)
    return subject or (predicate and object and step.object is not None)


def _is_iri(slot: str) -> bool:
    return slot.startswith("<")


def _known_terms(step: PlanStep, known: set[str]) -> tuple[bool, bool, bool]:
    """Whether subject, predicate and object are known when it is looked up."""
    subject = _is_iri(step.subject) or step.subject in known
    object = step.object is None or _is_iri(step.object) or step.object in known
    return subject, step.predicate is not None, object


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
"""What the store takes for the number of matches of a pattern, by what is known of it."""


def may_take_long(plan: JoinPlan | None, dataset: Dataset) -> bool:
    """Whether a query whose patterns these are may look at more than some hundred statements.

    The store walks past as much on the way to them as is walked past here: so what is found out late may take long.
    """
    if plan is None:
        return True
    if plan.graph is not None and _is_within_a_small_graph(plan, NamedNode(plan.graph), dataset):
        return False
    if not plan.steps:
        return True
    begun, until = time.thread_time(), time.perf_counter() + _SECONDS
    solutions: list[dict[str, _Node]] = [{}]
    looked = size = 0
    for step in plan.steps:
        following: list[dict[str, _Node]] = []
        predicate = None if step.predicate is None else NamedNode(step.predicate)
        fixed_subject, fixed_object = _constant(step.subject), _constant(step.object)
        for solution in solutions:
            subject = fixed_subject or solution.get(step.subject)
            object = fixed_object or (None if step.object is None else solution.get(step.object))
            if isinstance(subject, Literal):
                continue
            quads = dataset.lookup(subject, predicate, object, MAX_STATEMENTS - looked)
            looked += len(quads) + 1
            if looked >= MAX_STATEMENTS or (time.perf_counter() > until and time.thread_time() - begun > _SECONDS):
                return True
            for quad in quads:
                following.append(_bound(solution, step, quad))
                size += len(quad.object.value) if isinstance(quad.object, Literal) else 0
        solutions = following
    return size * max(1, len(solutions)) > _MAX_TEXT or looked * plan.tokens > _MAX_EVALUATED


def _is_within_a_small_graph(plan: JoinPlan, graph: NamedNode, dataset: Dataset) -> bool:
    triples, size = dataset.extent(graph, MAX_STATEMENTS)
    if triples >= MAX_STATEMENTS:
        return False
    combined = triples**plan.patterns
    return combined * plan.tokens <= _MAX_COMBINED and size * max(1, triples) <= _MAX_TEXT


def _bound(solution: dict[str, _Node], step: PlanStep, quad: Quad) -> dict[str, _Node]:
    found = {**solution}
    if not _is_iri(step.subject):
        found[step.subject] = quad.subject
    if step.object is not None and not _is_iri(step.object):
        found[step.object] = quad.object
    return found


def _constant(slot: str | None) -> NamedNode | None:
    return NamedNode(slot[1:-1]) if slot is not None and _is_iri(slot) else None
