"""The drawer: draws updates over the dataset that queries see, synchronised as for a query and within its limits."""

from __future__ import annotations

import asyncio
from collections.abc import Hashable, Iterator, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import pyoxigraph
from pyoxigraph import QueryBoolean, QuerySolutions, QueryTriples, Triple

from rosld.server.http.problem import Problem
from rosld.server.sparql import child
from rosld.server.sparql.analysis import Analyser, Analysis
from rosld.server.sparql.endpoint import Cost, QueryService
from rosld.server.sparql.needs import Demand, Needs
from rosld.server.sparql.protocol import QueryRequest
from rosld.server.sparql.sync import GraphEntry, GraphSource, Seen
from rosld.server.sparql.update.drawing import Canvas, GraphChange, Row, asks_again, draw, graphs_named
from rosld.server.sparql.update.operations import Modify, Operation, Where
from rosld.server.sparql.update.sketch import sketched
from rosld.server.store import MemoryStore, Store


class Drawn(NamedTuple):
    """What operations come to. It holds for as long as the graphs with live values in `seen` have these tokens, and

    what clients keep of the graphs that change is not of a later version than `kept`.
    """

    changes: tuple[GraphChange, ...]
    seen: Mapping[str, Hashable]
    kept: int


class _Asked(NamedTuple):
    """A WHERE: what it needs, and whether it has a dataset that was chosen for it."""

    analysis: Analysis
    needs: Needs
    chosen: bool


class Drawer:
    """Draws updates. Belongs to one loop."""

    def __init__(self, service: QueryService, store: MemoryStore, source: GraphSource, analyser: Analyser) -> None:
        self._service = service
        self._store = store
        self._source = source
        self._analyser = analyser

    async def draw(self, operations: Sequence[Operation], more: frozenset[str] = frozenset()) -> Drawn:
        """What operations come to now; `more` are graphs whose values are to be there beside those they name.

        Raises Problems as a query does, and those of `drawing.draw`.
        """
        asked = [self._asked(each) for each in _wheres(operations)]
        needs = await self._service.resolved(_together(asked, graphs_named(operations) | more))
        again = asks_again(operations)
        if again and not child.AVAILABLE:
            raise Problem(501, "On this system a WHERE cannot follow another operation: send them one by one.")
        modest = not again and all(one.analysis.modest for one in asked)
        if modest and all(map(_is_enclosed, asked)):
            drawn = await self._apart(operations, needs, [one.analysis for one in asked])
            if drawn is not None:
                return drawn

        def work(seen: Seen) -> Drawn:
            canvas = Canvas(self._graph, self._dataset() if again else None)
            draw(operations, canvas, self._solutions)
            return Drawn(canvas.changes(), _read(needs, seen), seen.kept)

        return await self._service.over(needs, work, None if again else [one.analysis for one in asked])

    async def _apart(self, operations: Sequence[Operation], needs: Needs, asked: Sequence[Analysis]) -> Drawn | None:
        """What operations come to that concern a few graphs with live values and no others: over copies of these,

        so that the dataset need not be brought up to date. None where one of them is no such graph.
        """
        graphs = needs.documents
        deadline = asyncio.get_running_loop().time() + self._service.limits.seconds
        entries = await self._source.live(needs, deadline=deadline) if graphs else ()
        if not graphs or {entry.iri for entry in entries} != graphs:
            return None
        changes = _sketched(operations, asked, entries)
        if changes is not None:
            return Drawn(tuple(changes), {entry.iri: entry.token for entry in entries}, 0)
        dataset = pyoxigraph.Store()
        for entry in entries:
            text = entry.ntriples().encode()
            dataset.load(text, pyoxigraph.RdfFormat.N_TRIPLES, to_graph=pyoxigraph.NamedNode(entry.iri))
        copies = MemoryStore(dataset)
        if any(self._service.cost(each, copies) is Cost.ANY for each in asked):
            return None
        canvas = Canvas(lambda graph: () if graph in graphs else None, dataset)
        draw(operations, canvas, partial(self._solutions, store=copies))
        return Drawn(canvas.changes(), {entry.iri: entry.token for entry in entries}, 0)

    def _asked(self, where: Where) -> _Asked:
        analysis = self._analyser.analyse(where.query)
        graphs = where.default_graphs + where.named_graphs
        return _Asked(analysis, analysis.needs.within(graphs) if graphs else analysis.needs, bool(graphs))

    def _dataset(self) -> pyoxigraph.Store:
        """The dataset itself, to be changed: in a process of its own that ends with this work."""
        return self._store.laid_open()

    def _solutions(self, where: Where, store: Store | None = None) -> Iterator[Row]:
        results = self._service.solutions(self._request(where, store), store)
        if isinstance(results, QueryBoolean):
            return iter([()] if results else [])
        assert isinstance(results, QuerySolutions)
        return (tuple(row) for row in results)

    def _request(self, where: Where, store: Store | None) -> QueryRequest:
        home = where.home
        if home is None or self._holds(f"ASK {{GRAPH <{home.graph}> {{?s ?p ?o}}}}", store):
            return QueryRequest(where.query, where.default_graphs, where.named_graphs)
        named = self._service.solutions(QueryRequest("SELECT ?graph {GRAPH ?graph {}}"), store)
        assert isinstance(named, QuerySolutions)
        return QueryRequest(home.query, (home.graph,), tuple(term.value for [term] in named))

    def _holds(self, query: str, store: Store | None) -> bool:
        return bool(self._service.solutions(QueryRequest(query), store))

    def _graph(self, graph: str, store: Store | None = None) -> Sequence[Triple] | None:
        query = f"CONSTRUCT {{?s ?p ?o}} WHERE {{GRAPH <{graph}> {{?s ?p ?o}}}}"
        results = self._service.solutions(QueryRequest(query), store)
        assert isinstance(results, QueryTriples)
        return list(results) or None


def _sketched(
    operations: Sequence[Operation], asked: Sequence[Analysis], entries: Sequence[GraphEntry]
) -> Sequence[GraphChange] | None:
    """What one operation makes of one graph whose triples are at hand, where that takes no store to say."""
    if len(operations) != 1 or len(entries) != 1 or not all(each.plain for each in asked):
        return None
    [operation], [entry] = operations, entries
    if not isinstance(operation, Modify) or entry.triples is None:
        return None
    return sketched(operation, asked[0].plan if asked else None, entry.iri, entry.triples())


def _wheres(operations: Sequence[Operation]) -> Iterator[Where]:
    return (each.where for each in operations if isinstance(each, Modify) and each.where is not None)


def _is_enclosed(asked: _Asked) -> bool:
    return asked.analysis.enclosed is not None and asked.analysis.enclosed <= asked.needs.documents and not asked.chosen


def _together(asked: Sequence[_Asked], graphs: frozenset[str]) -> Needs:
    demands = [demand for one in asked for demand in one.needs.demands]
    if graphs:
        demands.append(Demand(graphs, parameters=True))
    documents = graphs.union(*(one.needs.documents for one in asked))
    return Needs(tuple(dict.fromkeys(demands)), documents, frozenset().union(*(one.needs.terms for one in asked)))


def _read(needs: Needs, seen: Seen) -> Mapping[str, Hashable]:
    """The tokens of the graphs that may have been read."""
    named = needs.graphs
    if named is None:
        return seen.tokens
    known = named | needs.documents
    return {graph: token for graph, token in seen.tokens.items() if graph in known}
