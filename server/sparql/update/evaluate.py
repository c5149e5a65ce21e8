"""Evaluation of an update over copies of the graphs that it changes; the dataset is unchanged.

Each operation sees the effects of the previous ones; the result is the net effect, one change per graph.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple, Protocol, TypeAlias

from pyoxigraph import BlankNode, Literal, NamedNode, Quad, Triple

from rosld.server.dataset.base import Term, TripleChanges
from rosld.server.dataset.encoding import encode_literal
from rosld.server.http.problem import Problem
from rosld.server.sparql.update.operations import (
    ChangeData,
    GraphGroup,
    GraphVerb,
    Load,
    ManageGraph,
    Modify,
    Operation,
    QuadTemplate,
    TemplateVariable,
    Where,
)

MAX_ROWS = 100_000
"""Maximum number of solutions of a WHERE."""
_MAX_STEPS = 5_000
"""Maximum number of comparisons with triples in `StagingDataset.match`: some three milliseconds."""

Row: TypeAlias = "tuple[Term | None, ...]"
WhereEvaluator: TypeAlias = Callable[[Where], Iterable[Row]]
"""Function that returns the solutions of a WHERE; without variables, one empty row if it holds."""


class TooManySteps(Exception):
    """A WHERE that takes too long to evaluate on the loop."""


class GraphChange(NamedTuple):
    """The change of a graph, which may not have existed before; `after` is None if it no longer exists.

    For a large graph `after` may be the difference, rather than the complete new content.
    """

    graph: str
    was_there: bool
    after: tuple[Triple, ...] | TripleChanges | None


class Graphs(Protocol):
    """The graphs as they were before all operations."""

    def triples(self, graph: str) -> Sequence[Triple] | None:
        """Return the triples of a graph, None if it does not exist."""
        ...


class _LargeGraph:
    """The difference of a large existing graph: removals apply before additions."""

    def __init__(self) -> None:
        self.removed: dict[Triple, None] = {}
        self.added: dict[Triple, None] = {}

    def remove(self, triple: Triple) -> None:
        self.added.pop(triple, None)
        self.removed[triple] = None

    def insert(self, triple: Triple) -> None:
        self.removed.pop(triple, None)
        self.added[triple] = None

    def apply(self, triples: dict[Triple, None]) -> None:
        for triple in self.removed:
            triples.pop(triple, None)
        triples.update(self.added)


class ScratchDataset(Protocol):
    """A dataset that is discarded after an update."""

    def add(self, quad: Quad) -> None:
        """Add a quad."""
        ...

    def remove(self, quad: Quad) -> None:
        """Remove a quad."""
        ...


class StagingDataset:
    """Copies of graphs being changed; a temporary `dataset`, if given, receives the same changes.

    For graphs that are `large` only the difference is stored, unless the complete content is needed.
    """

    def __init__(
        self,
        graphs: Graphs,
        dataset: ScratchDataset | None = None,
        is_large: Callable[[str], bool] = lambda graph: False,
    ) -> None:
        self._graphs = graphs
        self._dataset = dataset
        self._is_large = is_large
        self._large: dict[str, _LargeGraph] = {}
        self._before: dict[str, Sequence[Triple] | None] = {}
        self._now: dict[str, dict[Triple, None] | None] = {}

    def is_there(self, graph: str) -> bool:
        """Whether the graph exists after the changes so far."""
        return self._triples_of(graph) is not None

    def remove(self, quads: Iterable[Quad]) -> None:
        """Remove quads, ignoring those that do not exist."""
        for quad in quads:
            if (large := self._as_large(_name(quad))) is not None:
                large.remove(quad.triple)
            elif (triples := self._triples_of(_name(quad))) is not None:
                triples.pop(quad.triple, None)
            if self._dataset is not None:
                self._dataset.remove(_encode_object(quad))

    def insert(self, quads: Iterable[Quad]) -> None:
        """Add quads, creating missing graphs."""
        for quad in quads:
            if (large := self._as_large(_name(quad))) is not None:
                large.insert(quad.triple)
            else:
                self.create(_name(quad))[quad.triple] = None
            if self._dataset is not None:
                self._dataset.add(_encode_object(quad))

    def quads(self, graph: str) -> list[Quad]:
        """Return the quads of a graph after the changes so far."""
        name = NamedNode(graph)
        return [Quad(each.subject, each.predicate, each.object, name) for each in self._triples_of(graph) or ()]

    def match(self, where: Where) -> Iterator[Row]:
        """Yield the solutions of a WHERE that has `patterns`, after the changes so far. Raises TooManySteps."""
        steps, rows = 0, list[dict[str, Term]]([{}])
        for *slots, graph in where.patterns or ():
            assert isinstance(graph, NamedNode)
            triples = self._current(graph.value)
            if isinstance(slots[1], NamedNode):
                triples = [each for each in triples if each.predicate == slots[1]]
            steps += len(rows) * len(triples)
            if steps > _MAX_STEPS:
                raise TooManySteps
            rows = [found for row in rows for triple in triples if (found := _matched(slots, triple, row)) is not None]
        return (tuple(map(row.get, where.variables)) for row in rows)

    def _current(self, graph: str) -> Collection[Triple]:
        """Return the triples of a graph after the changes so far, without storing it completely."""
        large = self._large.get(graph)
        if graph in self._now or (large is None and not self._is_large(graph)):
            return self._triples_of(graph) or ()
        found = dict.fromkeys(self._graphs.triples(graph) or ())
        if large is not None:
            large.apply(found)
        return found

    def create(self, graph: str) -> dict[Triple, None]:
        """Return the triples of a graph, creating it if missing."""
        triples = self._triples_of(graph)
        if triples is None:
            triples = self._now[graph] = {}
        return triples

    def drop(self, graph: str) -> None:
        """Remove a graph."""
        self.remove(self.quads(graph))
        self._now[graph] = None

    def changes(self) -> tuple[GraphChange, ...]:
        """Return the changed graphs, in the order in which they were first touched."""
        found = [
            GraphChange(graph, True, TripleChanges((*large.removed,), (*large.added,)))
            for graph, large in self._large.items()
            if large.removed or large.added
        ]
        for graph, before in self._before.items():
            now = self._now[graph]
            if (before is None) != (now is None) or (
                before is not None and now is not None and now.keys() != {*before}
            ):
                found.append(GraphChange(graph, before is not None, None if now is None else tuple(now)))
        return tuple(found)

    def _as_large(self, graph: str) -> _LargeGraph | None:
        """Return the difference of a graph, None for one that is stored completely."""
        large = self._large.get(graph)
        if large is None and graph not in self._before and self._dataset is None and self._is_large(graph):
            large = self._large[graph] = _LargeGraph()
        return large

    def _triples_of(self, graph: str) -> dict[Triple, None] | None:
        if graph not in self._before:
            found = self._before[graph] = self._graphs.triples(graph)
            now = self._now[graph] = None if found is None else dict.fromkeys(found)
            large = self._large.pop(graph, None)
            if large is not None and now is not None:
                large.apply(now)
        return self._now[graph]


def _matched(slots: Sequence[object], triple: Triple, row: dict[str, Term]) -> dict[str, Term] | None:
    """Return a solution with the variables that the triple binds, None if it does not match."""
    found = row
    for slot, term in zip(slots, triple, strict=True):
        if isinstance(slot, TemplateVariable):
            known = found.get(slot.name)
            if known is None:
                found = {**found, slot.name: term}
            elif known != term:
                return None
        elif slot != term:
            return None
    return found


def _encode_object(quad: Quad) -> Quad:
    if not isinstance(quad.object, Literal):
        return quad
    return Quad(quad.subject, quad.predicate, encode_literal(quad.object), quad.graph_name)


def _name(quad: Quad) -> str:
    assert isinstance(quad.graph_name, NamedNode)
    return quad.graph_name.value


def evaluate(operations: Sequence[Operation], staging: StagingDataset, ask: WhereEvaluator) -> None:
    """Apply operations to staged graphs. Raises Problems for operations that cannot be carried out.

    `ask` evaluates a WHERE over the dataset before the first operation or, if the changes are staged in the dataset too
    (`has_dependent_where`), over its current state.
    """
    for operation in operations:
        match operation:
            case ChangeData(deletes, inserts):
                staging.remove(deletes)
                staging.insert(inserts)
            case Modify():
                _modify(operation, staging, ask)
            case ManageGraph():
                _manage(operation, staging)
            case Load():
                raise ValueError(f"{operation.document} must be loaded before it is evaluated")


def has_dependent_where(operations: Sequence[Operation]) -> bool:
    """Whether a WHERE follows another operation, so that it must see the effects of that."""
    return any(isinstance(each, Modify) for each in operations[1:])


def has_where(operations: Sequence[Operation]) -> bool:
    """Whether an operation has a WHERE."""
    return any(isinstance(each, Modify) for each in operations)


def matched_graphs(operations: Sequence[Operation]) -> frozenset[str] | None:
    """Return the names of the graphs that `StagingDataset.match` needs; None if it cannot evaluate every WHERE."""
    found: set[str] = set()
    for operation in operations:
        if isinstance(operation, Modify):
            where, templates = operation.where, (*operation.deletes, *operation.inserts)
            if where.patterns is None or where.default_graphs or where.named_graphs:
                return None
            for quad in (*where.patterns, *templates):
                if not isinstance(quad.graph, NamedNode):
                    return None
            found.update(quad.graph.value for quad in where.patterns if isinstance(quad.graph, NamedNode))
    return frozenset(found)


def named_graphs(operations: Sequence[Operation]) -> frozenset[str]:
    """Return the names of the graphs that operations change or copy from."""
    return frozenset(_named_graphs(operations))


def _named_graphs(operations: Sequence[Operation]) -> Iterator[str]:
    for operation in operations:
        match operation:
            case ChangeData(deletes, inserts):
                yield from {_name(quad) for quad in (*deletes, *inserts)}
            case Modify(deletes, inserts):
                for quad in (*deletes, *inserts):
                    if isinstance(quad.graph, NamedNode):
                        yield quad.graph.value
            case ManageGraph(target=target, source=source):
                yield from (each for each in (target, source) if isinstance(each, str))
            case Load(into=str() as into):
                yield into


# Modify


def _modify(operation: Modify, staging: StagingDataset, ask: WhereEvaluator) -> None:
    holes, rows = operation.where.variables, list(_limit_rows(ask(operation.where)))
    removed = [quad for row in rows for quad in fill_templates(operation.deletes, dict(zip(holes, row, strict=True)))]
    added = [quad for row in rows for quad in fill_templates(operation.inserts, dict(zip(holes, row, strict=True)))]
    staging.remove(dict.fromkeys(removed))
    staging.insert(dict.fromkeys(added))


def _limit_rows(rows: Iterable[Row]) -> Iterator[Row]:
    for number, row in enumerate(rows):
        if number == MAX_ROWS:
            raise Problem(422, f"A WHERE has more than the limit of {MAX_ROWS} solutions: change less at a time.")
        yield row


def fill_templates(quads: Sequence[QuadTemplate], values: Mapping[str, Term | None]) -> Iterator[Quad]:
    """Yield the quads of one solution, without those that have unbound variables or would be invalid (3.1.3)."""
    blank: dict[BlankNode, BlankNode] = {}

    def filled(slot: object) -> object:
        if isinstance(slot, TemplateVariable):
            return values[slot.name]
        if isinstance(slot, BlankNode):
            return blank.setdefault(slot, BlankNode())
        return slot

    for quad in quads:
        subject, predicate, object, graph = map(filled, quad)
        if (
            isinstance(subject, NamedNode | BlankNode)
            and isinstance(predicate, NamedNode)
            and isinstance(object, NamedNode | BlankNode | Literal)
            and isinstance(graph, NamedNode)
        ):
            yield Quad(subject, predicate, object, graph)


# Manage


def _manage(operation: ManageGraph, staging: StagingDataset) -> None:
    verb, target, source = operation.verb, operation.target, operation.source
    assert isinstance(target, str), target
    assert not isinstance(source, GraphGroup), source
    if verb is GraphVerb.CREATE:
        if staging.is_there(target) and not operation.silent:
            raise Problem(409, f"CREATE: the graph {target} already exists.")
        staging.create(target)
    elif source is None:
        if not staging.is_there(target):
            _missing(operation, target)
        elif verb is GraphVerb.DROP:
            staging.drop(target)
        else:
            staging.remove(staging.quads(target))
    elif not staging.is_there(source) and source != operation.default:
        _missing(operation, source)
    elif source != target:
        _copy(verb, source, target, staging)


def _copy(verb: GraphVerb, source: str, target: str, staging: StagingDataset) -> None:
    # Its dependencies start threads, which the process that workers are forked from must not have.
    from rosld.server.sparql.update.copying import unmanaged_triples

    triples = unmanaged_triples(source, [quad.triple for quad in staging.quads(source)])
    if verb is not GraphVerb.ADD:
        staging.remove(staging.quads(target))
    name = NamedNode(target)
    staging.create(target)
    staging.insert(Quad(each.subject, each.predicate, each.object, name) for each in triples)
    if verb is GraphVerb.MOVE:
        staging.drop(source)


def _missing(operation: ManageGraph, graph: str) -> None:
    if not operation.silent and graph != operation.default:
        raise Problem(409, f"{operation.verb.value}: the graph {graph} does not exist.")
