"""Syntax tree of a query: triple patterns in their groups, paths, and expressions with their positions."""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum
from typing import NamedTuple, TypeAlias

from msgspec import Struct, field
from pyoxigraph import Literal

from rosld.ontology.vocab import rdf, ros
from rosld.server.sparql.syntax.token import Kind, Token

TYPE = rdf.type.value


# --- terms and patterns


class Iri(NamedTuple):
    """An absolute IRI."""

    value: str


class Variable(NamedTuple):
    """A variable, or a blank node (`_:label`, or `[n]` without a label), which acts as a variable in a pattern."""

    name: str

    @property
    def is_blank(self) -> bool:
        """Whether it was written as a blank node."""
        return self.name.startswith(("_:", "["))


class Value(NamedTuple):
    literal: Literal


Term: TypeAlias = Iri | Variable | Value


class Pattern(NamedTuple):
    """A triple pattern. `predicates` are those that may match, None for any; `verb` is a variable predicate.

    `repeated`: it may match along several consecutive triples, in either direction, or in several ways; `empty`: along
    none at all.
    """

    subject: Term
    predicates: frozenset[str] | None
    object: Term
    repeated: bool = False
    empty: bool = False
    verb: Variable | None = None


class WrittenChain(NamedTuple):
    """A path of plain predicates, `first/second/third`, with their positions, its end, and the pattern of each."""

    starts: tuple[int, ...]
    end: int
    steps: tuple[str, ...]
    patterns: tuple[Pattern, ...]


class Group(Struct, eq=False):
    """A group graph pattern.

    `graph` is the enclosing GRAPH; `scoped`: nothing outside narrows it (a subquery); `assigned`: it has a BIND;
    `mixed`: patterns follow a BIND, or the BIND is of a constant: the store may join these in its own order. `filters`
    are groups of EXISTS, `visible` the variables in scope after the group (18.2.1).

    `tests` are the expressions of its FILTERs, `bindings` those of its BINDs, `data` the possible values of variables
    by VALUES (None: any), `chains` its paths of plain predicates. `joined`: its solutions are joined with those around
    it; an `alternative` (UNION) is joined together with the other alternatives; OPTIONAL and MINUS are neither. `given`
    are the variables bound before it by patterns, or to recorded messages.
    """

    graph: Term | None = None
    scoped: bool = False
    assigned: bool = False
    mixed: bool = False
    patterns: list[Pattern] = field(default_factory=list)
    children: list[Group] = field(default_factory=list)
    filters: list[Group] = field(default_factory=list)
    visible: set[str] = field(default_factory=set)
    tests: list[Operand] = field(default_factory=list)
    bindings: list[tuple[str, Operand]] = field(default_factory=list)
    data: list[tuple[str, frozenset[Iri | Value] | None]] = field(default_factory=list)
    chains: list[WrittenChain] = field(default_factory=list)
    joined: bool = False
    alternative: bool = False
    given: frozenset[str] = frozenset()


def graphs_around(group: Group) -> frozenset[str] | None:
    """Return the names of the graphs around all patterns, None if a pattern is in a variable graph or in none."""
    inner = group.children + group.filters
    found = [graphs_around(each) for each in inner]
    if group.patterns:
        found.append(frozenset({group.graph.value}) if isinstance(group.graph, Iri) else None)
    if None in found:
        return None
    return frozenset().union(*(each for each in found if each is not None))


# --- paths


class PathStep(NamedTuple):
    """A predicate in a path."""

    iri: str


class Inverse(NamedTuple):
    """`^path`."""

    path: Path


class Chain(NamedTuple):
    """`path / path`, the positions of its parts in the text, and its end."""

    parts: tuple[Path, ...]
    starts: tuple[int, ...] = ()
    end: int = 0


class Choice(NamedTuple):
    """`path | path`; without parts a negated property set, which may match any predicate."""

    parts: tuple[Path, ...]


class Repeat(NamedTuple):
    """`path*`, `path+`, `path?`."""

    path: Path
    empty: bool


Path: TypeAlias = "PathStep | Inverse | Chain | Choice | Repeat"


def path_predicates(path: Path) -> frozenset[str] | None:
    """Return all predicates of a path, None if it may match any."""
    if isinstance(path, PathStep):
        return frozenset({path.iri})
    if isinstance(path, Inverse | Repeat):
        return path_predicates(path.path)
    found = [path_predicates(part) for part in path.parts]
    if not found or None in found:
        return None
    return frozenset().union(*(one for one in found if one is not None))


def may_be_empty(path: Path) -> bool:
    """Whether a path may have length zero."""
    if isinstance(path, Repeat):
        return path.empty or may_be_empty(path.path)
    if isinstance(path, Chain):
        return all(map(may_be_empty, path.parts))
    if isinstance(path, Choice):
        return any(map(may_be_empty, path.parts))
    return isinstance(path, Inverse) and may_be_empty(path.path)


# --- expressions, each with its start and end in the text


class Reference(NamedTuple):
    """A variable in an expression; `name` includes its mark."""

    start: int
    end: int
    name: str


class Constant(NamedTuple):
    """An IRI or a literal. `kind` is the kind of its first token, NUMBER also for a string with a datatype."""

    start: int
    end: int
    kind: Kind
    term: Iri | Value


class Expression(NamedTuple):
    """The content of brackets or of an argument: operands, and the operators before and between them."""

    start: int
    end: int
    parts: tuple[Part, ...]


class Call(NamedTuple):
    """A function call, by keyword (`name`, in capitals) or by `iri` (else ""); its name ends at `name_end`."""

    start: int
    end: int
    name: str
    name_end: int
    arguments: tuple[Expression, ...]
    iri: str = ""


class Choices(NamedTuple):
    """The list after IN."""

    start: int
    end: int
    items: tuple[Expression, ...]


class Exists(NamedTuple):
    """EXISTS or NOT EXISTS; its group is in `filters` of the enclosing group."""

    start: int
    end: int


Operand: TypeAlias = "Reference | Constant | Expression | Call | Choices | Exists"
Part: TypeAlias = "Operand | str"


class ExpressionPurpose(Enum):
    """Purpose of an expression."""

    TERM = "a term, which is passed on"
    TEST = "whether it holds: an error is as good as false"
    ORDER = "a place among the solutions"


class EvaluatedExpression(NamedTuple):
    """An expression evaluated for solutions; one of ORDER BY begins at `start`, with its `direction`."""

    operand: Operand
    purpose: ExpressionPurpose
    start: int = 0
    direction: str = "ASC"


def strip_brackets(operand: Operand) -> Operand:
    """Return the content of brackets that contain a single operand."""
    while isinstance(operand, Expression) and len(operand.parts) == 1 and not isinstance(operand.parts[0], str):
        operand = operand.parts[0]
    return operand


def message_call(operand: Operand) -> Call | None:
    """Return the call of `ros:asOf` or `ros:previous` that an operand is, None for anything else."""
    within = strip_brackets(operand)
    return within if isinstance(within, Call) and within.iri in (ros.asOf.value, ros.previous.value) else None


def parts_of(operand: Operand) -> Iterator[Operand]:
    """Yield the operands directly within an operand."""
    if isinstance(operand, Expression):
        yield from (part for part in operand.parts if not isinstance(part, str))
    elif isinstance(operand, Call):
        yield from operand.arguments
    elif isinstance(operand, Choices):
        yield from operand.items


def variables_in(operand: Operand) -> frozenset[str] | None:
    """Return the variables of an expression, None if it has an EXISTS."""
    if isinstance(operand, Reference):
        return frozenset({operand.name[1:]})
    found = [frozenset[str](), *map(variables_in, parts_of(operand))]
    if isinstance(operand, Exists) or None in found:
        return None
    return frozenset().union(*(each for each in found if each is not None))


# --- queries


class Slice(NamedTuple):
    """The solutions that LIMIT and OFFSET select: `limit` of them after `offset`.

    `first` is the first expression of ORDER BY, None without one.
    """

    limit: int
    offset: int
    first: Operand | None
    is_descending: bool


class Query(Struct, frozen=True):
    """A query: its form, the group of its WHERE, its FROM (`default`) and FROM NAMED, and the functions it calls.

    `constants` are the IRIs in VALUES and expressions. `literals` are those in patterns, templates and VALUES; they and
    `expressions` exclude SERVICE. `slice` is set for a SELECT with LIMIT that has no grouping and no aggregates. The
    form begins at `start` of the `text`, after the prologue; `braces` are the positions of those of a SELECT's WHERE.
    """

    form: str
    where: Group
    default: tuple[str, ...]
    named: tuple[str, ...]
    functions: frozenset[str]
    constants: frozenset[str]
    literals: tuple[Constant, ...]
    expressions: tuple[EvaluatedExpression, ...]
    slice: Slice | None = None
    text: str = ""
    tokens: tuple[Token, ...] = ()
    start: int = 0
    braces: tuple[int, int] = (0, 0)
