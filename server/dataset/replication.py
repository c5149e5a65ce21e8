"""Replication of the dataset to another store, in the background.

Queries are answered from the local dataset; the other store follows at a limited rate. It may also hold graphs of other
servers: a graph belongs to a server by its IRI, and other graphs are never changed. Changes wait as names of graphs
(`pending_changes.py`), whose contents are read when they are sent; of a small graph only the difference is sent
(`ReplicaState`), because replacements make stores grow. While the other store is unreachable, nothing else waits for
it.

The heartbeat, a graph in the other store, states which run of which server wrote the graphs, and when it last did. A
store that lost data, or was restored from a backup, lacks the last heartbeat: then everything is sent again.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import random
import threading
import time
from collections.abc import Awaitable, Callable, Collection, Iterator, Mapping, Sequence
from typing import NamedTuple, Protocol, TypeVar

from msgspec import Struct
from pyoxigraph import Literal, NamedNode

from rosld.ontology.triples import date_time_literal as instant
from rosld.ontology.vocab import dcterms, rdf, ros
from rosld.server.dataset.base import Edit
from rosld.server.dataset.endpoint_client import StoreError, StoreRefused
from rosld.server.dataset.pending_changes import PendingBatch, PendingChanges, ReplicaState
from rosld.server.dataset.remote_store import RemoteStore, split_parts

_log = logging.getLogger("rosld.store")

_REQUEST = 1024 * 1024
"""Maximum characters of a request, unless one blank node connects more."""
_ROUND = 2000
"""Maximum number of graphs sent between checks for changes."""
_FIRST_PAUSE, _LONGEST_PAUSE = 1.0, 60.0
"""Seconds until a failed store is retried: doubled each time, less a random part."""
_REFUSALS = 64
"""Number of refused requests in a round after which the rest waits for the next round."""
_AGAIN = 60.0
"""Seconds until a refused graph is retried, and minimum seconds between complete transfers."""
_LAST = 1.5
"""Maximum seconds of the last request."""
_MOMENTS = 32
"""Number of successive requests with unknown outcome after which everything is sent again."""
_CONTENT = (400, 413, 422, 500)
"""HTTP statuses that may concern the content rather than the endpoint."""

_T = TypeVar("_T")


class GraphOwnership(Protocol):
    """Definition of this server's graphs in a shared store."""

    @property
    def base(self) -> str:
        """Common prefix of the IRIs of these graphs."""
        ...

    @property
    def heartbeat_graph(self) -> str:
        """IRI of the graph that states when this server last updated the store; the graph describes itself."""
        ...

    def is_ours(self, graph: str) -> bool:
        """Whether a graph with the prefix was sent by this server or an earlier run of it."""
        ...

    def transient_graphs(self) -> Collection[str]:
        """Return the graphs that are valid only while this server runs. Called on the event loop."""
        ...


class ReplicationSource(Protocol):
    """The replicated dataset. `graphs` and `ntriples` are called in any thread, and raise StoreError."""

    def watch(self, changed: Callable[[Collection[str], Sequence[Edit]], None], restarted: Callable[[], None]) -> None:
        """Call `changed` with names of replaced graphs and edits, and `restarted` when the dataset is rebuilt."""
        ...

    def graphs(self) -> Collection[str]:
        """Return the names of all graphs."""
        ...

    def ntriples(self, graph: str) -> str | None:
        """Return the contents of a graph, or None if it does not exist."""
        ...


class ReplicationStatus(Struct, frozen=True):
    """Progress of a mirror. `lag` is the age in seconds of the oldest change that is not replicated, or 0.

    `failure` is why the store cannot be updated now, or None, and `words` is the store's own message. `pending` graphs
    wait, `refused` graphs were rejected. `updated_ns` is the time of the last successful update, in nanoseconds since
    the epoch.
    """

    url: str
    lag: float
    pending: int
    refused: int
    failure: str | None
    words: str | None
    updated_ns: int | None


class _Part(NamedTuple):
    """Part of an update request for one graph: all its triples (or its removal), or else edits."""

    graph: str
    text: str | None
    edits: Sequence[Edit]

    @property
    def size(self) -> int:
        return len(self.graph) + len(self.text or "") + sum(len(edit.added) + len(edit.removed) for edit in self.edits)


def pause_after(failures: int, first: float) -> float:
    """Return the seconds to wait after successive failures: exponential backoff with jitter, at most a minute."""
    return min(_LONGEST_PAUSE, first * 2.0 ** min(failures - 1, 16)) * random.uniform(0.5, 1.0)


class Mirror:
    """Updates a remote store from a dataset. `run` belongs to one event loop; requests are made in a thread.

    `refresh` updates the dataset from the robot. `interval` is the seconds between rounds. `run_name` is unique to this
    run of the server.
    """

    def __init__(
        self,
        source: ReplicationSource,
        target: RemoteStore,
        ownership: GraphOwnership,
        refresh: Callable[[], Awaitable[None]],
        *,
        interval: float,
        run_name: str,
    ) -> None:
        self._source = source
        self._target = target
        self._ownership = ownership
        self._refresh = refresh
        self._interval = interval
        self._run_name = run_name
        self._pending = PendingChanges()
        self._replica = ReplicaState()
        self._refused: dict[str, float] = {}
        self._sending_since: float | None = None
        self._sent_ns: int | None = None
        self._failure: StoreError | None = None
        self._failures = 0
        self._moments: list[str] = []  # times that the heartbeat may contain: one line unless requests failed
        self._whole = False  # whether all graphs were queued since this server started
        self._confirmed = False  # whether the heartbeat was found since then
        self._renewed = 0.0  # start time of the last complete transfer
        self._verified_connections = -1  # number of connections when the heartbeat was last verified
        self._ending = False
        self._refresh_failed = False
        self._round: asyncio.Future[bool] | None = None
        source.watch(self._pending.add, self._forget)

    def _forget(self) -> None:
        """Send everything again after the dataset was rebuilt, because removed graphs are not reported."""
        self._whole = False

    @property
    def status(self) -> ReplicationStatus:
        """Return the progress (thread-safe)."""
        oldest = [moment for moment in (self._sending_since, self._pending.since) if moment is not None]
        lag = time.monotonic() - min(oldest) if oldest else 0.0
        pending, refused, failure = len(self._pending), len(self._refused), self._failure
        sentence, words = (None, None) if failure is None else (failure.sentence, failure.words)
        return ReplicationStatus(self._target.url, lag, pending, refused, sentence, words, self._sent_ns)

    async def run(self) -> None:
        """Send changes to the other store until cancelled."""
        while True:
            start = time.monotonic()
            try:
                await self._refresh_or_warn()
                # A request in a thread cannot be cancelled with `run`: `close` waits for the round or aborts it.
                self._round = _in_thread(self._send_round)
                more = await asyncio.shield(self._round)
            except StoreError as error:
                self._note_failure(error)
                await asyncio.sleep(pause_after(self._failures, _FIRST_PAUSE))
                continue
            except Exception as error:
                _log.exception("telling %s failed", self._target.url)
                self._note_failure(StoreError(f"{type(error).__name__}: {error}."))
                await asyncio.sleep(pause_after(self._failures, _FIRST_PAUSE))
                continue
            self._note_success()
            if not more:
                await asyncio.sleep(max(0.0, start + self._interval - time.monotonic()))

    async def close(self) -> None:
        """Remove the graphs that are valid only while this server runs.

        Call after `run` was cancelled; takes seconds.
        """
        self._ending = True
        if self._round is not None and not self._round.done():
            await asyncio.wait([self._round], timeout=_LAST / 3)
            self._target.interrupt()
            await asyncio.wait([self._round], timeout=_LAST / 3)
        if self._failure is None and self._sent_ns is not None and (self._round is None or self._round.done()):
            self._target.set_timeout(_LAST)
            removed = [_Part(graph, None, ()) for graph in self._ownership.transient_graphs()]
            closing = _in_thread(lambda: self._write_heartbeat(ros.Stale, removed))
            await asyncio.wait([closing], timeout=_LAST)
            if not closing.done() or closing.exception() is not None:
                _log.warning("%s still has outdated graphs of this server", self._target.url)

    async def _refresh_or_warn(self) -> None:
        """Update the live values. A failure must not delay the replication of everything else."""
        try:
            await self._refresh()
        except Exception as error:
            if not self._refresh_failed:
                _log.warning("the live values cannot be read for %s: %s", self._target.url, error)
            self._refresh_failed = True
        else:
            self._refresh_failed = False

    def _note_failure(self, error: StoreError) -> None:
        self._failures += 1
        self._verified_connections = -1
        if self._failure is None:
            _log.warning("the store is out of date: %s Retrying.", error)
        self._failure = error

    def _note_success(self) -> None:
        if self._failure is not None:
            _log.warning("the store at %s accepts changes again", self._target.url)
        self._failure, self._failures = None, 0

    # --- in the thread of a round

    def _send_round(self) -> bool:
        """Send the first pending changes and the heartbeat; return whether more are pending. Raises StoreError."""
        if self._pending.overflowed:
            self._whole = False
            _log.warning("too many pending changes for %s: sending everything again", self._target.url)
        if not self._whole or self._verified_connections != self._target.connections:
            self._verify()
        now = time.monotonic()
        self._pending.add([graph for graph, again in self._refused.items() if again <= now])
        batch = self._pending.take(_ROUND)
        if batch is None:
            self._send(())
            return False
        self._sending_since = batch.since
        try:
            self._send_all(batch, now)
        except BaseException:
            self._replica.clear()
            self._pending.requeue(batch)
            raise
        finally:
            self._sending_since = None
        return len(self._pending) > 0

    def _verify(self) -> None:
        """Check whether the other store holds what was sent, and send everything again if it does not."""
        if self._whole and self._is_heartbeat_current():
            self._confirmed = True
            self._verified_connections = self._target.connections
        elif self._confirmed or not self._whole or time.monotonic() > self._renewed + _AGAIN:
            self._restart()
        # else it lacks a heartbeat sent just now: sending everything again at once would not help

    def _restart(self) -> None:
        self._whole, self._confirmed, self._renewed = False, False, time.monotonic()
        self._pending.clear()
        replicated = [name for name in self._target.graphs_with_prefix(self._ownership.base) if self._is_subject(name)]
        self._pending.replace_all(dict.fromkeys((*replicated, *self._source.graphs())))
        self._refused.clear()
        self._replica.clear()
        self._write_heartbeat(ros.Live)
        self._whole = True

    def _is_subject(self, graph: str) -> bool:
        return graph != self._ownership.heartbeat_graph and self._ownership.is_ours(graph)

    def _is_heartbeat_current(self) -> bool:
        heartbeat = NamedNode(self._ownership.heartbeat_graph)
        rows = self._target.select(f"SELECT ?p ?o {{ GRAPH {heartbeat} {{ {heartbeat} ?p ?o }} }}")
        properties = [(row["p"], row["o"]) for row in rows]
        runs = [value for predicate, value in properties if predicate == ros.revision]
        moments = [
            f"{heartbeat} {predicate} {value} .\n" for predicate, value in properties if predicate == dcterms.modified
        ]
        return runs == [Literal(self._run_name)] and len(moments) == 1 and moments[0] in self._moments

    def _write_heartbeat(self, state: NamedNode, batch: Sequence[_Part] = ()) -> None:
        heartbeat = NamedNode(self._ownership.heartbeat_graph)
        properties = ((rdf.type, ros.Mirror), (ros.revision, Literal(self._run_name)), (ros.state, state))
        moment = self._moment()
        text = "".join(f"{heartbeat} {predicate} {value} .\n" for predicate, value in properties) + moment
        self._moments.append(moment)
        self._replace({**{part.graph: part.text for part in batch}, heartbeat.value: text}, ())
        self._moments = [moment]

    def _moment(self) -> str:
        return f"{NamedNode(self._ownership.heartbeat_graph)} {dcterms.modified} {instant(time.time_ns())} .\n"

    def _send_all(self, pending: PendingBatch, now: float) -> None:
        left = _REFUSALS
        batch: list[_Part] = []
        size = 0
        for part in self._parts(pending, now):
            if batch and size + part.size > _REQUEST:
                left = self._push(batch, left)
                batch, size = [], 0
            batch.append(part)
            size += part.size
        if batch:
            self._push(batch, left)
        else:
            self._send(())

    def _parts(self, pending: PendingBatch, now: float) -> Iterator[_Part]:
        for graph, edits in pending.entries.items():
            again = self._refused.get(graph)
            if again is not None and again > now:
                continue  # sent whole at its next retry
            if edits is not None and again is None:
                self._replica.forget(graph)
                yield _Part(graph, None, edits)
                continue
            text = self._source.ntriples(graph)
            if not text:
                self._replica.forget(graph)
                yield _Part(graph, None, ())
                continue
            difference = self._replica.difference(graph, text)
            if difference is not None:
                if difference.added or difference.removed:
                    yield _Part(graph, None, (difference,))
                continue
            first, *others = split_parts(text, _REQUEST)
            yield _Part(graph, first, ())
            yield from (_Part(graph, None, (Edit(graph, added=other),)) for other in others)

    def _push(self, batch: Sequence[_Part], left: int) -> int:
        """Send a batch, split to skip refused graphs; return how many refusals are left. Raises StoreError."""
        if self._ending:
            raise StoreError("This server is shutting down.")
        batch = [part for part in batch if not part.edits or part.graph not in self._refused]
        if not batch:
            return left
        try:
            self._send(batch)
        except StoreRefused as error:
            if error.status not in _CONTENT or left <= 0:
                raise
            self._send(())  # raises if the endpoint refuses even this, and is thus at fault itself
            if len(batch) == 1:
                self._drop_refused(batch[0].graph, error)
                return left - 1
            middle = len(batch) // 2
            return self._push(batch[middle:], self._push(batch[:middle], left - 1))
        for part in batch:
            self._refused.pop(part.graph, None)
        return left

    def _drop_refused(self, graph: str, error: StoreRefused) -> None:
        """Remove a refused graph: better absent than outdated."""
        if graph not in self._refused:
            _log.error("%s is omitted from the store: %s", graph, error)
        self._refused[graph] = time.monotonic() + _AGAIN
        self._replica.forget(graph)
        self._send((_Part(graph, None, ()),))

    def _send(self, batch: Sequence[_Part]) -> None:
        if len(self._moments) > _MOMENTS:
            self._whole = False  # too many outcomes are unknown
        moment = self._moment()
        beat = Edit(self._ownership.heartbeat_graph, moment, "".join(self._moments))
        self._moments.append(moment)
        graphs = {part.graph: part.text for part in batch if not part.edits}
        self._replace(graphs, [*(edit for part in batch for edit in part.edits), beat])
        self._moments = [moment]

    def _replace(self, graphs: Mapping[str, str | None], edits: Sequence[Edit]) -> None:
        try:
            self._target.replace(graphs, edits)
        except ValueError as error:
            raise StoreRefused(f"It cannot be sent: {error}.", 422) from error
        self._sent_ns = time.time_ns()


def _in_thread(work: Callable[[], _T]) -> asyncio.Future[_T]:
    """Run in a separate daemon thread, for which a process that ends does not wait."""
    loop = asyncio.get_running_loop()
    future: asyncio.Future[_T] = loop.create_future()

    def settle(result: _T | None, error: BaseException | None) -> None:
        if future.cancelled():
            return
        if error is not None:
            future.set_exception(error)
        else:
            future.set_result(result)  # type: ignore[arg-type]

    def run() -> None:
        result: _T | None = None
        failure: BaseException | None = None
        try:
            result = work()
        except BaseException as error:
            failure = error
        with contextlib.suppress(RuntimeError):  # the event loop is closed
            loop.call_soon_threadsafe(settle, result, failure)

    future.add_done_callback(lambda done: done.cancelled() or done.exception())  # else asyncio reports it as lost
    threading.Thread(target=run, name="store", daemon=True).start()
    return future
