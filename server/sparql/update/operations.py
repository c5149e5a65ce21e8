"""Operations of an update, in order (SPARQL 1.1 Update, 3)."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import ClassVar, NamedTuple, TypeAlias

from msgspec import Struct
from pyoxigraph import BlankNode, Literal, NamedNode, Quad


class TemplateVariable(NamedTuple):
    """A variable of a template, without its mark, which each solution replaces by a term."""

    name: str


TemplateTerm: TypeAlias = "NamedNode | BlankNode | Literal | TemplateVariable"


class QuadTemplate(NamedTuple):
    """A quad that may have variables; `graph` is None for a default graph that is not a document."""

    subject: TemplateTerm
    predicate: TemplateTerm
    object: TemplateTerm
    graph: NamedNode | TemplateVariable | None


def variables_of(quads: Sequence[QuadTemplate]) -> tuple[str, ...]:
    """Return the names of the variables, each once."""
    return tuple(dict.fromkeys(slot.name for quad in quads for slot in quad if isinstance(slot, TemplateVariable)))


def has_blank_nodes(quads: Sequence[QuadTemplate]) -> bool:
    """Whether a quad has a blank node."""
    return any(isinstance(slot, BlankNode) for quad in quads for slot in quad)


class WithGraph(NamedTuple):
    """The graph of WITH, and the query over a dataset with this graph as its default graph."""

    graph: str
    query: str


class Where(Struct, frozen=True):
    """The WHERE of a template: a SELECT for its variables or, without variables, an ASK.

    `default_graphs` and `named_graphs` are its dataset (USING); without either it is complete. With WITH the query
    names the graph (GRAPH), and so has no solutions if the graph does not exist: then `with_graph` is evaluated.
    `patterns` are all that it consists of, if that is triple patterns of graphs that it names, else None.
    """

    query: str
    variables: tuple[str, ...]
    default_graphs: tuple[str, ...] = ()
    named_graphs: tuple[str, ...] = ()
    with_graph: WithGraph | None = None
    patterns: tuple[QuadTemplate, ...] | None = None


class ChangeData(Struct, frozen=True):
    """INSERT DATA, DELETE DATA, or the result of a LOAD, which may be `silent`.

    Quads in the default graph belong to the one graph that the update is about.
    """

    deletes: tuple[Quad, ...] = ()
    inserts: tuple[Quad, ...] = ()
    silent: bool = False


class Modify(Struct, frozen=True):
    """DELETE and INSERT with WHERE: for each solution quads are removed, then quads are added."""

    deletes: tuple[QuadTemplate, ...]
    inserts: tuple[QuadTemplate, ...]
    where: Where
    silent: ClassVar[bool] = False


class GraphVerb(Enum):
    """Operation on whole graphs."""

    CLEAR = "CLEAR"
    DROP = "DROP"
    CREATE = "CREATE"
    ADD = "ADD"
    MOVE = "MOVE"
    COPY = "COPY"


class GraphGroup(Enum):
    """Keyword for a set of graphs."""

    DEFAULT = "DEFAULT"
    NAMED = "NAMED"
    ALL = "ALL"


class ManageGraph(Struct, frozen=True):
    """Operation on the graph `target`; `source` is the source of ADD, MOVE and COPY.

    `default` is the document that acts as the default graph, which exists even if the document does not.
    """

    verb: GraphVerb
    target: str | GraphGroup
    source: str | GraphGroup | None = None
    silent: bool = False
    default: str | None = None


class Load(Struct, frozen=True):
    """LOAD: a document on the web, to be inserted `into` a graph (None: the default graph)."""

    document: str
    into: str | None
    silent: bool = False


Operation: TypeAlias = "ChangeData | Modify | ManageGraph | Load"
