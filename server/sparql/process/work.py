"""Work of query workers: values that are sent to a worker, which evaluates them over its copy of a dataset."""

from __future__ import annotations

import io
import pickle
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from math import inf
from typing import BinaryIO, NamedTuple, Protocol

from pyoxigraph import (
    QueryBoolean,
    QuerySolutions,
    QueryTriples,
    RdfFormat,
    Triple,
    parse,
    serialize,
)

from rosld.server.dataset.base import Function, Results, TripleChanges
from rosld.server.dataset.encoding import decode_term
from rosld.server.dataset.memory_store import MemoryStore
from rosld.server.http.problem import AGENT_SAID, Problem
from rosld.server.space.transforms import FrameRow
from rosld.server.sparql import results, row_limit
from rosld.server.sparql.math_functions import AGGREGATES
from rosld.server.sparql.message_order import MessageTimes
from rosld.server.sparql.ros_functions import functions, unknown_functions
from rosld.server.sparql.update.evaluate import (
    GraphChange,
    Row,
    StagingDataset,
    evaluate,
    has_dependent_where,
)
from rosld.server.sparql.update.operations import Operation, Where

_MAX_TRIPLES = 2000
"""Triples of a graph above which an update is evaluated as a difference."""
_LASTING = functions(lambda topic: None)


class Work(Protocol):
    """Function that writes its result to `output`. Raises QueryError, Problems, and what `output` raises."""

    def __call__(self, store: MemoryStore, output: BinaryIO) -> None:
        """Run the work."""
        ...


class QueryWork(NamedTuple):
    """A query as the store evaluates it. `functions` are the IRIs of the functions that it calls.

    `ages` are the seconds since the newest message of each topic, if the query needs them; `past` are N-Triples about
    recorded messages, added to the default graph for this query only, `stored_past` those in their stored form;
    `transforms` are those for ros:transform, and `times` those of the messages for ros:asOf.
    """

    text: str
    base: str
    prefixes: Mapping[str, str]
    default_graphs: tuple[str, ...]
    named_graphs: tuple[str, ...]
    ages: Mapping[str, float] | None = None
    functions: frozenset[str] = frozenset()
    past: bytes | None = None
    stored_past: bytes = b""
    transforms: tuple[FrameRow, ...] = ()
    times: tuple[MessageTimes, ...] = ()

    def results(self, store: MemoryStore) -> Results:
        """Return the results. Raises QueryError."""
        return store.query(
            self.text,
            base=self.base,
            prefixes=self.prefixes,
            functions=self._callable_functions(),
            default_graphs=self.default_graphs,
            named_graphs=self.named_graphs,
            past=self.past,
            stored_past=self.stored_past,
            aggregates=AGGREGATES,
        )

    def _callable_functions(self) -> Mapping[str, Function]:
        """Return the functions it may call; a call of an unknown one is an error of its expression."""
        known = _LASTING
        if self.ages is not None or self.transforms or self.times:
            known = functions((self.ages or {}).get, self.base, self.transforms, self.times)
        more = unknown_functions(self.functions) if self.functions else {}
        return {**known, **more} if more else known


class AnswerWork(NamedTuple):
    """Results of a query in one media type. Raises Problem 503 for more than `limit` rows (triples of a graph).

    The output is empty if there are fewer than `least` rows. `unread` are the URLs that a partial answer links to.
    """

    query: QueryWork
    media_type: str
    limit: int
    least: int = 0
    unread: tuple[str, ...] = ()

    def __call__(self, store: MemoryStore, output: BinaryIO) -> None:
        with _service_errors():
            found = self.query.results(store)
            limited = row_limit.limit_rows(output, self.media_type, isinstance(found, QueryTriples), self.limit)
            statements = inf if limited is not output else self.limit
            if not self.least:
                results.write_results(found, self.media_type, limited, statements, self.query.base, self.unread)
                return
            held = io.BytesIO()
            results.write_results(found, self.media_type, held, inf, self.query.base, self.unread)
            if row_limit.count_rows(held.getvalue(), self.media_type) >= self.least:
                limited.write(held.getvalue())


class TableWork(NamedTuple):
    """First rows of the results of a query, as a pickled `ResultRows`; empty if there are fewer than `least`."""

    query: QueryWork
    limit: int
    least: int = 0

    def __call__(self, store: MemoryStore, output: BinaryIO) -> None:
        with _service_errors():
            table = results.result_rows(self.query.results(store), self.limit)
            if len(table.rows) >= min(self.least, self.limit):
                output.write(pickle.dumps(table))


@contextmanager
def _service_errors() -> Iterator[None]:
    """Raise a 502 Problem if another endpoint fails; any other OSError but a broken pipe is one of SERVICE."""
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        raise Problem(502, "A federated endpoint of the query failed.", extra={AGENT_SAID: str(error)}) from error


class WhereWork(NamedTuple):
    """A WHERE as a query, and (`home`) the query over the graph of WITH."""

    where: Where
    query: QueryWork
    home: QueryWork | None

    def solutions(self, store: MemoryStore) -> Iterator[Row]:
        """Yield the bindings for the templates. Raises QueryError."""
        found = self._query_in_graph(store).results(store)
        if isinstance(found, QueryBoolean):
            return iter([()] if found else [])
        assert isinstance(found, QuerySolutions)
        return (tuple(None if term is None else decode_term(term) for term in row) for row in found)

    def _query_in_graph(self, store: MemoryStore) -> QueryWork:
        home = self.where.with_graph
        if home is None or self.home is None or store.count(home.graph, 1):
            return self.query
        return self.home._replace(default_graphs=(home.graph,), named_graphs=tuple(store.graphs()))


class EvaluateUpdate(NamedTuple):
    """Result of operations: pickled graphs, each with whether it existed and its new content as N-Triples.

    For large graphs whose names begin with `documents` it has the differences.
    """

    update: bytes
    documents: str | None

    def _is_sent_as_edit(self, store: MemoryStore, graph: str) -> bool:
        return self.documents is not None and graph.startswith(self.documents) and _is_large(store, graph)

    def __call__(self, store: MemoryStore, output: BinaryIO) -> None:
        operations, wheres = pickle.loads(self.update)  # from our own server
        by_where = {id(one.where): one for one in wheres}
        dataset = store if has_dependent_where(operations) else None
        staging = StagingDataset(store, dataset, partial(self._is_sent_as_edit, store))
        evaluate(operations, staging, lambda where: by_where[id(where)].solutions(store))
        output.write(pickle.dumps([_write(change) for change in staging.changes()]))


def evaluate_work(
    operations: Sequence[Operation], wheres: Sequence[WhereWork], documents: str | None
) -> EvaluateUpdate:
    """Return the work that evaluates operations (thread-safe)."""
    return EvaluateUpdate(pickle.dumps((operations, wheres), protocol=5), documents)


def _is_large(store: MemoryStore, graph: str) -> bool:
    return store.count(graph, _MAX_TRIPLES + 1) > _MAX_TRIPLES


_Written = tuple[str, bool, bytes | tuple[bytes, bytes] | None]


def _write(change: GraphChange) -> _Written:
    """Convert to N-Triples: pickling terms takes ten times as long."""
    graph, was_there, after = change
    if isinstance(after, TripleChanges):
        return graph, was_there, (_text(after.removed), _text(after.added))
    return graph, was_there, None if after is None else _text(after)


def _text(triples: Sequence[Triple]) -> bytes:
    return serialize(triples, format=RdfFormat.N_TRIPLES) or b""


def read_changes(result: bytes) -> tuple[GraphChange, ...]:
    """Return the changes in the result of `EvaluateUpdate`."""
    changes: list[_Written] = pickle.loads(result)  # from our own process
    return tuple(GraphChange(graph, was_there, _read(after)) for graph, was_there, after in changes)


def _read(after: bytes | tuple[bytes, bytes] | None) -> tuple[Triple, ...] | TripleChanges | None:
    if isinstance(after, tuple):
        return TripleChanges(*map(_triples, after))
    return None if after is None else _triples(after)


def _triples(text: bytes) -> tuple[Triple, ...]:
    return tuple(quad.triple for quad in parse(text, RdfFormat.N_TRIPLES))


class DumpGraphs(NamedTuple):
    """Pickled mapping of graph names to N-Triples at one moment; None for a graph that does not exist."""

    graphs: tuple[str, ...]

    def __call__(self, store: MemoryStore, output: BinaryIO) -> None:
        output.write(pickle.dumps({graph: store.ntriples(graph) for graph in self.graphs}))


class ListGraphs(NamedTuple):
    """Pickled list of the names of all graphs."""

    def __call__(self, store: MemoryStore, output: BinaryIO) -> None:
        output.write(pickle.dumps([*store.graphs()]))
