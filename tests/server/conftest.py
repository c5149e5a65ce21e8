"""A real server over real HTTP: `rosld serve`, ended by its own handle."""

from __future__ import annotations

import gc
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, TypeAlias

import httpx
import pytest
from pyoxigraph import RdfFormat, Triple, parse

from rosld.adapters.base import AdapterOptions
from rosld.adapters.registry import adapter_for
from tests.forked import ForkedCommand
from tests.server.robots.made_up import robot, served, serving
from tests.serving_thread import ServingThread

__all__ = ["robot", "serving"]


Running: TypeAlias = "ServingThread | subprocess.Popen[str] | ForkedCommand"


class Served:
    """A running server: its process or thread, its entry URL, a client for it."""

    def __init__(self, process: Running, url: str) -> None:
        self.process = process
        self.url = url
        self.http = httpx.Client(base_url=url, timeout=60)

    def topic(self, name: str) -> str:
        """Return the URL of a topic."""
        return f"{self.url}topics{name}"

    def stop(self) -> int:
        """End it as a service manager does; return its exit code."""
        self.http.close()
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(60)


def start(
    *arguments: str, process: bool = False, python: str = sys.executable, environment: Mapping[str, str] | None = None
) -> Served:
    """Start `rosld serve ARGUMENTS` on a free port, unless they name one.

    It is a thread, a separate process for tests of processes, or the command itself with a Python and an environment.
    """
    words = ["serve", "--port", "0", *arguments]
    if environment is None and not process:
        thread = ServingThread.of_command(*words[1:])
        return Served(thread, thread.url())
    running: subprocess.Popen[str] | ForkedCommand
    if environment is None:
        running = ForkedCommand(*words)
    else:
        whole = [python, "-m", "rosld", *words]
        running = subprocess.Popen(whole, env=environment, stdout=subprocess.PIPE, text=True)
    assert running.stdout is not None
    url = running.stdout.readline().strip()
    if not url.startswith("http"):
        raise AssertionError(f"{words} printed {url!r} and ended with {running.wait(60)}")
    return Served(running, url)


@contextmanager
def servers() -> Iterator[Callable[..., Served]]:
    """Yield a function that starts servers; end those that still run."""
    running: list[Served] = []

    def started(*arguments: str, **how: Any) -> Served:
        running.append(start(*arguments, **how))
        return running[-1]

    try:
        yield started
    finally:
        for one in running:
            if one.process.poll() is None:
                one.stop()


@pytest.fixture
def serve() -> Iterator[Callable[..., Served]]:
    """Start servers that end with the test."""
    with servers() as started:
        yield started


@pytest.fixture(scope="module")
def start_server() -> Iterator[Callable[..., Served]]:
    """Start servers as `serve` does, for fixtures that outlive a test: they end with the file."""
    with servers() as started:
        yield started


@pytest.fixture(scope="module")
def frozen_heap() -> Iterator[None]:
    """Exclude the objects of other tests from garbage collection, which would block the loop for 0.2 s."""
    gc.collect()
    gc.freeze()
    yield
    gc.unfreeze()


@pytest.fixture(scope="module")
def aircraft() -> Iterator[Served]:
    """The embedded aircraft, shared by the tests of a file that do not change it."""
    served = start("aircraft", "--max-publish-rate", "100000")
    yield served
    assert served.process.poll() is None, "the server died during the tests"
    assert served.stop() == 0


@pytest.fixture(scope="module")
def plane(start_server: Callable[..., Served]) -> httpx.Client:
    """A client of an aircraft that the tests of a file change."""
    return start_server("aircraft", "--max-publish-rate", "100000").http


@pytest.fixture(scope="module")
def rover(start_server: Callable[..., Served]) -> httpx.Client:
    """A client of a rover whose odometry and battery are recorded."""
    return start_server("rover", "--history", "/odom", "--history", "/battery_state").http


@pytest.fixture
def own_aircraft() -> Iterator[httpx.Client]:
    """A client of an aircraft for one test, served by a thread: a process takes ten times as long to start."""
    with served(adapter_for("aircraft", AdapterOptions())) as client:
        client.timeout = 60
        yield client


@pytest.fixture(scope="module")
def http(aircraft: Served) -> httpx.Client:
    """A client of the aircraft."""
    return aircraft.http


@pytest.fixture(scope="session")
def triples_of() -> Callable[[httpx.Response], set[Triple]]:
    """Return the triples of a response in any RDF syntax, without graph names."""

    def read(answer: httpx.Response) -> set[Triple]:
        assert answer.status_code == 200, answer.text
        media_type = answer.headers["content-type"].partition(";")[0]
        syntax = RdfFormat.from_media_type(media_type)
        assert syntax is not None, media_type
        return {quad.triple for quad in parse(answer.content, format=syntax, base_iri=str(answer.url))}

    return read
