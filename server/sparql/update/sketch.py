"""Sketching: what the commonest update makes of one graph, without a store: a few patterns, a few triples.

Who moves a robot replaces a value or two of a graph of some dozen triples. To load these into a store, to ask it and to
read it again costs more than to look through them. It comes to the very same; what might not (a store keeps numbers and
times by their values, and 01 is 1 to it) is left to the store.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import chain

from pyoxigraph import Literal, NamedNode, Triple

from rosld.ontology.vocab import xsd
from rosld.server.sparql.small import Plan, Step
from rosld.server.sparql.update.drawing import GraphChange, Row, filled
from rosld.server.sparql.update.operations import Modify
from rosld.server.store.base import Term

_MOST_ROWS = 256
_MOST_TRIPLES = 2000

_Solution = dict[str, Term]
_Index = dict[NamedNode, list[tuple[Term, Term]]]


def sketched(
    operation: Modify, plan: Plan | None, graph: str, triples: Iterable[Triple]
) -> Sequence[GraphChange] | None:
    """What an operation comes to that names no graph but this one, of which these are the triples.

    `plan` are the patterns that its WHERE consists of, all of them in this graph. None for what a store must judge.
    """
    name, templates = NamedNode(graph), (*operation.deletes, *operation.inserts)
    before = tuple(dict.fromkeys(triples))
    if len(before) > _MOST_TRIPLES or any(quad.graph != name for quad in templates):
        return None
    rows = _rows(operation, plan, before)
    if rows is None:
        return None
    holes = () if operation.where is None else operation.where.holes
    values = [dict(zip(holes, row, strict=True)) for row in rows]
    after = _after(
        before,
        [quad.triple for each in values for quad in filled(operation.deletes, each)],
        [quad.triple for each in values for quad in filled(operation.inserts, each)],
    )
    if after is None:
        return None
    return () if set(before) == set(after) else (GraphChange(graph, before, after),)


def _rows(operation: Modify, plan: Plan | None, triples: Sequence[Triple]) -> Sequence[Row] | None:
    """The terms of the holes, solution by solution."""
    if operation.where is None:
        return [()]
    found = None if plan is None else _solutions(list(chain.from_iterable(plan)), triples)
    if found is None:
        return None
    holes = operation.where.holes
    return [tuple(map(solution.get, holes)) for solution in found] if holes else [()][: len(found)]


def _solutions(steps: Sequence[Step], triples: Sequence[Triple]) -> Sequence[_Solution] | None:
    index: _Index = {}
    for triple in triples:
        index.setdefault(triple.predicate, []).append((triple.subject, triple.object))
    found: list[_Solution] = [{}]
    for step in steps:
        following = _joined(found, step, index)
        if following is None or len(following) > _MOST_ROWS:
            return None
        found = following
    return found


def _joined(solutions: Iterable[_Solution], step: Step, index: _Index) -> list[_Solution] | None:
    """The solutions that a pattern leaves, or makes; None where terms may be equal that are written differently."""
    if step.predicate is None or step.subject == "" or step.object == "=":
        return None
    found: list[_Solution] = []
    for solution in solutions:
        for pair in index.get(step.predicate, ()):
            one = {**solution}
            for slot, term in zip((step.subject, step.object), pair, strict=True):
                known = one.setdefault(slot, term) if isinstance(slot, str) else slot
                if known != term:
                    if _is_by_value(known) and _is_by_value(term):
                        return None
                    break
            else:
                found.append(one)
    return found


def _after(before: Sequence[Triple], removed: Iterable[Triple], added: Iterable[Triple]) -> tuple[Triple, ...] | None:
    """The triples when some have gone and others have come; None where it matters which literals have one value."""
    now = dict.fromkeys(before)
    for triple in removed:
        if _is_by_value(triple.object) and any(_may_be_one(triple, other) for other in before):
            return None
        now.pop(triple, None)
    for triple in added:
        if _is_by_value(triple.object) and any(_may_be_one(triple, other) for other in chain(before, now)):
            return None
        now[triple] = None
    return tuple(now)


def _is_by_value(term: object) -> bool:
    """Whether a store may keep it by its value, and give it back written in another way."""
    return isinstance(term, Literal) and term.datatype.value.startswith(xsd.iri) and term.datatype != xsd.string


def _may_be_one(triple: Triple, other: Triple) -> bool:
    """Whether a store may take two triples for one that are not, the object of the first being kept by its value."""
    if triple.predicate != other.predicate or triple.subject != other.subject or triple == other:
        return False
    mine, theirs = triple.object, other.object
    if not isinstance(mine, Literal) or not isinstance(theirs, Literal) or not _is_by_value(theirs):
        return False
    if {mine.value, theirs.value} == {"true", "false"}:
        return False
    try:
        return math.isclose(float(mine.value), float(theirs.value), rel_tol=1e-6, abs_tol=1e-40)
    except ValueError:
        return True
