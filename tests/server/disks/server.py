"""A robot on a data folder, as a process that may be killed, on a fixed port."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import httpx

from tests.forked import ForkedCommand


def free_port() -> int:
    """Return an unused port."""
    with socket.create_server(("127.0.0.1", 0)) as sock:
        return int(sock.getsockname()[1])


class Server:
    """A server on a folder that can be restarted. Its log is in `log`.

    It is a fork if possible (five times as quick to start), otherwise a new process, which can have an environment of
    its own or a limit of its address space.
    """

    def __init__(
        self,
        folder: Path,
        log: Path,
        environment: Mapping[str, str] | None = None,
        source: str = "aircraft",
        forked: bool = False,
    ) -> None:
        self.http = httpx.Client(timeout=30)
        self.folder = folder
        self.log = log
        self.process: subprocess.Popen[str] | ForkedCommand | None = None
        self._environment = {**os.environ, **(environment or {})}
        self._forked = forked
        self._words = ["serve", source, "--data", str(folder), "--port", str(free_port())]

    def start(self, *options: str, address_space: int | None = None) -> None:
        """Start it, with a limit of address space in bytes, and wait until it serves."""
        limit = [] if address_space is None else ["prlimit", f"--as={address_space}"]
        command = [*limit, sys.executable, "-m", "rosld", *self._words, *options]
        with self.log.open("a") as log:
            if self._forked:
                self.process = ForkedCommand(*self._words, *options, errors=log.fileno())
            else:
                self.process = subprocess.Popen(
                    command, env=self._environment, stdout=subprocess.PIPE, stderr=log, text=True
                )
        assert self.process.stdout is not None
        url = self.process.stdout.readline().strip()
        assert url.startswith("http"), self.log.read_text()
        self.http.base_url = httpx.URL(url)

    def kill(self) -> None:
        """Kill it, as a crash would."""
        assert self.process is not None
        self.process.kill()
        self._wait()

    def stop(self) -> int:
        """End it as a service manager does; return its exit code."""
        assert self.process is not None
        self.process.send_signal(signal.SIGTERM)
        return self._wait(15)

    def _wait(self, timeout: float | None = None) -> int:
        assert self.process is not None
        code = self.process.wait(timeout)
        assert self.process.stdout is not None
        self.process.stdout.close()
        return code


@contextmanager
def server_on(
    folder: Path,
    log: Path,
    environment: Mapping[str, str] | None = None,
    source: str = "aircraft",
    forked: bool = False,
) -> Iterator[Server]:
    """Return a server that is not started yet, and ends with the test."""
    server = Server(folder, log, environment, source, forked)
    try:
        yield server
    finally:
        server.http.close()
        if server.process is not None and server.process.poll() is None:
            server.kill()
