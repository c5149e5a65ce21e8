"""Pauses of the event loop in ms while a large document is put, read in every syntax and patched.

    python bench/pauses.py [--triples 1000000]

One client puts the triples, reads them in every syntax and patches them; another one sends `POST /stop` all the while.
The longest pause is measured by the server's own watchdog (`/status`), the time of the stop is that of the whole
request. Targets: 20 ms for the loop, 50 ms for the stop. The longest work is the CPU time of the loop within a pause:
on a busy machine the loop is paused as well, like a process that only sleeps.
"""

from __future__ import annotations

import argparse
import http.client
import json
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from urllib.parse import urlsplit

from web import serving

TRIPLES = 1_000_000
READS = {
    "HEAD": ("HEAD", "text/turtle"),
    "Turtle": ("GET", "text/turtle"),
    "N-Triples": ("GET", "application/n-triples"),
    "JSON-LD": ("GET", "application/ld+json"),
    "JSON": ("GET", "application/json"),
    "RDF/XML": ("GET", "application/rdf+xml"),
    "N3": ("GET", "text/n3"),
    "N-Quads": ("GET", "application/n-quads"),
    "TriG": ("GET", "application/trig"),
    "HTML": ("GET", "text/html"),
}
PATCHES = {
    "PATCH, SPARQL": ("application/sparql-update", "INSERT DATA { <> <http://purl.org/dc/terms/title> 'large' }"),
    "PATCH, N3": (
        "text/n3",
        "@prefix solid: <http://www.w3.org/ns/solid/terms#> . "
        "<#p> a solid:InsertDeletePatch ; solid:inserts { <> <http://purl.org/dc/terms/creator> 'bench' } .",
    ),
}
DOCUMENT = "/data/large"


class Client:
    """One persistent connection."""

    def __init__(self, address: str) -> None:
        self._connection = http.client.HTTPConnection(address, timeout=600)

    def ask(self, method: str, path: str, body: bytes | None = None, **headers: str) -> tuple[int, int]:
        """Return the status and the size in bytes of a response."""
        self._connection.request(method, path, body, {name.replace("_", "-"): value for name, value in headers.items()})
        answer, size = self._connection.getresponse(), 0
        while piece := answer.read(1 << 20):
            size += len(piece)
        return answer.status, size

    def read_confirmation(self) -> str:
        """Return the query that confirms a release, as the page of the stop shows it."""
        self._connection.request("GET", "/stop", headers={"Accept": "text/html"})
        return self._connection.getresponse().read().split(b'name="?confirm" value="')[1].split(b'"')[0].decode()

    def read(self, path: str) -> dict[str, float]:
        """Return a resource as JSON."""
        self._connection.request("GET", path, headers={"Accept": "application/json"})
        found: dict[str, float] = json.loads(self._connection.getresponse().read())
        return found


def turtle(triples: int) -> bytes:
    """Return Turtle with this number of values of one property."""
    return b"<> <http://example.org/p> " + b", ".join(b"%d" % number for number in range(triples)) + b" ."


def steps(address: str, triples: int) -> Iterator[tuple[str, int, int]]:
    """Yield all requests about the document: a label, and the status and size of the response."""
    client = Client(address)
    yield "PUT", *client.ask("PUT", DOCUMENT, turtle(triples), Content_Type="text/turtle")
    yield "PUT again", *client.ask("PUT", DOCUMENT, turtle(triples), Content_Type="text/turtle")
    for name, (method, accept) in READS.items():
        yield name, *client.ask(method, DOCUMENT, Accept=accept)
    for name, (media_type, text) in PATCHES.items():
        yield name, *client.ask("PATCH", DOCUMENT, text.encode(), Content_Type=media_type)
    yield "Turtle after that", *client.ask("GET", DOCUMENT, Accept="text/turtle")
    yield "DELETE", *client.ask("DELETE", DOCUMENT)


def work(address: str, triples: int) -> None:
    """Send all requests once, and report when each was finished."""
    begun = time.monotonic()
    for name, status, size in steps(address, triples):
        now = time.monotonic()
        print(json.dumps([name, status, size, begun, now]), flush=True)
        begun = now


class Presser:
    """A client that stops and releases the robot repeatedly and records the duration of each stop."""

    def __init__(self, address: str) -> None:
        self._client = Client(address)
        self._ended = threading.Event()
        self.presses: list[tuple[float, float]] = []
        self._thread = threading.Thread(target=self._press, daemon=True)
        self._thread.start()

    def _press(self) -> None:
        while not self._ended.wait(0.02):
            begun = time.monotonic()
            status, _ = self._client.ask("POST", "/stop")
            self.presses.append((begun, time.monotonic() - begun))
            assert status == 200, status
            confirm = self._client.read_confirmation()
            while self._client.ask("DELETE", f"/stop?confirm={confirm}")[0] == 409:
                time.sleep(0.005)

    def end(self) -> list[float]:
        """End, and return the seconds that each stop took."""
        self._ended.set()
        self._thread.join()
        return sorted(seconds for _, seconds in self.presses)

    def longest_between(self, begun: float, ended: float) -> float:
        """Return the seconds of the slowest stop within a period."""
        found = [took for at, took in self.presses if at <= ended and at + took >= begun]
        return max(found, default=0.0)


def idle() -> None:
    """Sleep repeatedly until the input ends, and print the longest delay of an awakening in seconds."""
    ended, latest = threading.Event(), 0.0

    def wait() -> None:
        sys.stdin.read()
        ended.set()

    threading.Thread(target=wait, daemon=True).start()
    while not ended.is_set():
        due = time.monotonic() + 0.01
        time.sleep(0.01)
        latest = max(latest, time.monotonic() - due)
    print(latest)


def bench(triples: int) -> None:
    """Serve the aircraft, send all requests in parallel with stops, print the tables."""
    beside = subprocess.Popen(
        [sys.executable, __file__, "--idle"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    with serving("-m", "rosld", "serve", "aircraft", "--port", "0") as url:
        address = urlsplit(url).netloc
        presser = Presser(address)
        command = [sys.executable, __file__, "--work", address, "--triples", str(triples)]
        print(f"{f'{triples:,} triples':22}{'status':>8}{'MB':>8}{'s':>8}{'stop at most, ms':>20}")
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as working:
            assert working.stdout is not None
            for line in working.stdout:
                name, status, size, begun, ended = json.loads(line)
                slowest = presser.longest_between(begun, ended) * 1e3
                print(f"{name:22}{status:8}{size / 1e6:8.1f}{ended - begun:8.2f}{slowest:20.1f}", flush=True)
        took = presser.end()
        told = Client(address).read("/status")
    rows = {
        "longest pause of the loop": told["longestPause"] * 1e3,
        "  of an idle process beside it": float(beside.communicate()[0]) * 1e3,
        "longest work of the loop": told["longestWork"] * 1e3,
        "POST /stop, median": statistics.median(took) * 1e3,
        "POST /stop, 99 %": took[int(0.99 * (len(took) - 1))] * 1e3,
        "POST /stop, most": took[-1] * 1e3,
    }
    for name, found in rows.items():
        print(f"{name:34}{found:10.1f} ms")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--triples", type=int, default=TRIPLES)
    parser.add_argument("--work")
    parser.add_argument("--idle", action="store_true")
    asked = parser.parse_args()
    if asked.idle:
        idle()
    elif asked.work:
        work(asked.work, asked.triples)
    else:
        bench(asked.triples)


if __name__ == "__main__":
    main()
