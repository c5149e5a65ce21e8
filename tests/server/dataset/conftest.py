"""Servers on free ports: a real Oxigraph, and one that fails as configured."""

from __future__ import annotations

import contextlib
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from itertools import takewhile
from pathlib import Path
from typing import TypeAlias

import httpx
import pytest

Behaviour: TypeAlias = "Callable[[Failing, socket.socket, bytes], bool]"


class Failing:
    """An HTTP server that fails as configured.

    It passes the body of each request to `behave`, which answers on the socket and returns False to end the connection.
    """

    def __init__(self, behave: Behaviour) -> None:
        self.behave = behave
        self.bodies: list[bytes] = []
        self.heads: list[bytes] = []
        self.ended = threading.Event()
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._listening.getsockname()[1]}/sparql"
        self._open: list[socket.socket] = []
        self._threads = [threading.Thread(target=self._accept)]
        self._threads[0].start()

    def close(self) -> None:
        self.ended.set()
        for each in (self._listening, *self._open):
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()
        for thread in self._threads:
            thread.join(60)
            assert not thread.is_alive()

    def answer(
        self, connection: socket.socket, status: str, body: bytes = b"", media_type: str = "text/plain", *more: str
    ) -> bool:
        """Send a whole response; the connection stays open."""
        lines = (f"HTTP/1.1 {status}", f"Content-Type: {media_type}", f"Content-Length: {len(body)}", *more, "", "")
        connection.sendall("\r\n".join(lines).encode() + body)
        return True

    def _accept(self) -> None:
        while not self.ended.is_set():
            try:
                connection, _ = self._listening.accept()
            except OSError:
                return
            self._open.append(connection)
            self._threads.append(threading.Thread(target=self._serve, args=(connection,)))
            self._threads[-1].start()

    def _serve(self, connection: socket.socket) -> None:
        with contextlib.suppress(OSError), connection, connection.makefile("rb") as reader:
            while True:
                head = b"".join(takewhile(lambda line: line not in (b"\r\n", b""), iter(reader.readline, None)))
                if not head:
                    return
                length = next(
                    int(line[15:]) for line in head.lower().split(b"\r\n") if line.startswith(b"content-length:")
                )
                self.heads.append(head)
                self.bodies.append(reader.read(length))
                if not self.behave(self, connection, self.bodies[-1]):
                    connection.shutdown(socket.SHUT_RDWR)
                    return


class Oxigraph:
    """The server: started, stopped and restarted on the same port, empty or with the data in `folder`."""

    def __init__(self, folder: Path | None = None) -> None:
        self.port = free_port()
        self.url = f"http://127.0.0.1:{self.port}"
        self._folder = folder
        self._process: subprocess.Popen[str] | None = None

    def start(self) -> None:
        """Start it, and wait until it listens."""
        location = ["--location", str(self._folder)] if self._folder else []
        command = [
            str(Path(sys.executable).with_name("oxigraph")),
            "serve",
            "--bind",
            f"127.0.0.1:{self.port}",
            *location,
        ]
        self._process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        assert self._process.stderr is not None
        line = self._process.stderr.readline()
        assert "Listening" in line, line

    def stop(self) -> None:
        """Stop it, and wait until it has ended."""
        process, self._process = self._process, None
        if process is not None:
            process.terminate()
            process.communicate(timeout=10)

    def update(self, text: str) -> None:
        """Carry out an update."""
        answer = httpx.post(f"{self.url}/update", content=text, headers={"Content-Type": "application/sparql-update"})
        assert answer.status_code == 204, answer.text

    def select(self, text: str) -> list[dict[str, str]]:
        """Return the rows of a query over the union of all graphs, as plain values."""
        form = {"query": text, "union-default-graph": "true"}
        answer = httpx.post(f"{self.url}/query", data=form, headers={"Accept": "application/sparql-results+json"})
        assert answer.status_code == 200, answer.text
        return [{name: term["value"] for name, term in row.items()} for row in answer.json()["results"]["bindings"]]

    def graphs(self) -> set[str]:
        """Return the names of all graphs."""
        return {row["g"] for row in self.select("SELECT DISTINCT ?g { GRAPH ?g { ?s ?p ?o } }")}


def free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port: int = free.getsockname()[1]
        return port


@pytest.fixture
def new_oxigraph() -> Iterator[Callable[..., Oxigraph]]:
    """Start servers that the test may stop; they end with it."""
    running: list[Oxigraph] = []

    def start(folder: Path | None = None) -> Oxigraph:
        running.append(Oxigraph(folder))
        running[-1].start()
        return running[-1]

    yield start
    for one in running:
        one.stop()


@pytest.fixture
def failing() -> Iterator[Callable[[Behaviour], Failing]]:
    """Start servers with this behaviour; they end with the test."""
    running: list[Failing] = []

    def start(behave: Behaviour) -> Failing:
        running.append(Failing(behave))
        return running[-1]

    yield start
    for one in running:
        one.close()
