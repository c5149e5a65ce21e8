"""Evaluation of updates without WHERE over the graphs as their resources have them: no query worker is needed."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from pyoxigraph import Triple

from rosld.adapters.model import RosError
from rosld.server.http.problem import Problem
from rosld.server.resources.ldp.base import StoredResource
from rosld.server.resources.sparql_update.report import RefusedGraphs
from rosld.server.rest.resource import Resource
from rosld.server.rest.ros_problems import problem_of
from rosld.server.rest.state import State, require_memory
from rosld.server.sparql.update.evaluate import GraphChange, Row, StagingDataset, evaluate
from rosld.server.sparql.update.operations import ChangeData, ManageGraph, Operation, Where

_INLINE = 1000
"""Quads of an update that is evaluated on the loop."""


@dataclass(frozen=True, slots=True)
class ResourceGraphs:
    """The graphs of resources at one moment: the states of those that are there, by the names of the graphs.

    `tokens` are the tags of those that change by themselves, `documents` the names of all others.
    """

    states: Mapping[str, State]
    tokens: Mapping[str, Hashable]
    documents: frozenset[str]

    def triples(self, graph: str) -> Sequence[Triple] | None:
        """The triples of a graph, None where there is no such graph."""
        state = self.states.get(graph)
        return None if state is None else state.document.all_triples()

    async def changes(self, operations: Sequence[Operation], *, by_change: bool) -> tuple[GraphChange, ...]:
        """The changes that operations without WHERE make. Raises Problems, as `evaluate` does.

        `by_change`: of documents only what changes is told, and the rest is not read, unless that is needed.
        """
        changed = self.documents if by_change else frozenset()
        quads = sum(len(each.inserts) + len(each.deletes) for each in operations if isinstance(each, ChangeData))
        is_long = quads > _INLINE
        if not by_change or any(isinstance(each, ManageGraph) for each in operations):
            for state in self.states.values():
                require_memory(state)
                is_long |= state.is_large

        def evaluated() -> tuple[GraphChange, ...]:
            staging = StagingDataset(self, is_large=changed.__contains__)
            evaluate(operations, staging, _refuse)
            return staging.changes()

        return await asyncio.to_thread(evaluated) if is_long else evaluated()


async def read_graphs(graphs: Iterable[str], find: Callable[[str], Resource | None]) -> ResourceGraphs:
    """Return graphs by name as the resources that `find` finds have them. Raises Problems of what cannot be read."""
    states: dict[str, State] = {}
    tokens: dict[str, Hashable] = {}
    for graph in graphs:
        resource = find(graph)
        if resource is None:
            continue
        try:
            await resource.prepare()
            state = await resource.state()
        except (Problem, RosError) as error:
            problem = error if isinstance(error, Problem) else problem_of(error)
            if problem.status < 500:  # no graph to read; whether it can be written is the plan's to say
                continue
            raise RefusedGraphs([(graph, problem)]) from error
        states[graph] = state
        if not isinstance(resource, StoredResource):
            tokens[graph] = state.tag
    return ResourceGraphs(states, tokens, frozenset(states.keys() - tokens.keys()))


def _refuse(where: Where) -> Iterable[Row]:
    raise ValueError(f"a query worker answers a WHERE: {where.query}")
