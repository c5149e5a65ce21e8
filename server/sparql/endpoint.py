"""The endpoint: a query from its text to the bytes of its results, live values included."""

from __future__ import annotations

import asyncio
import io
import pickle
from collections import OrderedDict
from collections.abc import AsyncIterator, Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import BinaryIO, NamedTuple, TypeAlias

from rosld.server.http.problem import Problem
from rosld.server.sparql import child, results
from rosld.server.sparql.analysis import Analyser, Analysis
from rosld.server.sparql.evaluation import Evaluation, refused
from rosld.server.sparql.needs import Needs
from rosld.server.sparql.protocol import QueryRequest
from rosld.server.sparql.results import Check, Table
from rosld.server.sparql.sync import Synchroniser
from rosld.server.sparql.workers import Workers
from rosld.server.store import Function, QueryError, Results, Store


class QueryAnswer(NamedTuple):
    """Results in one media type; `content_type` adds its charset. A `body` that is an iterator may raise Aborted."""

    media_type: str
    body: bytes | AsyncIterator[bytes]

    @property
    def content_type(self) -> str:
        """For the header of that name."""
        return results.content_type(self.media_type)


@dataclass(frozen=True, slots=True)
class QuerySettings:
    """`time_limit` in seconds for a whole answer, `memory_limit` in bytes for what a query takes beyond the dataset.

    `workers` queries are answered at a time, `waiting` more may wait. Up to `kept` bytes of answers are kept for as
    long as the dataset does not change.
    """

    time_limit: float = 10.0
    memory_limit: int = 1024 * 1024 * 1024
    workers: int = 4
    waiting: int = 256
    kept: int = 16 * 1024 * 1024


class QueryService:
    """Answers queries over a store that is synchronised before each. Belongs to one loop."""

    def __init__(
        self,
        store: Store,
        synchroniser: Synchroniser,
        analyser: Analyser,
        functions: Mapping[str, Function] = {},
        settings: QuerySettings = QuerySettings(),
    ) -> None:
        self._store = store
        self._synchroniser = synchroniser
        self._analyser = analyser
        self._functions = functions
        self._limits = child.Limits(settings.time_limit, settings.memory_limit)
        self._workers = Workers(settings.workers, settings.waiting)
        self._kept = _Kept(settings.kept)

    async def keep_up(self) -> None:
        """Have the dataset ready for queries, until this is cancelled: a query then has little to wait for."""
        await self._synchroniser.keep_up()

    async def answer(self, request: QueryRequest, accept: str | None) -> QueryAnswer:
        """The results in the form that the client prefers.

        Raises Problems: 400 for what is no query (in the parser's words) or may not be asked, 406, 413, 503 when it
        takes too long or too many are being answered.
        """
        analysis = self._analyser.analyse(request.text)
        media_type = results.choose(analysis.form, accept)
        async with self._synchroniser.synced(_needs(analysis, request), deadline=self._deadline()):
            key, version = (request, media_type), self._store.version
            kept = self._kept.get(key, version) if analysis.lasting else None
            if kept is not None:
                return QueryAnswer(media_type, kept)
            body = await self._evaluate(analysis, request, media_type)
            if analysis.lasting and isinstance(body, bytes):
                self._kept.put(key, version, body)
            return QueryAnswer(media_type, body)

    async def table(self, request: QueryRequest, limit: int) -> Table:
        """At most `limit` rows of the results, as terms, for a page. Raises as `answer` does."""
        analysis = self._analyser.analyse(request.text)
        found: list[Table] = []

        def work(output: BinaryIO, check: Check) -> None:
            pickle.dump(results.table(self._query(analysis, request), limit, check), output)

        def job(output: BinaryIO, check: Check) -> None:
            pickled = io.BytesIO()
            self._carry_out(work, analysis, pickled, check)
            found.append(pickle.loads(pickled.getvalue()))  # our own

        async with self._synchroniser.synced(_needs(analysis, request), deadline=self._deadline()):
            await Evaluation(job, self._limits.seconds).run(self._workers)
        return found[0]

    def check(self, text: str) -> Analysis:
        """The analysis of a query that is not asked now. Raises Problem 400; syntax is left to the store's parser."""
        return self._analyser.analyse(text)

    def _deadline(self) -> float:
        return asyncio.get_running_loop().time() + self._limits.seconds

    async def _evaluate(
        self, analysis: Analysis, request: QueryRequest, media_type: str
    ) -> bytes | AsyncIterator[bytes]:
        if analysis.quick:
            written = results.few(self._at_once(analysis, request), media_type)
            if written is not None:
                return written

        def work(output: BinaryIO, check: Check) -> None:
            found = self._query(analysis, request)
            if analysis.form is None:
                raise Problem(400, "The query is of no form that is known here.")
            results.write(found, media_type, output, check, self._analyser.base)

        job = partial(self._carry_out, work, analysis)
        return await Evaluation(job, self._limits.seconds).run(self._workers)

    def _carry_out(
        self, work: Callable[[BinaryIO, Check], None], analysis: Analysis, output: BinaryIO, check: Check
    ) -> None:
        """Do the work here, in the worker's thread, or in a process of its own where it may grow out of hand."""
        if not analysis.modest and child.AVAILABLE and self._store.in_memory:
            child.answer(lambda pipe: work(pipe, _unchecked), output, check, self._limits, self._store.still())
        else:
            work(output, check)

    def _at_once(self, analysis: Analysis, request: QueryRequest) -> Results:
        try:
            return self._query(analysis, request)
        except QueryError as error:
            raise refused(error) from error

    def _query(self, analysis: Analysis, request: QueryRequest) -> Results:
        default, named = _dataset(analysis, request)
        return self._store.query(
            analysis.text,
            base=self._analyser.base,
            prefixes=analysis.prefixes,
            functions=self._functions,
            default_graphs=default,
            named_graphs=named,
        )


def _unchecked() -> None:
    """A child need not look at the clock: it is killed in time."""


def _needs(analysis: Analysis, request: QueryRequest) -> Needs:
    default, named = _dataset(analysis, request)
    return analysis.needs.within(default + named) if default or named else analysis.needs


def _dataset(analysis: Analysis, request: QueryRequest) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The default and the named graphs: those of the request go before the query's own (SPARQL 1.1 Protocol 2.1.4)."""
    if request.default_graphs or request.named_graphs:
        return request.default_graphs, request.named_graphs
    return analysis.default_graphs, analysis.named_graphs


_Key: TypeAlias = tuple[QueryRequest, str]


class _Kept:
    """Answers of one version of the dataset, the least recently used going first; `most` bytes of them."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._size = 0
        self._version = 0
        self._bodies: OrderedDict[_Key, bytes] = OrderedDict()

    def get(self, key: _Key, version: int) -> bytes | None:
        body = self._bodies.get(key) if version == self._version else None
        if body is not None:
            self._bodies.move_to_end(key)
        return body

    def put(self, key: _Key, version: int, body: bytes) -> None:
        if version != self._version:
            self._bodies.clear()
            self._version, self._size = version, 0
        if key not in self._bodies:
            self._bodies[key] = body
            self._size += len(body) + len(key[0].text)
        while self._size > self._most and self._bodies:
            (request, _), dropped = self._bodies.popitem(last=False)
            self._size -= len(dropped) + len(request.text)
