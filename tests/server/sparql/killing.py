"""A server under load of every kind whose query process is killed repeatedly, and the result of each request."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeAlias

import httpx

from tests.server.sparql.processes import query_processes

# `Served` of conftest.py is the value of its fixture.
Served = Any
Send: TypeAlias = Callable[[httpx.Client, int], httpx.Response]
PATIENCE = 60.0
_PAUSE = 0.02
"""Seconds between two requests of a client."""
OPTIONS = (
    *("--max-publish-rate", "100000", "--setting", "receipts_kept", "500"),
    *("--setting", "query_time_limit", "60"),
)
"""Settings of the server: a high publish rate, few receipts, and a time limit that suffices on a busy machine."""
_TURTLE, _UPDATE = {"Content-Type": "text/turtle"}, {"Content-Type": "application/sparql-update"}
_CSV = {"Accept": "text/csv, application/problem+json;q=0.9"}
_VALUE = "<http://h/v>"
_LAST = "the last"
_LOADED, _PATCHED, _DISPLAY = "/data/load", "/data/patched", "/topics/cockpit/display"
STREAMS = {"stream of a document": _LOADED, "stream of a topic": _DISPLAY}
OF_SPARQL = frozenset({"SELECT", "SELECT of much", "stored query", "page of a query", "update"})
"""Kinds of requests that need the query process."""


def _get(client: httpx.Client, turn: int) -> httpx.Response:
    return client.get((_DISPLAY, "/nodes/", _LOADED, "/resources/aircraft/power")[turn % 4])


def _put(client: httpx.Client, turn: int) -> httpx.Response:
    if turn % 2:
        return client.put(_DISPLAY, json={"data": f"{turn}"})
    return client.put(_LOADED, content=f"<> {_VALUE} {turn} .", headers=_TURTLE)


def _patch(client: httpx.Client, turn: int) -> httpx.Response:
    query = f"{{ SELECT ?o {{ <> {_VALUE} ?o }} ORDER BY ?o }}"
    text = f"DELETE {{ <> {_VALUE} ?o }} INSERT {{ <> {_VALUE} {turn} }} WHERE {query}"
    return client.patch(_PATCHED, content=text, headers=_UPDATE)


def _graph(client: httpx.Client, turn: int) -> httpx.Response:
    graph = {"graph": str(client.base_url.join(_PATCHED))}
    return client.get("/graphs", params=graph)


def _select(client: httpx.Client, turn: int) -> httpx.Response:
    query = f"SELECT ?n {{ <topics/cockpit/display> ros:name ?n }} #{turn}"
    return client.get("/sparql", params={"query": query}, headers=_CSV)


def _select_much(client: httpx.Client, turn: int) -> httpx.Response:
    query = f"SELECT (COUNT(*) AS ?n) {{ ?s a ?c FILTER(?c != <h:{turn}>) }}"
    return client.get("/sparql", params={"query": query}, headers=_CSV)


def _stored(client: httpx.Client, turn: int) -> httpx.Response:
    return client.get("/queries/inventory", headers=_CSV)


def _page(client: httpx.Client, turn: int) -> httpx.Response:
    path = ("/sparql?query=ASK{?s ?p ?o}", "/queries/inventory")[turn % 2]
    return client.get(path, headers={"Accept": "text/html"})


def _update(client: httpx.Client, turn: int) -> httpx.Response:
    graph = "GRAPH <data/updated>"
    text = f"DELETE WHERE {{ {graph} {{ ?s {_VALUE} ?o }} }} ; INSERT DATA {{ {graph} {{ <h:s> {_VALUE} {turn} }} }}"
    return client.post("/sparql", content=text, headers=_UPDATE)


REQUESTS: Mapping[str, Send] = {
    "GET": _get,
    "PUT": _put,
    "PATCH": _patch,
    "graph store": _graph,
    "SELECT": _select,
    "SELECT of much": _select_much,
    "stored query": _stored,
    "page of a query": _page,
    "update": _update,
}


class Load:
    """A client of each kind, each a thread with its own connection.

    `statuses` counts the responses by kind and status, 0 for a broken connection; `slowest` are seconds by kind.
    `without_retry` are the kinds of 503s without Retry-After, `events` counts the events of streams. `wrong` lists
    other faults.
    """

    def __init__(self, url: str) -> None:
        self.statuses: Counter[tuple[str, int]] = Counter()
        self.slowest: dict[str, float] = defaultdict(float)
        self.without_retry: Counter[str] = Counter()
        self.events: Counter[str] = Counter()
        self.wrong: list[str] = []
        self._url = url
        self._ended = threading.Event()
        with httpx.Client(base_url=url, timeout=PATIENCE) as client:
            for path in (_LOADED, _PATCHED):
                client.put(path, content=f"<> {_VALUE} 0 .", headers=_TURTLE).raise_for_status()
            client.put(_DISPLAY, json={"data": "0"}).raise_for_status()
        clients = [threading.Thread(target=self._ask, args=each) for each in REQUESTS.items()]
        readers = [threading.Thread(target=self._read, args=each) for each in STREAMS.items()]
        self._threads = [*clients, *readers]
        for each in self._threads:
            each.start()

    def end(self) -> None:
        """Stop sending. Streams end with the last write: if they have ended before, `wrong` lists that."""
        self._ended.set()
        clients, readers = self._threads[: len(REQUESTS)], self._threads[len(REQUESTS) :]
        for each in clients:
            each.join()
        with httpx.Client(base_url=self._url, timeout=PATIENCE) as client:
            client.put(_LOADED, content=f"<> {_VALUE} '{_LAST}' .", headers=_TURTLE).raise_for_status()
            client.put(_DISPLAY, json={"data": _LAST}).raise_for_status()
        for each in readers:
            each.join()

    def statuses_of(self, kind: str) -> set[int]:
        """Return the statuses of requests of a kind."""
        return {status for each, status in self.statuses if each == kind}

    def _ask(self, kind: str, send: Send) -> None:
        with httpx.Client(base_url=self._url, timeout=PATIENCE) as client:
            turn = 0
            while not self._ended.wait(_PAUSE):
                turn += 1
                begun = time.monotonic()
                try:
                    answer = send(client, turn)
                except httpx.HTTPError as error:
                    self.statuses[kind, 0] += 1
                    self.wrong.append(f"{kind}: {error!r}")
                    continue
                self.slowest[kind] = max(self.slowest[kind], time.monotonic() - begun)
                self.statuses[kind, answer.status_code] += 1
                if answer.status_code == 503 and not answer.headers.get("retry-after", "").isdigit():
                    self.without_retry[kind] += 1

    def _read(self, kind: str, path: str) -> None:
        headers = {"Accept": "text/event-stream"}
        try:
            with (
                httpx.Client(base_url=self._url, timeout=PATIENCE) as client,
                client.stream("GET", path, headers=headers) as stream,
            ):
                self.statuses[kind, stream.status_code] += 1
                for line in stream.iter_lines():
                    self.events[kind] += line.startswith("data:")
                    if _LAST in line:
                        return
        except httpx.HTTPError as error:
            self.wrong.append(f"{kind}: {error!r}")
        else:
            self.wrong.append(f"{kind}: it ended")


def kill(served: Served, load: Load, times: int) -> Iterator[float]:
    """Kill the query process this many times, each time once SELECTs are answered again; return the seconds until then.

    Raises AssertionError if they are not.
    """
    last: int | None = None
    for _ in range(times):
        before = {kind: load.statuses[kind, 200] for kind in ("SELECT", "SELECT of much")}
        begun = time.monotonic()
        while not (running := query_processes(served) - {last}) or any(
            load.statuses[kind, 200] == count for kind, count in before.items()
        ):
            assert time.monotonic() - begun < PATIENCE, dict(load.statuses)
            time.sleep(0.002)
        if last is not None:
            yield time.monotonic() - begun
        [last] = running
        os.kill(last, signal.SIGKILL)
