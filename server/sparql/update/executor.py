"""Evaluation of updates in the query process, over a dataset materialized as for a query."""

from __future__ import annotations

import asyncio
from collections.abc import Hashable, Mapping, Sequence
from functools import reduce
from typing import NamedTuple

from rosld.server.http.problem import Problem
from rosld.server.rest.resource import Resource
from rosld.server.sparql.analysis import Analyser, Analysis
from rosld.server.sparql.materializer import DatasetVersions
from rosld.server.sparql.needs import Needs, needs_of_documents
from rosld.server.sparql.process.work import WhereWork, Work, evaluate_work, read_changes
from rosld.server.sparql.query_service import QueryService
from rosld.server.sparql.update.evaluate import GraphChange, named_graphs
from rosld.server.sparql.update.operations import Modify, Operation, Where

_INLINE = 1000
"""Maximum number of quads of an update that are packed on the loop."""
_INLINE_BYTES = 128 * 1024
"""Maximum number of bytes of an update's result that are parsed on the loop."""


class Delta(NamedTuple):
    """The changes that operations make.

    They are valid while the graphs with live values have these `tokens`, and the stored content of the changed
    graphs is not newer than version `stored`. `named` are the graphs that the operations name, `resources` those that
    were read.
    """

    changes: tuple[GraphChange, ...]
    tokens: Mapping[str, Hashable]
    stored: int
    named: frozenset[str]
    resources: Mapping[str, Resource] = {}


class _PlannedWhere(NamedTuple):
    """A WHERE with its needs, and the only graphs that it can read (None for all)."""

    where: Where
    analysis: Analysis
    needs: Needs
    scope: frozenset[str] | None


class UpdateEvaluator:
    """Evaluator of updates. Belongs to one loop."""

    def __init__(self, service: QueryService, analyser: Analyser) -> None:
        self._service = service
        self._analyser = analyser

    async def evaluate(
        self, operations: Sequence[Operation], more: frozenset[str] = frozenset(), documents: str | None = None
    ) -> Delta:
        """Return the changes that operations would make now; `more` are graphs whose values they also need.

        For large graphs whose names begin with `documents` the changes are differences. Raises Problems as a query
        does, and those of `evaluate.evaluate`.
        """
        wheres = [self._plan_where(each.where) for each in operations if isinstance(each, Modify)]
        graphs = named_graphs(operations) | more
        needs = reduce(Needs.__or__, (one.needs for one in wheres), needs_of_documents(graphs))
        templates = sum(len(each.inserts) + len(each.deletes) for each in operations if isinstance(each, Modify))

        async def prepare() -> Work:
            queries = [self._where_work(one.where) for one in wheres]
            if templates > _INLINE:
                return await asyncio.to_thread(evaluate_work, operations, queries, documents)
            return evaluate_work(operations, queries, documents)

        result, versions = await self._service.run_on_snapshot(needs, _scope(wheres, graphs), prepare)
        changes = (
            read_changes(result) if len(result) <= _INLINE_BYTES else await asyncio.to_thread(read_changes, result)
        )
        return Delta(changes, _read_tokens(needs, versions), versions.stored, graphs | needs.documents)

    def _plan_where(self, where: Where) -> _PlannedWhere:
        analysis = self._analyser.analyse(where.query)
        if analysis.past is not None:
            raise Problem(400, "ros:past is not allowed in updates: query first, then write the results.")
        graphs = where.default_graphs + where.named_graphs
        needs = analysis.needs.restrict_to(graphs) if graphs else analysis.needs
        scope = frozenset(graphs) if graphs else analysis.is_enclosed
        return _PlannedWhere(where, analysis, needs, scope if where.with_graph is None else None)

    def _where_work(self, where: Where) -> WhereWork:
        query = self._service.prepare(where.query, where.default_graphs, where.named_graphs)
        return WhereWork(
            where, query, None if where.with_graph is None else self._service.prepare(where.with_graph.query)
        )


def _scope(wheres: Sequence[_PlannedWhere], graphs: frozenset[str]) -> frozenset[str] | None:
    """Return the only graphs that an update can read, None for all."""
    scopes = [one.scope for one in wheres]
    return None if None in scopes else graphs.union(*(scope for scope in scopes if scope is not None))


def _read_tokens(needs: Needs, versions: DatasetVersions) -> Mapping[str, Hashable]:
    """Return the tokens of the graphs that may have been read."""
    named = [one.graph or one.document for one in needs.patterns]
    if None in named:
        return versions.tokens
    return {graph: token for graph, token in versions.tokens.items() if graph in named or graph in needs.documents}
