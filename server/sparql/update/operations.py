"""An update as values: its operations in their order (SPARQL 1.1 Update, 3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import ClassVar, NamedTuple, TypeAlias

from pyoxigraph import BlankNode, Literal, NamedNode, Quad


class TemplateVariable(NamedTuple):
    """A variable of a template, without its mark: each solution puts a term in its place."""

    name: str


TemplateTerm: TypeAlias = "NamedNode | BlankNode | Literal | TemplateVariable"


class QuadTemplate(NamedTuple):
    """A quad with holes; `graph` is None for the default graph, where no document stands for it."""

    subject: TemplateTerm
    predicate: TemplateTerm
    object: TemplateTerm
    graph: NamedNode | TemplateVariable | None


def variables_of(quads: Sequence[QuadTemplate]) -> tuple[str, ...]:
    """The names of the holes, each once."""
    return tuple(dict.fromkeys(slot.name for quad in quads for slot in quad if isinstance(slot, TemplateVariable)))


def has_blank_nodes(quads: Sequence[QuadTemplate]) -> bool:
    """Whether a blank node stands in them."""
    return any(isinstance(slot, BlankNode) for quad in quads for slot in quad)


class WithGraph(NamedTuple):
    """The graph of WITH, and the query over a dataset whose default graph it is."""

    graph: str
    query: str


@dataclass(frozen=True, slots=True)
class Where:
    """What a template's holes are filled with: the solutions of a SELECT, or, with no holes, whether an ASK holds.

    `default_graphs` and `named_graphs` are its dataset (USING); neither: all there is. Of WITH the query is about the
    one graph (GRAPH), which has no solutions where there is no such graph: `with_graph` is evaluated then.
    """

    query: str
    variables: tuple[str, ...]
    default_graphs: tuple[str, ...] = ()
    named_graphs: tuple[str, ...] = ()
    with_graph: WithGraph | None = None


@dataclass(frozen=True, slots=True)
class ChangeData:
    """INSERT DATA and DELETE DATA, and the result of a LOAD, `silent` as that.

    Quads in the default graph belong to the one graph that the update is about.
    """

    deletes: tuple[Quad, ...] = ()
    inserts: tuple[Quad, ...] = ()
    silent: bool = False


@dataclass(frozen=True, slots=True)
class Modify:
    """DELETE and INSERT with WHERE: for each solution quads are removed, then quads are added."""

    deletes: tuple[QuadTemplate, ...]
    inserts: tuple[QuadTemplate, ...]
    where: Where
    silent: ClassVar[bool] = False


class GraphVerb(Enum):
    """What is done with whole graphs."""

    CLEAR = "CLEAR"
    DROP = "DROP"
    CREATE = "CREATE"
    ADD = "ADD"
    MOVE = "MOVE"
    COPY = "COPY"


class GraphGroup(Enum):
    """Graphs that are meant without their names."""

    DEFAULT = "DEFAULT"
    NAMED = "NAMED"
    ALL = "ALL"


@dataclass(frozen=True, slots=True)
class ManageGraph:
    """Something done with the graph `target`; `source` is what ADD, MOVE and COPY take it from.

    `default` is the document that stands for the default graph, which is there even where the document is not.
    """

    verb: GraphVerb
    target: str | GraphGroup
    source: str | GraphGroup | None = None
    silent: bool = False
    default: str | None = None


@dataclass(frozen=True, slots=True)
class Load:
    """LOAD: what a document on the web says, to be put `into` a graph (None: the default graph)."""

    document: str
    into: str | None
    silent: bool = False


Operation: TypeAlias = "ChangeData | Modify | ManageGraph | Load"
