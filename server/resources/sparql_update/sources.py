"""Sources of updates: the graphs of resources, and documents of the web (LOAD; SPARQL 1.1 Update, 3.1.4)."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence

from msgspec import Struct
from pyoxigraph import NamedNode, Quad, Triple

from rosld.adapters.model import RosError
from rosld.ontology.body import MEDIA_TYPES, parse_triples
from rosld.server.dataset.endpoint_client import Endpoint, StoreError
from rosld.server.http.body import to_utf8
from rosld.server.http.negotiation import parse_media_type
from rosld.server.http.problem import AGENT_SAID, Problem
from rosld.server.resources.ldp.base import StoredResource
from rosld.server.resources.sparql_update.report import RefusedGraphs
from rosld.server.rest.resource import Resource
from rosld.server.rest.ros_problems import problem_of
from rosld.server.rest.state import State, require_memory
from rosld.server.sparql.update.evaluate import GraphChange, StagingDataset, TooManySteps, evaluate, matched_graphs
from rosld.server.sparql.update.operations import ChangeData, Load, ManageGraph, Operation

_INLINE = 1000
"""Maximum number of quads of an update that is evaluated on the loop."""


class ResourceGraphs(Struct, frozen=True):
    """Snapshot of the graphs of resources: the resources, and the states of existing ones, by graph name.

    `tokens` are the tags of graphs that are not stored, `documents` the names of the stored ones.
    """

    resources: Mapping[str, Resource]
    states: Mapping[str, State]
    tokens: Mapping[str, Hashable]
    documents: frozenset[str]

    def triples(self, graph: str) -> Sequence[Triple] | None:
        """Return the triples of a graph, or None if there is no such graph."""
        state = self.states.get(graph)
        return None if state is None else state.document.all_triples()

    async def changes(self, operations: Sequence[Operation], *, by_change: bool) -> tuple[GraphChange, ...]:
        """Return the changes that operations make. Raises Problems like `evaluate`, and TooManySteps like `match`.

        `by_change`: report only the difference for documents, reading the rest only if necessary.
        """
        if any(
            state.is_large or state.is_long
            for graph in matched_graphs(operations) or ()
            if (state := self.states.get(graph))
        ):
            raise TooManySteps
        changed = self.documents if by_change else frozenset()
        quads = sum(len(each.inserts) + len(each.deletes) for each in operations if isinstance(each, ChangeData))
        is_long = quads > _INLINE
        if not by_change or any(isinstance(each, ManageGraph) for each in operations):
            for state in self.states.values():
                require_memory(state)
                is_long |= state.is_large

        def evaluated() -> tuple[GraphChange, ...]:
            staging = StagingDataset(self, is_large=changed.__contains__)
            evaluate(operations, staging, staging.match)
            return staging.changes()

        return await asyncio.to_thread(evaluated) if is_long else evaluated()


async def read_graphs(graphs: Iterable[str], find: Callable[[str], Resource | None]) -> ResourceGraphs:
    """Return the graphs of these names from the resources that `find` returns. Raises Problems of unreadable graphs."""
    resources: dict[str, Resource] = {}
    states: dict[str, State] = {}
    tokens: dict[str, Hashable] = {}
    for graph in graphs:
        resource = find(graph)
        if resource is None:
            continue
        resources[graph] = resource
        try:
            await resource.prepare()
            state = await resource.state()
        except (Problem, RosError) as error:
            problem = error if isinstance(error, Problem) else problem_of(error)
            if problem.status < 500:  # no graph to read; planning decides whether it can be written
                continue
            raise RefusedGraphs([(graph, problem)]) from error
        states[graph] = state
        if not isinstance(resource, StoredResource):
            tokens[graph] = state.tag
    return ResourceGraphs(resources, states, tokens, frozenset(states.keys() - tokens.keys()))


async def load_documents(
    operations: Sequence[Operation], allowed: frozenset[str], *, seconds: float, limit: int
) -> Sequence[Operation]:
    """Return the operations with each LOAD replaced by an insertion, within `seconds` and `limit` bytes per document.

    Raises Problems: 403 for a document that is not `allowed`, 422 for a document without RDF, 502 for an unavailable
    one. A failing LOAD SILENT does nothing.
    """
    return [
        await _load_or_nothing(each, allowed, seconds, limit) if isinstance(each, Load) else each for each in operations
    ]


async def _load_or_nothing(load: Load, allowed: frozenset[str], seconds: float, limit: int) -> ChangeData:
    try:
        return await _insertion(load, allowed, seconds, limit)
    except Problem:
        if load.silent:
            return ChangeData(silent=True)
        raise


async def _insertion(load: Load, allowed: frozenset[str], seconds: float, limit: int) -> ChangeData:
    if load.document not in allowed:
        words = "this server loads only the URLs in its settings (--allow-load); use the full URL"
        raise Problem(403, f"LOAD of <{load.document}> is refused: {words}. Nothing was done.")
    assert load.into is not None
    triples = await asyncio.to_thread(_read, load.document, seconds, limit)
    return ChangeData(inserts=tuple(_quads(triples, NamedNode(load.into))), silent=load.silent)


def _read(document: str, seconds: float, limit: int) -> Sequence[Triple]:
    endpoint = Endpoint(document, seconds=seconds, limit=limit)
    try:
        answer = endpoint.get(", ".join(MEDIA_TYPES))
        if answer.media_type not in MEDIA_TYPES:
            raise ValueError(f"it is {answer.media_type or 'of no type'}, not one of {MEDIA_TYPES}")
        body = to_utf8(answer.body, parse_media_type(answer.content_type))
        triples = parse_triples(body, answer.media_type, document)
    except StoreError as error:
        raise Problem(502, f"LOAD: {error.sentence}", extra={AGENT_SAID: error.words}) from error
    except (Problem, ValueError) as error:  # BodyError is a ValueError and may quote the document
        words = error.detail if isinstance(error, Problem) else f"{error}."
        raise Problem(422, f"LOAD: <{document}> cannot be read.", extra={AGENT_SAID: words}) from error
    finally:
        endpoint.close()
    return triples


def _quads(triples: Sequence[Triple], graph: NamedNode) -> Iterator[Quad]:
    for subject, predicate, value in triples:
        if isinstance(subject, Triple) or isinstance(value, Triple):
            raise Problem(422, f"LOAD: {subject} or {value} is a triple about triples, which cannot be stored.")
        yield Quad(subject, predicate, value, graph)
