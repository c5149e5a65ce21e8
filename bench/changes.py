"""Small changes to a document of 300,000 triples, compared to reading it; latency of another client meanwhile.

Run: python bench/changes.py [triples]. The target is 3 s for each; the baseline is a GET of the document in N-Triples.
"""

from __future__ import annotations

import statistics
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

import httpx
from web import serving

TRIPLES = 300_000
ROUNDS = 3
EX = "http://example.org/"
SOLID = "@prefix solid: <http://www.w3.org/ns/solid/terms#> . <#patch> a solid:InsertDeletePatch ; "
UPDATE = "application/sparql-update"
N_TRIPLES = {"Accept": "application/n-triples"}


class Change(NamedTuple):
    """A request that changes one or a few triples, with a unique number and the graph."""

    name: str
    method: str
    path: str
    media_type: str
    body: str


CHANGES = (
    Change("PATCH INSERT DATA", "PATCH", "data/x", UPDATE, "INSERT DATA {{ <> <{ex}a> {n} }}"),
    Change("PATCH DELETE DATA", "PATCH", "data/x", UPDATE, "DELETE DATA {{ <{url}> <{ex}a> {n} }}"),
    Change("PATCH DELETE WHERE", "PATCH", "data/x", UPDATE, "DELETE WHERE {{ <{ex}s1{n}> ?p ?o }}"),
    Change("N3 Patch", "PATCH", "data/x", "text/n3", SOLID + "solid:inserts {{ <> <{ex}b> {n} }} ."),
    Change("POST of a triple", "POST", "data/x", "text/turtle", "<> <{ex}c> {n} ."),
    Change("update INSERT DATA", "POST", "sparql", UPDATE, "INSERT DATA {{ GRAPH <{url}> {{ <{url}> <{ex}d> {n} }} }}"),
    Change("update with WHERE", "POST", "sparql", UPDATE, "WITH <{url}> DELETE {{ ?s ?p ?o }} INSERT {{ ?s ?p {n} }} "
           "WHERE {{ BIND(<{ex}s2{n}> AS ?s) ?s ?p ?o }}"),
)  # fmt: skip


def document(triples: int) -> bytes:
    """Return a document with this number of triples, five per subject."""
    lines = (b"e:s%d e:p%d %d .\n" % (number // 5, number % 5, number) for number in range(triples))
    return b"@prefix e: <http://example.org/> .\n" + b"".join(lines)


@contextmanager
def neighbour(url: str) -> Iterator[list[float]]:
    """A client that sends small requests all the time, and its latencies in seconds."""
    waited: list[float] = []
    ended = threading.Event()

    def ask() -> None:
        with httpx.Client(base_url=url, timeout=60) as http:
            while not ended.wait(0.01):
                began = time.perf_counter()
                http.get("status").raise_for_status()
                waited.append(time.perf_counter() - began)

    thread = threading.Thread(target=ask)
    thread.start()
    try:
        yield waited
    finally:
        ended.set()
        thread.join()


def seconds(work: Callable[[], httpx.Response]) -> float:
    """Return the duration of a request in seconds."""
    began = time.perf_counter()
    work().raise_for_status()
    return time.perf_counter() - began


def main() -> None:
    """Print the table."""
    triples = int(sys.argv[1]) if len(sys.argv) > 1 else TRIPLES
    with (
        tempfile.TemporaryDirectory() as folder,
        serving("-m", "rosld", "serve", "aircraft", "--port", "0", "--data", folder) as url,
        httpx.Client(base_url=url, timeout=300) as http,
    ):
        http.put("data/x", content=document(triples), headers={"Content-Type": "text/turtle"}).raise_for_status()

        def read(number: int) -> float:
            """Read the document after a change, so that it is rendered again."""
            http.patch("data/x", content=f"INSERT DATA {{ <> <{EX}read> {number} }}", headers={"Content-Type": UPDATE})
            return seconds(lambda: http.get("data/x", headers=N_TRIPLES))

        with neighbour(url) as waited:
            reading = statistics.median(read(number) for number in range(ROUNDS))
        print(f"{f'{triples} triples':28}{'seconds':>9}{'of a GET':>10}{'others wait, ms, p50':>22}{'longest':>9}")
        _line("GET in N-Triples", reading, reading, waited)
        for change in CHANGES:
            with neighbour(url) as waited:
                taken = statistics.median(_carry_out(http, change, f"{url}data/x", number) for number in range(ROUNDS))
            _line(change.name, taken, reading, waited)


def _carry_out(http: httpx.Client, change: Change, graph: str, number: int) -> float:
    body = change.body.format(n=number, url=graph, ex=EX)
    headers = {"Content-Type": change.media_type}
    return seconds(lambda: http.request(change.method, change.path, content=body, headers=headers))


def _line(name: str, taken: float, reading: float, waited: list[float]) -> None:
    ms = [each * 1000 for each in waited] or [0.0]
    print(f"  {name:26}{taken:9.2f}{taken / reading:10.2f}{statistics.median(ms):22.1f}{max(ms):9.0f}", flush=True)


if __name__ == "__main__":
    main()
