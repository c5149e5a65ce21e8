"""The query service: from the text of a query to the bytes of its results, live values included."""

from __future__ import annotations

import asyncio
import pickle
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

from msgspec.structs import replace
from pyoxigraph import NamedNode

from rosld.server.auth.permissions import ALLOW_ALL, Permissions
from rosld.server.dataset import QueryError
from rosld.server.http.problem import Problem
from rosld.server.runtime.tasks import loop_time
from rosld.server.runtime.timings import Timings
from rosld.server.space.transforms import TOPICS, FrameRow
from rosld.server.sparql import results, row_limit
from rosld.server.sparql.analysis import Analyser, Analysis, parse_problem
from rosld.server.sparql.disconnect import Disconnected
from rosld.server.sparql.intervals import ANY_TIME, Interval
from rosld.server.sparql.materializer import DatasetVersions, Materializer
from rosld.server.sparql.needs import Needs
from rosld.server.sparql.past import PastDataset, PastSource, PastText
from rosld.server.sparql.process.client import QueryProcess
from rosld.server.sparql.process.work import AnswerWork, QueryWork, TableWork, Work
from rosld.server.sparql.protocol import QueryRequest
from rosld.server.sparql.query_limits import (
    DEFAULT_LIMITS,
    Limits,
    StopReason,
    incomplete,
    out_of_time,
    too_many_queries,
)
from rosld.server.sparql.restricted import RestrictedDatasets
from rosld.server.sparql.results import ResultRows
from rosld.server.sparql.ros_functions import TRANSFORM


class QueryAnswer(NamedTuple):
    """Results in one media type; `content_type` adds its charset. A `body` that is an iterator may raise Aborted.

    `unread` holds the reasons why documents it could match could not be read, by URL: then it is partial.
    """

    media_type: str
    body: bytes | AsyncIterator[bytes]
    unread: Mapping[str, str] = {}

    @property
    def content_type(self) -> str:
        """Value of the Content-Type header."""
        return results.content_type(self.media_type)


_SECOND = 1_000_000_000
_GROWTH = 8
"""Factor by which more messages are read if those at an end were too few: in all a seventh more than needed."""
_MOST_RECORDINGS = 1_000_000
_LONG = 8 * 1024
"""Minimum number of characters of a query that is analysed off the loop."""


class _Run(NamedTuple):
    """A request being answered; `until` is its deadline (monotonic)."""

    request: QueryRequest
    analysis: Analysis
    permissions: Permissions
    limits: Limits
    until: float
    disconnected: Disconnected | None


_OUTCOMES = frozenset({"busy", *(each.value for each in StopReason)})


def _outcome_of(error: BaseException) -> str:
    """Return the outcome of a query that raised an error: the limit that it reached, or whose fault it was."""
    if isinstance(error, asyncio.CancelledError):
        return "cancelled"
    if not isinstance(error, Problem):
        return "failed"
    reason = error.extra.get("reason")
    if isinstance(reason, str) and reason in _OUTCOMES:
        return reason
    return "refused" if error.status < 500 else "failed"


class QueryService:
    """Query evaluation over a dataset that is materialized before each query. Belongs to one loop.

    `ages` returns the seconds since the newest message of each topic that has one, by topic URL; `transforms` returns
    the recent transforms of the robot, and is None where there is not one robot.
    """

    def __init__(
        self,
        process: QueryProcess,
        materializer: Materializer,
        analyser: Analyser,
        ages: Callable[[], Mapping[str, float]] = dict,
        limits: Limits = DEFAULT_LIMITS,
        restricted: RestrictedDatasets | None = None,
        past: PastSource | None = None,
        transforms: Callable[[], Awaitable[Sequence[FrameRow]]] | None = None,
    ) -> None:
        self._process = process
        self._materializer = materializer
        self._analyser = analyser
        self.ages = ages
        self._restricted = restricted
        self.past = past
        self.transforms = transforms
        self.limits = limits
        self.timings = Timings(_outcome_of)
        self._reader = ThreadPoolExecutor(1, "sparql-reader")
        self._long = 0

    async def answer(
        self,
        request: QueryRequest,
        accept: str | None,
        disconnected: Disconnected | None = None,
        permissions: Permissions = ALLOW_ALL,
    ) -> QueryAnswer:
        """Return the results in the preferred media type, limited to what the agent may read.

        Raises Problem 400 for a malformed or forbidden query, 406, 413, 503 if the query reaches a limit (`reason` is
        time, memory or rows), too many queries wait or the dataset is not ready, and 500 if it crashed its worker.
        """
        limits, until = self._limits_of(request)
        analysis = await self._analyse(request.text, limits, until)
        media_type = results.choose_media_type(results.QUADS if request.quads else analysis.form, accept)

        def work(query: QueryWork, least: int, unread: Mapping[str, str]) -> Work:
            return AnswerWork(query, media_type, limits.rows, least, tuple(sorted(unread)))

        is_counted = row_limit.has_counter(media_type)
        run = _Run(request, analysis, permissions, limits, until, disconnected)
        with self.timings.measure("query"):
            body, unread = await self._evaluate(run, work, is_counted)
        return QueryAnswer(media_type, body, unread)

    async def table(
        self,
        request: QueryRequest,
        limit: int,
        disconnected: Disconnected | None = None,
        permissions: Permissions = ALLOW_ALL,
    ) -> ResultRows:
        """Return at most `limit` rows of the results, as terms, for a page. Raises as `answer` does."""
        limits, until = self._limits_of(request)
        analysis = await self._analyse(request.text, limits, until)
        run = _Run(request, analysis, permissions, limits, until, disconnected)
        with self.timings.measure("query"):
            body, unread = await self._evaluate(run, lambda query, least, _: TableWork(query, limit, least), True)
        table: ResultRows = pickle.loads(await _whole(body))  # from our own process
        return table._replace(unread=unread)

    async def run_on_snapshot(
        self, needs: Needs, graphs: frozenset[str] | None, prepare: Callable[[], Awaitable[Work]]
    ) -> tuple[bytes, DatasetVersions]:
        """Run work over a dataset that satisfies the needs; return its result and the versions that it saw.

        `graphs` are the only graphs that are read, None for all. `prepare` creates the work once the dataset is ready.
        Raises as `answer` does.
        """
        limits, until = self.limits, time.monotonic() + self.limits.seconds
        await self._process.wait_ready(until)
        deadline = loop_time() + limits.seconds
        async with self._materializer.materialize(needs, deadline=deadline, scope=graphs) as unread:
            _require_complete(unread)
            versions = self._materializer.versions_of(graphs)
            work = await prepare()
            try:
                return await self._process.result(work, limits, until), versions
            except QueryError as error:
                raise Problem(400, f"A WHERE cannot be evaluated: {error}.") from error

    def check(self, text: str) -> Analysis:
        """Return the analysis of a query that is not run, leaving syntax to the store's parser. Raises Problem 400."""
        return self._analyser.analyse(text)

    def prepare(self, text: str, default_graphs: tuple[str, ...] = (), named_graphs: tuple[str, ...] = ()) -> QueryWork:
        """Return a query as the process takes it, with the current ages of topics. Raises Problem 400."""
        request = QueryRequest(text, default_graphs, named_graphs)
        return self._query(self._analyser.analyse(text), request, ALLOW_ALL)

    def _limits_of(self, request: QueryRequest) -> tuple[Limits, float]:
        """Return the limits of a request and its deadline."""
        limits = self.limits
        if request.timeout is not None:
            limits = limits._replace(seconds=min(limits.seconds, request.timeout))
        return limits, time.monotonic() + limits.seconds

    async def _analyse(self, text: str, limits: Limits, until: float) -> Analysis:
        """Return the analysis of a query; long queries take seconds and are analysed one at a time off the loop."""
        if len(text) <= _LONG:
            return self._analyser.analyse(text)
        if self._long >= limits.queue:
            raise too_many_queries()
        self._long += 1
        reading = asyncio.get_running_loop().run_in_executor(self._reader, self._analyser.analyse_once, text)
        try:
            return await asyncio.wait_for(reading, max(0.0, until - time.monotonic()))
        except asyncio.TimeoutError as error:
            raise out_of_time(limits.seconds) from error
        finally:
            self._long -= 1

    async def _evaluate(
        self, run: _Run, make_work: Callable[[QueryWork, int, Mapping[str, str]], Work], is_counted: bool
    ) -> tuple[bytes | AsyncIterator[bytes], Mapping[str, str]]:
        """Return the output of the work, and the reasons why documents could not be read, by URL.

        Raises Problem 503 for such documents unless the client accepts a partial answer.
        """
        request, analysis, permissions, limits, until, disconnected = run
        await self._process.wait_ready(until)
        needs, scope, deadline = _needs(analysis, request), _scope(analysis, request), loop_time() + limits.seconds
        body: bytes | AsyncIterator[bytes] = b""
        async for evaluated, past, least in self._read_past(run, is_counted):
            async with self._materializer.materialize(needs, permissions, deadline=deadline, scope=scope) as unread:
                if not request.partial:
                    _require_complete(unread)
                query = self._query(evaluated, request, permissions, None if past is None else past.text)
                if past is not None:
                    query = query._replace(stored_past=past.stored, times=tuple(past.times))
                if TRANSFORM in evaluated.functions:
                    query = query._replace(transforms=await self._transforms_for(permissions, past))
                work = make_work(query, least, unread)
                dataset = await self._dataset_for(run)
                try:
                    body = await self._process.answer(work, limits, until, disconnected, dataset)
                except QueryError as error:
                    raise parse_problem(error, evaluated.text) from error
                except Problem as problem:
                    if past is not None and problem.extra.get("reason") == StopReason.TIME.value:
                        raise out_of_time(limits.seconds, past.counts) from problem
                    raise
            if not least or (body := await _whole(body)):
                break
        return body, unread

    async def _transforms_for(self, permissions: Permissions, past: PastText | None) -> tuple[FrameRow, ...]:
        """Return the recorded transforms of a past query, and the live ones if the agent may read their topics."""
        if self.transforms is None:
            raise Problem(400, "ros:transform needs the frames of one robot: send the query to its own endpoint.")
        may_read = all(permissions.may_read(f"{self._analyser.base}topics{topic}") for topic in TOPICS)
        live = await self.transforms() if may_read else ()
        return (*(() if past is None else past.transforms), *live)

    async def _dataset_for(self, run: _Run) -> int:
        """Return the number of the dataset that the agent may query."""
        permissions = run.permissions
        if permissions.is_unrestricted or (permissions.may_read_all and not run.analysis.finds_offers):
            return 0
        if self._restricted is None:
            raise Problem(403, "Queries are allowed only for agents that may read everything.")
        return await self._restricted.dataset_for(permissions, run.limits, run.until)

    async def _read_past(self, run: _Run, is_counted: bool) -> AsyncIterator[tuple[Analysis, PastText | None, int]]:
        """Yield N-Triples about the recorded messages that a query selects, None if it selects none. Raises Problems.

        They come with the query to evaluate over them. If only the newest or oldest matter and rows can be counted
        (`is_counted`), each text has more messages than the one before, with the number of rows that makes it
        sufficient; the last text is complete, with 0 rows.
        """
        request, analysis, permissions, limits, until, _ = run
        if analysis.past is None:
            yield analysis, None, 0
            return
        if self.past is None:
            raise Problem(400, "This server has no recordings: ros:past cannot be used.")
        now = time.time_ns()
        moments = Interval(now - _SECOND, now + int((limits.seconds + 1) * _SECOND))
        graphs, _ = _dataset(analysis, request)
        dataset = PastDataset(graphs, permissions, await self._choose(run))
        if analysis.summary is not None:
            summaries = await self.past.summarize(analysis.past, analysis.summary.query, dataset, until)
            if summaries is not None:
                yield analysis.summary.analysis, summaries, 0
                return
        end = analysis.past.end
        if end is not None and is_counted:
            most = end.messages
            while True:
                found = await self.past.read(analysis.past, dataset, moments, until, most)
                if found.is_whole:
                    yield analysis, found, 0
                    return
                yield analysis, found, end.rows
                most *= _GROWTH
        found = await self.past.read(analysis.past, dataset, moments, until)
        yield analysis, found, 0

    async def _choose(self, run: _Run) -> dict[str, frozenset[str]]:
        """Return the recordings that each query in the selections finds; the agent sees only what they may read."""
        chosen: dict[str, frozenset[str]] = {}
        request = run.request
        for each in () if run.analysis.past is None else run.analysis.past.selections(ANY_TIME):
            if each.choice is None or each.choice in chosen:
                continue
            asked = replace(request, text=each.choice, timeout=max(0.1, run.until - time.monotonic()))
            if not asked.default_graphs and not asked.named_graphs:
                default, named = run.analysis.default_graphs, run.analysis.named_graphs
                asked = replace(asked, default_graphs=default, named_graphs=named)
            table = await self.table(asked, _MOST_RECORDINGS, run.disconnected, run.permissions)
            chosen[each.choice] = frozenset(row[0].value for row in table.rows if isinstance(row[0], NamedNode))
        return chosen

    def _query(
        self,
        analysis: Analysis,
        request: QueryRequest,
        permissions: Permissions,
        past: bytes | None = None,
    ) -> QueryWork:
        default, named = _dataset(analysis, request)
        ages = None
        if analysis.asks_age:
            ages = {topic: age for topic, age in self.ages().items() if permissions.may_read(topic)}
        base, prefixes = self._analyser.base, analysis.prefixes
        return QueryWork(analysis.text, base, prefixes, default, named, ages, analysis.functions, past)


async def _whole(body: bytes | AsyncIterator[bytes]) -> bytes:
    return body if isinstance(body, bytes) else b"".join([chunk async for chunk in body])


def _require_complete(unread: Mapping[str, str]) -> None:
    """Raise Problem 503 if documents that a query can match could not be read."""
    if unread:
        raise incomplete(unread)


def _needs(analysis: Analysis, request: QueryRequest) -> Needs:
    default, named = _dataset(analysis, request)
    return analysis.needs.restrict_to(default + named) if default or named else analysis.needs


def _scope(analysis: Analysis, request: QueryRequest) -> frozenset[str] | None:
    """Return the only graphs that the query can read, None for all."""
    default, named = _dataset(analysis, request)
    return frozenset(default + named) if default or named else analysis.is_enclosed


def _dataset(analysis: Analysis, request: QueryRequest) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the default and named graphs: the request's override the query's own (SPARQL 1.1 Protocol 2.1.4)."""
    if request.default_graphs or request.named_graphs:
        return request.default_graphs, request.named_graphs
    return analysis.default_graphs, analysis.named_graphs
