"""The outline of a set of triples: by subject and predicate, with lists and nested blank nodes found."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from typing import TypeAlias

from msgspec import Struct
from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from rosld.ontology.vocab import rdf

Subject: TypeAlias = NamedNode | BlankNode
Term: TypeAlias = NamedNode | BlankNode | Literal | Triple
Statements: TypeAlias = dict[NamedNode, list[Term]]

DEPTH = 16
"""Maximum depth of nested blank nodes and lists; deeper nodes are written separately, under their labels."""


class Outline(Struct, frozen=True):
    """Triples by subject and predicate, both in the order of their first appearance, without duplicates.

    `lists` has, for the head of every well-formed rdf:List that is used once, its elements; its cells are in `cells`.
    `nested` are the other blank nodes that are the object of exactly one triple.
    """

    subjects: dict[Subject, Statements]
    lists: dict[BlankNode, list[Term]]
    cells: frozenset[BlankNode]
    nested: frozenset[BlankNode]

    def cells_of(self, head: BlankNode) -> Iterator[BlankNode]:
        """Yield the cells of a list."""
        cell: Term = head
        while isinstance(cell, BlankNode):
            yield cell
            (cell,) = self.subjects[cell][rdf.rest]


def outline(triples: Iterable[Triple]) -> Outline:
    """Return the outline of `triples`. Raises ValueError for a triple term as subject, which RDF 1.2 does not allow."""
    subjects: dict[Subject, Statements] = {}
    for triple in dict.fromkeys(triples):
        subject = triple.subject
        if isinstance(subject, Triple):
            raise ValueError(f"{subject} cannot be a subject: RDF 1.2 has triple terms as objects only")
        statements = subjects.get(subject)
        if statements is None:
            statements = subjects[subject] = {}
        statements.setdefault(triple.predicate, []).append(triple.object)
    blanks = [subject for subject in subjects if isinstance(subject, BlankNode)]
    if not blanks:
        return Outline(subjects, {}, frozenset(), frozenset())
    uses = _uses(subjects)
    lists, cells = _lists(subjects, uses)
    nested = frozenset(blank for blank in blanks if uses[blank] == 1 and blank not in cells)
    return Outline(subjects, lists, cells, nested)


def _uses(subjects: dict[Subject, Statements]) -> Counter[BlankNode]:
    """Count the uses of each blank node as object; in a triple term it counts double, because it needs a label."""
    uses: Counter[BlankNode] = Counter()
    for statements in subjects.values():
        for objects in statements.values():
            for term in objects:
                if isinstance(term, BlankNode):
                    uses[term] += 1
                elif isinstance(term, Triple):
                    uses.update(dict.fromkeys(_blanks_within(term), 2))
    return uses


def _blanks_within(term: Triple) -> set[BlankNode]:
    blanks: set[BlankNode] = set()
    waiting: list[Triple] = [term]
    while waiting:
        triple = waiting.pop()
        for part in (triple.subject, triple.object):
            if isinstance(part, BlankNode):
                blanks.add(part)
            elif isinstance(part, Triple):
                waiting.append(part)
    return blanks


def _is_cell(statements: Statements) -> bool:
    """Whether these are exactly one rdf:first and one rdf:rest."""
    return (
        len(statements) == 2
        and len(statements.get(rdf.first, ())) == 1
        and len(statements.get(rdf.rest, ())) == 1
    )  # fmt: skip


def _lists(
    subjects: dict[Subject, Statements], uses: Counter[BlankNode]
) -> tuple[dict[BlankNode, list[Term]], frozenset[BlankNode]]:
    """Return the elements of each well-formed list by its head, and the cells of all of them."""
    rests = {
        subject: statements[rdf.rest][0]
        for subject, statements in subjects.items()
        if isinstance(subject, BlankNode) and uses[subject] == 1 and _is_cell(statements)
    }
    tails = {rest for rest in rests.values() if isinstance(rest, BlankNode)}
    lists: dict[BlankNode, list[Term]] = {}
    cells: set[BlankNode] = set()
    for head in rests:
        if head in tails:
            continue
        chain: list[BlankNode] = []
        cell: Term = head
        while isinstance(cell, BlankNode) and cell in rests:
            chain.append(cell)
            cell = rests[cell]
        if cell == rdf.nil:
            lists[head] = [subjects[link][rdf.first][0] for link in chain]
            cells.update(chain)
    return lists, frozenset(cells)
