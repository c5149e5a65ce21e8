"""Authorization of an update: by the names in its text first, then on each graph that it changes.

An operation with SILENT that is refused is left out, and the rest is done (SPARQL 1.1 Update, 3.1.4 and 3.2).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence, Set

from rosld.server.auth.errors import forbidden
from rosld.server.auth.permissions import Permissions
from rosld.server.http.problem import Problem
from rosld.server.rest.resource import Resource
from rosld.server.sparql.update.evaluate import has_where, named_graphs
from rosld.server.sparql.update.operations import ManageGraph, Operation


def require_rights(operations: Sequence[Operation], permissions: Permissions) -> None:
    """Refuse what may not be, before anything is looked at: it tells nothing but what was asked. Raises 401, 403.

    A WHERE sees the whole dataset, so it is for those who may read it.
    """
    if permissions.is_unrestricted:
        return
    sources = [each.source for each in operations if isinstance(each, ManageGraph) and isinstance(each.source, str)]
    for graph in sorted(named_graphs(operations)):
        if graph in sources and not permissions.may_read(graph):
            raise forbidden(permissions.agent, f"read <{graph[:200]}>")
        if not (permissions.may("PUT", graph) or graph in sources):
            raise forbidden(permissions.agent, f"change <{graph[:200]}>")
    if permissions.may_read_all:
        return
    if has_where(operations):
        raise forbidden(
            permissions.agent,
            "send an update with a WHERE, which is for those who may read everything: name the triples",
        )


def require_change(permissions: Permissions, graph: str, resource: Resource) -> None:
    """Refuse to change a graph, with all that this changes. Raises 401, 403."""
    place = permissions.locate(graph)
    if permissions.is_unrestricted or place is None:
        return
    may = permissions.may("PUT", graph) and all(permissions.may("PUT", url) for url in resource.also_changes)
    if not may or (resource.changes_subtree and not permissions.may_subtree("PUT", place)):
        raise forbidden(permissions.agent, f"change <{graph[:200]}>")


def without_silent_failures(
    operations: Sequence[Operation], require: Callable[[Operation], None]
) -> Sequence[Operation]:
    """Return the operations without those with SILENT that are refused; raise the Problem of any other."""
    found = []
    for operation in operations:
        try:
            require(operation)
        except Problem:
            if not operation.silent:
                raise
        else:
            found.append(operation)
    return found


def without_silent_on(operations: Sequence[Operation], graphs: Set[str]) -> Sequence[Operation]:
    """Return the operations without those with SILENT that name one of these graphs, which are refused."""
    return [each for each in operations if not (each.silent and graphs & named_graphs([each]))]
