"""Delay of SPARQL after a restart with many documents, and after a PATCH of a few triples of a large one.

    python bench/filling.py [--documents 500000] [--triples 1000000]

The documents, of four triples each, are written by the graph store, then the server is restarted on their folder.
Targets: the time is linear in the number of documents; until all are loaded, queries are answered from those loaded or
with 503, Retry-After and the progress, and no other request waits; three triples of a million are visible to a SELECT
within 50 ms.
"""

from __future__ import annotations

import argparse
import re
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager

import httpx

STEP = 5000
"""Number of documents per request."""
PATIENCE = 600.0
EX = "http://example.org/"
EVERYTHING = f"SELECT (COUNT(*) AS ?n) {{ ?s <{EX}p0> ?o }}"
FIRST = f"SELECT ?o {{ GRAPH <data/c0/d0> {{ ?s <{EX}p0> ?o }} }}"
"""A query about the document that is loaded first."""
PATCHES = 5
_PROGRESS = re.compile(r"([0-9]+) %")


@contextmanager
def serving(folder: str, port: int) -> Iterator[httpx.Client]:
    """Run a server on a folder."""
    command = [sys.executable, "-m", "rosld", "serve", "aircraft", "--data", folder, "--port", str(port)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        url = process.stdout.readline().strip()
        with httpx.Client(base_url=url, timeout=PATIENCE) as http:
            yield http
    finally:
        process.terminate()
        process.wait(PATIENCE)


def ask(http: httpx.Client, query: str) -> httpx.Response:
    """Return the answer to a query."""
    return http.get("/sparql", params={"query": query}, headers={"Accept": "text/csv, application/problem+json;q=0.5"})


def until_answered(http: httpx.Client, query: str) -> tuple[float, list[int]]:
    """Return the seconds until a query is answered, and the progress reported meanwhile."""
    begun, told = time.monotonic(), list[int]()
    while (answer := ask(http, query)).status_code == 503:
        assert answer.headers["retry-after"].isdigit(), answer.text
        found = _PROGRESS.search(answer.text)
        told += [int(found[1])] if found else []
        time.sleep(0.05)
    answer.raise_for_status()
    return time.monotonic() - begun, told


def write(http: httpx.Client, documents: int) -> None:
    """Write this number of documents."""
    for begin in range(0, documents, STEP):
        lines = []
        for number in range(begin, min(documents, begin + STEP)):
            graph = f"<{http.base_url}data/c{number // 1000}/d{number}>"
            lines += [f'{graph} <{EX}p{each}> "{number} {each}" {graph} .\n' for each in range(4)]
        while True:
            sent = {"content": "".join(lines), "headers": {"Content-Type": "application/n-quads"}}
            if (answer := http.post("/graphs?all", **sent)).status_code != 503:  # type: ignore[arg-type]
                break
            time.sleep(int(answer.headers["retry-after"]))
        answer.raise_for_status()


def restart(documents: int) -> None:
    """Print how long queries wait after a restart with this number of documents."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with tempfile.TemporaryDirectory() as folder:
        begun = time.monotonic()
        with serving(folder, port) as http:
            write(http, documents)
        written = time.monotonic() - begun
        begun = time.monotonic()
        with serving(folder, port) as http:
            started = time.monotonic() - begun
            first, _ = until_answered(http, FIRST)
            slowest, looks = 0.0, 0
            progress: list[int] = []
            while (answer := ask(http, EVERYTHING)).status_code == 503:
                found = _PROGRESS.search(answer.text)
                progress += [int(found[1])] if found else []
                asked = time.monotonic()
                http.get("/topics/aircraft/engine/speed").raise_for_status()
                slowest, looks = max(slowest, time.monotonic() - asked), looks + 1
                time.sleep(0.05)
            answer.raise_for_status()
            whole = time.monotonic() - begun
            count = int(answer.text.split()[1])
            assert count == documents, answer.text
            paused = http.get("/status", headers={"Accept": "application/json"}).json()["longestPause"]
    print(
        f"{documents:9,} documents: written in {written:6.1f} s; started in {started:4.1f} s; a graph that is there is"
    )
    print(
        f"{'':21}answered {first:4.1f} s later, everything {whole:5.1f} s after the start ({documents / whole:,.0f}/s);"
    )
    print(f"{'':21}meanwhile {looks} GETs, {slowest * 1e3:.0f} ms at most, the longest pause {paused * 1e3:.0f} ms;")
    print(f"{'':21}told: {', '.join(f'{each} %' for each in dict.fromkeys(progress))}", flush=True)


def patch(triples: int) -> None:
    """Print the delay until a SELECT sees a patch of a large document."""
    with tempfile.TemporaryDirectory() as folder, serving(folder, 0) as http:
        text = f"<> <{EX}p> " + ", ".join(map(str, range(triples))) + " ."
        begun = time.monotonic()
        http.put("/data/large", content=text, headers={"Content-Type": "text/turtle"}).raise_for_status()
        put = time.monotonic() - begun
        shown, _ = until_answered(http, f"ASK {{ <data/large> <{EX}p> {triples - 1} }}")
        patched, seen = [], []
        for turn in range(PATCHES):
            data = " ".join(f"<> <{EX}q{each}> {turn} ." for each in range(3))
            begun = time.monotonic()
            http.patch(
                "/data/large",
                content=f"INSERT DATA {{ {data} }}",
                headers={"Content-Type": "application/sparql-update"},
            ).raise_for_status()
            patched.append(time.monotonic() - begun)
            begun = time.monotonic()
            answer = ask(http, f"SELECT ?s {{ ?s <{EX}q2> {turn} }}")
            seen.append(time.monotonic() - begun)
            assert "data/large" in answer.text, answer.text
    median = statistics.median(patched)
    print(f"{triples:9,} triples in a graph: PUT {put:.1f} s, in the dataset {shown:.1f} s later;")
    print(f"{'':21}a PATCH of three takes {median:.2f} s, the next SELECT that sees them", end=" ")
    print(f"{statistics.median(seen) * 1e3:.0f} ms, {max(seen) * 1e3:.0f} ms at most", flush=True)


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--documents", type=int, default=500_000)
    parser.add_argument("--triples", type=int, default=1_000_000)
    asked = parser.parse_args()
    patch(asked.triples)
    for documents in (asked.documents // 10, asked.documents):
        restart(documents)


if __name__ == "__main__":
    main()
