"""A query as values: triple patterns in the groups they stand in, paths, and expressions with their places."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import NamedTuple, TypeAlias

from pyoxigraph import Literal

from rosld.ontology.vocab import rdf
from rosld.server.sparql.syntax.token import Kind

TYPE = rdf.type.value


# --- terms and patterns


class Iri(NamedTuple):
    """A constant IRI, absolute."""

    value: str


class Variable(NamedTuple):
    """A variable, or a blank node (`_:label`, or `[n]` for one without a label), which is a variable in a pattern."""

    name: str

    @property
    def is_blank(self) -> bool:
        """Whether it was written as a blank node."""
        return self.name.startswith(("_:", "["))


class Value(NamedTuple):
    """A literal."""

    literal: Literal


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


@dataclass(eq=False, slots=True)
class Group:
    """What must hold together.

    `graph` is the GRAPH it stands in; `scoped` says that nothing of what is around it narrows it (a subquery),
    `assigned` that it has a BIND, and `mixed` that patterns follow one or that it is of a constant: the store may join
    these in an order of its own. `filters` are groups of EXISTS, `visible` the variables in scope after it (18.2.1).

    `tests` are the expressions of its FILTERs, `bindings` those of its BINDs, `data` what a variable may be by VALUES
    (None: anything). `joined`: its solutions are joined with those around it, where it is an `alternative` (UNION)
    together with those of the others; of OPTIONAL and MINUS it is neither. `given` are the variables that patterns
    before it bind.
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
    joined: bool = False
    alternative: bool = False
    given: frozenset[str] = frozenset()


def graphs_around(group: Group) -> frozenset[str] | None:
    """The graphs that all patterns stand in, by their names; None where one stands in any other or in none."""
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
    """`path / path`."""

    parts: tuple[Path, ...]


class Choice(NamedTuple):
    """`path | path`; no parts: a negated set, which is any predicate."""

    parts: tuple[Path, ...]


class Repeat(NamedTuple):
    """`path*`, `path+`, `path?`."""

    path: Path
    empty: bool


Path: TypeAlias = "PathStep | Inverse | Chain | Choice | Repeat"


def path_predicates(path: Path) -> frozenset[str] | None:
    """All predicates of a path, None where it may be any."""
    if isinstance(path, PathStep):
        return frozenset({path.iri})
    if isinstance(path, Inverse | Repeat):
        return path_predicates(path.path)
    found = [path_predicates(part) for part in path.parts]
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


# --- expressions, each with the positions in the text between which it stands


class Reference(NamedTuple):
    """A variable in an expression; `name` with its mark, as written."""

    start: int
    end: int
    name: str


class Constant(NamedTuple):
    """An IRI or a literal. `kind`: that of its first token, NUMBER also for a string with a datatype."""

    start: int
    end: int
    kind: Kind
    term: Iri | Value


class Expression(NamedTuple):
    """What stands between brackets or commas: operands, and the operators before and between them."""

    start: int
    end: int
    parts: tuple[Part, ...]


class Call(NamedTuple):
    """A call of a function: of a keyword, in capitals, or of an `iri` (""), which ends at `name_end`."""

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
    """EXISTS or NOT EXISTS with its group, which stands in `filters` of the group around it."""

    start: int
    end: int


Operand: TypeAlias = "Reference | Constant | Expression | Call | Choices | Exists"
Part: TypeAlias = "Operand | str"


class ExpressionPurpose(Enum):
    """What an expression is for."""

    TERM = "a term, which is passed on"
    TEST = "whether it holds: an error is as good as false"
    ORDER = "a place among the solutions"


class EvaluatedExpression(NamedTuple):
    """An expression that is evaluated for solutions; one of ORDER BY begins at `start`, with its `direction`."""

    operand: Operand
    purpose: ExpressionPurpose
    start: int = 0
    direction: str = "ASC"


def strip_brackets(operand: Operand) -> Operand:
    """What stands within brackets that hold nothing else."""
    while isinstance(operand, Expression) and len(operand.parts) == 1 and not isinstance(operand.parts[0], str):
        operand = operand.parts[0]
    return operand


# --- the whole


class Slice(NamedTuple):
    """The first solutions that a SELECT tells: `limit` of them after `offset`, in an order.

    `first` is the first expression that they are ordered by, None where there is no order.
    """

    limit: int
    offset: int
    first: Operand | None
    is_descending: bool


@dataclass(frozen=True, slots=True)
class Query:
    """A query: its form, the group of its WHERE, its FROM (`default`) and FROM NAMED, the functions it calls.

    `constants` are the IRIs in VALUES and expressions. `literals` stand in patterns, templates and VALUES;
    they and the `expressions` are of all that is not in SERVICE. `slice` is of a SELECT with LIMIT that groups nothing
    and has no aggregates, None of any other query.
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
