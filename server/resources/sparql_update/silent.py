"""SILENT: an operation that cannot be done is left out, and the rest is done (SPARQL 1.1 Update, 3.1.4 and 3.2)."""

from __future__ import annotations

from collections.abc import Callable, Sequence, Set

from rosld.server.http.problem import Problem
from rosld.server.sparql.update.evaluate import named_graphs
from rosld.server.sparql.update.operations import Operation


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
