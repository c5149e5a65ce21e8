"""Whether who asks for an update may have it: judged by the names in it first, then on each graph that it changes."""

from __future__ import annotations

from collections.abc import Sequence

from rosld.server.auth.errors import forbidden
from rosld.server.auth.permissions import Judge
from rosld.server.rest.resource import Resource
from rosld.server.sparql.update.evaluate import graphs_named
from rosld.server.sparql.update.operations import Manage, Modify, Operation


def require_rights(operations: Sequence[Operation], judge: Judge) -> None:
    """Refuse what may not be, before anything is looked at: it tells nothing but what was asked. Raises 401, 403.

    A WHERE sees the whole dataset, so it is for those who may read it.
    """
    if judge.whole:
        return
    sources = [each.source for each in operations if isinstance(each, Manage) and isinstance(each.source, str)]
    for graph in sorted(graphs_named(operations)):
        if graph in sources and not judge.may_read(graph):
            raise forbidden(judge.agent, f"read <{graph[:200]}>")
        if not (judge.may("PUT", graph) or graph in sources):
            raise forbidden(judge.agent, f"change <{graph[:200]}>")
    if judge.reads_all:
        return
    if any(isinstance(each, Modify) and each.where is not None for each in operations):
        raise forbidden(
            judge.agent, "send an update with a WHERE, which is for those who may read everything: name the triples"
        )


def require_change(judge: Judge, graph: str, resource: Resource) -> None:
    """Refuse to change a graph, with all that this changes. Raises 401, 403."""
    place = judge.place(graph)
    if judge.whole or place is None:
        return
    may = judge.may("PUT", graph) and all(judge.may("PUT", url) for url in resource.also_changes)
    if not may or (resource.reaches_below and not judge.may_below("PUT", place)):
        raise forbidden(judge.agent, f"change <{graph[:200]}>")
