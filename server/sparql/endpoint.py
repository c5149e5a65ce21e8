"""The endpoint: a query from its text to the bytes of its results, live values included."""

from __future__ import annotations

import asyncio
import io
import pickle
import time
from collections import OrderedDict
from collections.abc import AsyncIterator, Callable, Hashable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial
from typing import BinaryIO, NamedTuple, TypeAlias, TypeVar

from pyoxigraph import NamedNode, QueryTriples

from rosld.server.access.judge import EVERYTHING, Judge
from rosld.server.http.again import Still
from rosld.server.http.problem import Problem
from rosld.server.sparql import child, results, rows
from rosld.server.sparql.analysis import Analyser, Analysis
from rosld.server.sparql.child import Leash
from rosld.server.sparql.evaluation import Evaluation, refused
from rosld.server.sparql.functions import AGE
from rosld.server.sparql.hangup import HangUp
from rosld.server.sparql.limits import Limits, busy, out_of_time
from rosld.server.sparql.needs import Needs
from rosld.server.sparql.protocol import QueryRequest
from rosld.server.sparql.results import Check, Table
from rosld.server.sparql.shades import Shades
from rosld.server.sparql.small import is_anchored, is_small
from rosld.server.sparql.sync import Seen, Synchroniser
from rosld.server.sparql.workers import Workers
from rosld.server.store import Function, MemoryStore, QueryError, Results, Store
from rosld.server.store.base import Term

T = TypeVar("T")


class QueryAnswer(NamedTuple):
    """Results in one media type; `content_type` adds its charset. A `body` that is an iterator may raise Aborted.

    `still` says whether the same query would be answered the same again.
    """

    media_type: str
    body: bytes | AsyncIterator[bytes]
    still: Still | None = None

    @property
    def content_type(self) -> str:
        """For the header of that name."""
        return results.content_type(self.media_type)


@dataclass(frozen=True, slots=True)
class QuerySettings:
    """`time_limit` in seconds for a whole answer, `memory_limit` in bytes for what a query takes beyond the dataset.

    `workers` queries are answered at a time, `waiting` more may wait. An answer has at most `row_limit` rows (triples
    of a graph). Up to `kept` bytes of answers are kept for as long as the dataset does not change.
    """

    time_limit: float = 10.0
    memory_limit: int = 1024 * 1024 * 1024
    row_limit: int = 1_000_000
    workers: int = 4
    waiting: int = 256
    kept: int = 16 * 1024 * 1024

    @property
    def limits(self) -> Limits:
        """What a query may take."""
        return Limits(self.time_limit, self.memory_limit, self.row_limit, self.workers, self.waiting)


class Cost(Enum):
    """What a query may take: less than going to another thread, not much more than this, or anything."""

    NOTHING = 0
    LITTLE = 1
    ANY = 2


class Sight(NamedTuple):
    """What a query is asked over, and who sees it so."""

    store: Store
    judge: Judge = EVERYTHING


class Evaluating(NamedTuple):
    """How one query is answered: within limits, `until` (monotonic), for a client that may hang up, over `seen`."""

    limits: Limits
    until: float
    hung_up: HangUp | None
    seen: Sight


_BRISK = 2
"""Threads for queries that cannot take long."""
_QUICK_ROWS = 64 * 1024
"""Rows that no quick answer has."""
_SMALL = 300
"""Statements that are looked at to find out whether a query is small: a fraction of what a process costs."""
_MOST_GRAPHS = 8
_LONG = 8 * 1024
"""Characters of a query that is not read on the loop."""


class QueryService:
    """Answers queries over a store that is synchronised before each. Belongs to one loop."""

    def __init__(
        self,
        store: Store,
        synchroniser: Synchroniser,
        analyser: Analyser,
        functions: Callable[[], Mapping[str, Function]] = dict,
        settings: QuerySettings = QuerySettings(),
        shades: Shades | None = None,
    ) -> None:
        self._store = store
        self._synchroniser = synchroniser
        self._analyser = analyser
        self._functions = functions
        self._shades = shades
        self.limits = settings.limits
        self._workers = Workers(settings.workers, settings.waiting)
        self._brisk = Workers(_BRISK, settings.waiting)
        self._kept = _Kept(settings.kept)
        self._reader = ThreadPoolExecutor(1, "sparql-reader")
        self._long = 0

    async def keep_up(self) -> None:
        """Have the dataset ready for queries, until this is cancelled: a query then has little to wait for."""
        await self._synchroniser.keep_up()

    async def answer(
        self,
        request: QueryRequest,
        accept: str | None,
        hung_up: HangUp | None = None,
        judge: Judge = EVERYTHING,
        *,
        again: bool = False,
    ) -> QueryAnswer:
        """The results in the form that the client prefers, over what the judge lets be seen; `hung_up` ends it early.

        `again`: it is worth knowing how long the answer stands (`still`).

        Raises Problems: 400 for what is no query (in the parser's words) or may not be asked, 406, 413, 503 when it
        reaches a limit (its `reason` is time, memory or rows) or too many are being answered.
        """
        limits, until = self._begun(request)
        analysis = await self._analysed(request.text, limits, until)
        media_type = results.choose(analysis.form, accept)
        needs = await self._needed(analysis, request, judge)
        before = self._synchroniser.glance(needs) if again and analysis.lasting and judge.reads_all else None
        async with self._synchroniser.synced(needs, deadline=self._deadline(limits)):
            if not judge.reads_all:
                seen = await self._seen(judge)
                how = Evaluating(limits, until, hung_up, seen)
                return QueryAnswer(media_type, await self._evaluate(analysis, request, media_type, how))
            key = (request.text, request.default_graphs, request.named_graphs, media_type)
            version = self._store.version
            still = None if before is None else partial(self._stands, needs, before, version)
            kept = self._kept.get(key, version) if analysis.lasting else None
            if kept is not None:
                return QueryAnswer(media_type, kept, still)
            how = Evaluating(limits, until, hung_up, Sight(self._store))
            body = await self._evaluate(analysis, request, media_type, how)
            if analysis.lasting and isinstance(body, bytes):
                self._kept.put(key, version, body)
            return QueryAnswer(media_type, body, still)

    def _stands(self, needs: Needs, before: Hashable, version: int) -> bool:
        """Whether the dataset is as it was, and would be after another look at what the query needs."""
        return self._store.version == version and self._synchroniser.glance(needs) == before

    async def table(
        self, request: QueryRequest, limit: int, hung_up: HangUp | None = None, judge: Judge = EVERYTHING
    ) -> Table:
        """At most `limit` rows of the results, as terms, for a page. Raises as `answer` does."""
        limits, until = self._begun(request)
        analysis = await self._analysed(request.text, limits, until)
        found: list[Table] = []
        cost = Cost.ANY
        seen = Sight(self._store)

        def work(output: BinaryIO, check: Check) -> None:
            pickle.dump(results.table(self._query(analysis, request, seen), limit, check), output)

        def job(output: BinaryIO, check: Check, leash: Leash) -> None:
            pickled = io.BytesIO()
            self._carry_out(work, cost, limits, pickled, check, leash, seen.store)
            found.append(pickle.loads(pickled.getvalue()))  # our own

        needs = await self._needed(analysis, request, judge)
        async with self._synchroniser.synced(needs, deadline=self._deadline(limits)):
            if not judge.reads_all:
                seen = await self._seen(judge)
            cost = self._cost(analysis, request, seen.store)
            await Evaluation(job, limits, until).run(self._pool(cost), hung_up)
        return found[0]

    async def resolved(self, needs: Needs) -> Needs:
        """The needs with all documents that they name, as `over` wants them."""
        return await self._synchroniser.resolved(needs)

    async def over(self, needs: Needs, work: Callable[[Seen], T], asked: Sequence[Analysis] | None) -> T:
        """What `work` comes to over the store, which holds what the needs ask for: within the limits of a query.

        It may ask `solutions` of the queries `asked`. Where these are not small, or None for what nothing is known of,
        it is done in a process of its own if there can be one, so its result must be such that it can be sent. Raises
        as `answer` does.
        """
        limits, until = self.limits, time.monotonic() + self.limits.seconds
        async with self._synchroniser.synced(needs, deadline=self._deadline(limits)):
            seen = self._synchroniser.seen
            costs = {Cost.ANY} if asked is None else {self.cost(each) for each in asked}
            if costs <= {Cost.NOTHING}:
                return work(seen)
            cost = Cost.ANY if Cost.ANY in costs else Cost.LITTLE
            found: list[T] = []

            def pickled(output: BinaryIO, check: Check) -> None:
                pickle.dump(work(seen), output)

            def job(output: BinaryIO, check: Check, leash: Leash) -> None:
                whole = io.BytesIO()
                self._carry_out(pickled, cost, limits, whole, check, leash, self._store)
                found.append(pickle.loads(whole.getvalue()))  # our own

            await Evaluation(job, limits, until).run(self._pool(cost))
            return found[0]

    def solutions(self, request: QueryRequest, store: Store | None = None) -> Results:
        """The results over the store as it is, for whoever is within `over`, or over another. Raises Problems."""
        return self._at_once(self._analyser.analyse(request.text), request, Sight(store or self._store))

    def check(self, text: str) -> Analysis:
        """The analysis of a query that is not asked now. Raises Problem 400; syntax is left to the store's parser."""
        return self._analyser.analyse(text)

    def _begun(self, request: QueryRequest) -> tuple[Limits, float]:
        """The limits of a request, and when its time is over."""
        limits = self.limits
        if request.timeout is not None:
            limits = limits._replace(seconds=min(limits.seconds, request.timeout))
        return limits, time.monotonic() + limits.seconds

    async def _analysed(self, text: str, limits: Limits, until: float) -> Analysis:
        """The analysis of a query: of a long one off the loop, one at a time, as it takes seconds."""
        if len(text) <= _LONG:
            return self._analyser.analyse(text)
        if self._long >= limits.queue:
            raise busy()
        self._long += 1
        reading = asyncio.get_running_loop().run_in_executor(self._reader, self._analyser.analyse_once, text)
        try:
            return await asyncio.wait_for(reading, max(0.0, until - time.monotonic()))
        except asyncio.TimeoutError as error:
            raise out_of_time(limits.seconds) from error
        finally:
            self._long -= 1

    async def _needed(self, analysis: Analysis, request: QueryRequest, judge: Judge) -> Needs:
        """What the query needs, with all documents that it names, as far as it may be read."""
        return _readable(await self.resolved(_needs(analysis, request)), judge)

    def _deadline(self, limits: Limits) -> float:
        return asyncio.get_running_loop().time() + limits.seconds

    async def _seen(self, judge: Judge) -> Sight:
        """What one sees who may not read everything."""
        if self._shades is None:
            raise Problem(403, "Queries are for those who may read everything.")
        return Sight(await self._shades.of(judge), judge)

    def _cost(self, analysis: Analysis, request: QueryRequest, store: Store) -> Cost:
        if len(request.default_graphs) + len(request.named_graphs) > _MOST_GRAPHS:
            return Cost.ANY
        return Cost.LITTLE if analysis.streams else self.cost(analysis, store)

    def cost(self, analysis: Analysis, store: Store | None = None) -> Cost:
        """What a query costs over the dataset (or another store) as it is now, all its graphs being there."""
        plan = analysis.plan
        looked_up = self._store if store is None else store
        if plan is None or not isinstance(looked_up, MemoryStore) or not is_small(plan, looked_up.lookup, _SMALL):
            return Cost.ANY
        at_once = is_anchored(plan) and not analysis.filters and analysis.form in ("SELECT", "ASK")
        return Cost.NOTHING if at_once else Cost.LITTLE

    def _pool(self, cost: Cost) -> Workers:
        """What takes long does not stand in the way of what does not."""
        return self._workers if cost is Cost.ANY else self._brisk

    async def _evaluate(
        self, analysis: Analysis, request: QueryRequest, media_type: str, how: Evaluating
    ) -> bytes | AsyncIterator[bytes]:
        limits = how.limits
        cost = self._cost(analysis, request, how.seen.store)
        if cost is Cost.NOTHING and limits.rows >= _QUICK_ROWS:
            written = results.few(self._at_once(analysis, request, how.seen), media_type)
            if written is not None:
                return written

        if analysis.elsewhere and not child.AVAILABLE:
            raise Problem(501, "On this system SERVICE cannot be held to a limit of time, so it is not asked at all.")

        def work(output: BinaryIO, check: Check) -> None:
            found = self._query(analysis, request, how.seen)
            if analysis.form is None:
                raise Problem(400, "The query is of no form that is known here.")
            limited = rows.limited(output, media_type, isinstance(found, QueryTriples), limits.rows)
            counted = check if limited is not output else rows.Count(check, limits.rows).one
            results.write(found, media_type, limited, counted, self._analyser.base)

        def job(output: BinaryIO, check: Check, leash: Leash) -> None:
            self._carry_out(work, cost, limits, output, check, leash, how.seen.store)

        return await Evaluation(job, limits, how.until).run(self._pool(cost), how.hung_up)

    def _carry_out(
        self,
        work: Callable[[BinaryIO, Check], None],
        cost: Cost,
        limits: Limits,
        output: BinaryIO,
        check: Check,
        leash: Leash,
        store: Store,
    ) -> None:
        """Do the work here, in the worker's thread, or in a process of its own where it may grow out of hand."""
        if cost is Cost.ANY and child.AVAILABLE and store.in_memory:
            child.answer(lambda pipe: _told(work, pipe), output, check, limits, store.still(), leash)
        else:
            work(output, check)

    def _at_once(self, analysis: Analysis, request: QueryRequest, seen: Sight) -> Results:
        try:
            return self._query(analysis, request, seen)
        except QueryError as error:
            raise refused(error) from error

    def _query(self, analysis: Analysis, request: QueryRequest, seen: Sight) -> Results:
        default, named = _dataset(analysis, request)
        return seen.store.query(
            analysis.text,
            base=self._analyser.base,
            prefixes=analysis.prefixes,
            functions=_known(self._functions(), seen.judge),
            default_graphs=default,
            named_graphs=named,
        )


def _told(work: Callable[[BinaryIO, Check], None], pipe: BinaryIO) -> None:
    """Do the work in a child. Raises Problem 502 for another endpoint that fails (SERVICE): nothing else is reached."""
    try:
        work(pipe, _unchecked)
    except BrokenPipeError:
        raise
    except OSError as error:
        raise Problem(502, f"Another endpoint that the query asks failed: {error}.") from error


def _unchecked() -> None:
    """A child need not look at the clock: it is killed in time."""


def _needs(analysis: Analysis, request: QueryRequest) -> Needs:
    default, named = _dataset(analysis, request)
    return analysis.needs.within(default + named) if default or named else analysis.needs


def _readable(needs: Needs, judge: Judge) -> Needs:
    """Needs without what may not be read: nothing is subscribed to or called for one who may not see it."""
    if judge.reads_all:
        return needs
    demands = (
        one if one.graphs is None else replace(one, graphs=frozenset(filter(judge.may_read, one.graphs)))
        for one in needs.demands
    )
    documents = frozenset(filter(judge.may_read, needs.documents))
    return Needs(tuple(one for one in demands if one.graphs is None or one.graphs), documents)


def _known(functions: Mapping[str, Function], judge: Judge) -> Mapping[str, Function]:
    """The functions, of which the one that tells how old a topic's message is tells it of topics that may be read."""
    age = functions.get(AGE)
    if judge.reads_all or age is None:
        return functions

    def known(*arguments: Term) -> Term | None:
        may_know = all(judge.may_read(one.value) for one in arguments if isinstance(one, NamedNode))
        return age(*arguments) if may_know else None

    return {**functions, AGE: known}


def _dataset(analysis: Analysis, request: QueryRequest) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The default and the named graphs: those of the request go before the query's own (SPARQL 1.1 Protocol 2.1.4)."""
    if request.default_graphs or request.named_graphs:
        return request.default_graphs, request.named_graphs
    return analysis.default_graphs, analysis.named_graphs


_Key: TypeAlias = tuple[str, tuple[str, ...], tuple[str, ...], str]


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
            self._size += len(body) + len(key[0])
        while self._size > self._most and self._bodies:
            (text, *_), dropped = self._bodies.popitem(last=False)
            self._size -= len(dropped) + len(text)
