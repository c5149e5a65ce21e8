"""What a query asks for, as values: triple patterns, the groups they stand in, and the paths they were written as."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

TYPE = "http://www.w3.org/1999/02/22-rdf-syntax-ns#type"


class Iri(NamedTuple):
    """A constant IRI, absolute."""

    value: str


class Variable(NamedTuple):
    """A variable, or a blank node of a pattern (which is one under another name)."""

    name: str


class Value(NamedTuple):
    """A literal; which one does not matter here."""


Term: TypeAlias = Iri | Variable | Value


class Pattern(NamedTuple):
    """A triple pattern. `predicates` are those that may match, None for any.

    `repeated`: it may match along several triples in a row, or in either direction; `empty`: along none at all.
    """

    subject: Term
    predicates: frozenset[str] | None
    object: Term
    repeated: bool = False
    empty: bool = False


@dataclass(eq=False)
class Group:
    """What must hold together: `patterns`, and variables `bound` to constants (VALUES, BIND).

    `graph` is the GRAPH it stands in; `scoped` says that nothing of what is around it narrows it (a subquery),
    `mixed` that patterns follow an assignment: the store may join these in an order of its own.
    """

    graph: Term | None = None
    scoped: bool = False
    mixed: bool = False
    patterns: list[Pattern] = field(default_factory=list)
    bound: dict[str, frozenset[str]] = field(default_factory=dict)
    children: list[Group] = field(default_factory=list)
    filters: list[Group] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Reading:
    """A query as read: its form, the group of its WHERE, its FROM and FROM NAMED, and the functions it calls.

    `constants` are the IRIs in VALUES and expressions.
    """

    form: str
    where: Group
    default: tuple[str, ...]
    named: tuple[str, ...]
    functions: frozenset[str]
    constants: frozenset[str] = frozenset()


class Step(NamedTuple):
    """A predicate in a path."""

    iri: str


class Inverse(NamedTuple):
    """`^path`."""

    path: Path


class Chain(NamedTuple):
    """`path / path`."""

    parts: tuple[Path, ...]


class Choice(NamedTuple):
    """`path | path`; no parts: a negated set, which is any predicate."""

    parts: tuple[Path, ...]


class Repeat(NamedTuple):
    """`path*`, `path+`, `path?`."""

    path: Path
    empty: bool


Path: TypeAlias = "Step | Inverse | Chain | Choice | Repeat"


def predicates(path: Path) -> frozenset[str] | None:
    """All predicates of a path, None where it may be any."""
    if isinstance(path, Step):
        return frozenset({path.iri})
    if isinstance(path, Inverse | Repeat):
        return predicates(path.path)
    found = [predicates(part) for part in path.parts]
    if not found or None in found:
        return None
    return frozenset().union(*(one for one in found if one is not None))


def may_be_empty(path: Path) -> bool:
    """Whether it leads from a node to itself."""
    if isinstance(path, Repeat):
        return path.empty or may_be_empty(path.path)
    if isinstance(path, Chain):
        return all(map(may_be_empty, path.parts))
    if isinstance(path, Choice):
        return any(map(may_be_empty, path.parts))
    return isinstance(path, Inverse) and may_be_empty(path.path)


def graphs_around(group: Group) -> frozenset[str] | None:
    """The graphs that all patterns stand in, by their names; None where one stands in any other or in none."""
    inner = group.children + group.filters
    found = [graphs_around(each) for each in inner]
    if group.patterns:
        found.append(frozenset({group.graph.value}) if isinstance(group.graph, Iri) else None)
    if None in found:
        return None
    return frozenset().union(*(each for each in found if each is not None))


def variables(group: Group) -> Iterator[Variable]:
    """The variables that people wrote in a group, wherever in it."""
    for pattern in group.patterns:
        for term in (pattern.subject, pattern.object):
            if isinstance(term, Variable) and term.name[0] not in "[_":
                yield term
    yield from map(Variable, group.bound)
    for inner in (*group.children, *group.filters):
        yield from variables(inner)
