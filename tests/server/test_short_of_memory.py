"""Lack of memory: requests that do not fit are refused, and the server and its query process survive.

Each is limited to the address space that it has, the margin, and a few MiB.
"""

from __future__ import annotations

import asyncio
import pickle
import random
import resource
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from rosld.server.runtime.process_memory import (
    CACHE_SECONDS,
    MARGIN,
    Memory,
    NotEnoughMemory,
    available_bytes,
    cgroup_available_bytes,
    is_out_of_memory,
)
from rosld.server.sparql.process.client import QueryProcess
from rosld.server.sparql.process.work import ListGraphs
from rosld.server.sparql.query_limits import Limits
from tests.server.disks.server import Server, server_on
from tests.server.sparql.processes import query_processes

MIB = 1024 * 1024
SPARE = 40 * MIB
"""Bytes that a limited process may still allocate, besides the margin."""
PATIENCE = 60.0
TURTLE = {"Content-Type": "text/turtle"}
UPDATE = {"Content-Type": "application/sparql-update"}
COUNT = "SELECT (COUNT(*) AS ?n) WHERE { GRAPH ?g { ?s ?p ?o } }"
SERVER, QUERIES = "the server", "the query process"

pytestmark = pytest.mark.slow
if sys.platform != "linux":
    pytest.skip("it limits processes, and looks at /proc", allow_module_level=True)


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Server]:
    """A server that has handled all kinds of requests, so that its threads and its heaps exist."""
    with server_on(tmp_path / "data", tmp_path / "log") as served:
        served.start()
        for _ in range(3):
            assert put(served, "first", 500).status_code in {201, 204}
            assert update(served, "second", 500).status_code == 204
            assert asked(served).status_code == 200
        yield served


def address_space(pid: int) -> int:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[0]) * resource.getpagesize()


def limit(pid: int, spare: int = SPARE) -> int:
    """Limit the further memory of a process, besides the margin; return the limit, which applies from then on."""
    most = address_space(pid) + MARGIN + spare
    resource.prlimit(pid, resource.RLIMIT_AS, (most, most))
    time.sleep(CACHE_SECONDS)  # resets earlier measurements
    return most


def pid_of(server: Server, which: str) -> int:
    assert server.process is not None
    if which == SERVER:
        return server.process.pid
    [pid] = query_processes(server)
    return pid


def triples(number: int) -> str:
    chance = random.Random(number)
    return "".join(f"<#s{chance.getrandbits(40)}> <http://e.org/p{i % 9}> {i} .\n" for i in range(number))


def put(server: Server, name: str, number: int) -> httpx.Response:
    return server.http.put(f"/data/{name}", content=triples(number), headers=TURTLE)


def post(server: Server, name: str, number: int) -> httpx.Response:
    return server.http.post("/data/", content=triples(number), headers={**TURTLE, "Slug": name})


def update(server: Server, name: str, number: int) -> httpx.Response:
    body = f"INSERT DATA {{ GRAPH <{server.http.base_url}data/{name}> {{ {triples(number)} }} }}"
    return server.http.post("/sparql", content=body, headers=UPDATE)


def update_by_query(server: Server, name: str, number: int) -> httpx.Response:
    body = f"INSERT {{ GRAPH <{server.http.base_url}data/{name}> {{ {triples(number)} }} }} WHERE {{ BIND(1 AS ?one) }}"
    return server.http.post("/sparql", content=body, headers=UPDATE)


def asked(server: Server) -> httpx.Response:
    """Return the result of a query, once the query process is ready, or cannot be."""
    accept = "text/csv, application/problem+json;q=0.5"
    until = time.monotonic() + PATIENCE
    while True:
        answer = server.http.get("/sparql", params={"query": COUNT}, headers={"Accept": accept})
        is_starting = answer.status_code == 503 and answer.json()["reason"] == "starting"
        if not is_starting or time.monotonic() > until:
            return answer
        time.sleep(0.1)


def require_alive(server: Server) -> None:
    assert server.process is not None
    assert server.process.poll() is None, server.log.read_text()[-3000:]
    assert server.http.get("/").status_code == 200
    assert server.http.post("/stop").status_code in (200, 201, 204)


def require_lack_of_memory(answer: httpx.Response, status: int) -> None:
    assert answer.status_code == status, answer.text
    assert "MiB" in answer.json()["detail"]
    assert answer.json()["reason"] == "memory"


def grow(server: Server, send: Callable[[Server, str, int], httpx.Response]) -> int:
    """Send more and more data, with a query after each, until it is refused; return the number of accepted requests."""
    queries = pid_of(server, QUERIES)
    for number in range(9):
        answer = send(server, str(number), 1000 * 2**number)
        query = asked(server)
        if query.status_code != 200:
            require_lack_of_memory(query, 503)
        require_alive(server)
        assert pid_of(server, QUERIES) == queries, server.log.read_text()[-3000:]
        if answer.status_code not in {201, 204}:
            require_lack_of_memory(answer, 507)
            return number
    raise AssertionError("nothing was refused")


def test_documents_and_updates_that_need_more_memory_than_there_is_are_refused(server: Server) -> None:
    most = limit(pid_of(server, SERVER))
    made = grow(server, put)
    assert made
    for send in (post, update):
        require_lack_of_memory(send(server, "more", 1000 * 2**made), 507)
    assert put(server, "small", 1).status_code == 201
    server.kill()
    server.start(address_space=most)
    assert {server.http.head(f"/data/{number}").status_code for number in range(made)} == {200}
    for _ in range(2):
        query = asked(server)
        if query.status_code != 200:
            require_lack_of_memory(query, 503)
    require_alive(server)
    assert server.http.delete("/data/0").status_code == 204


@pytest.mark.parametrize("which", [SERVER, QUERIES])
def test_an_index_that_needs_more_memory_than_there_is_is_not_built_and_all_else_is_served(
    server: Server, which: str
) -> None:
    for number in range(3):
        assert put(server, str(number), 30_000).status_code == 201
    queries = pid_of(server, QUERIES)
    limit(pid_of(server, which))
    for _ in range(2):
        require_lack_of_memory(asked(server), 503)
        require_alive(server)
    assert put(server, "small", 1).status_code == 201
    for number in range(3):
        assert server.http.delete(f"/data/{number}").status_code == 204
    answer = asked(server)
    assert answer.status_code == 200, answer.text + server.log.read_text()
    if which == QUERIES:
        assert grow(server, update_by_query)
        require_many_small_changes(server)
    assert pid_of(server, QUERIES) == queries, server.log.read_text()[-3000:]


def require_many_small_changes(server: Server) -> None:
    """Check that a query process without memory refuses small changes, too, and survives."""
    refused = 0
    for number in range(200):
        assert put(server, f"small-{number}", 400).status_code == 201
        answer = asked(server)
        if answer.status_code != 200:
            require_lack_of_memory(answer, 503)
            refused += answer.json()["detail"].startswith("The dataset")
        if refused == 4:
            break
    assert refused == 4
    require_alive(server)


def lines(number: int, first: int = 0) -> str:
    return "".join(f"<http://h/s{i}> <http://h/p> <http://h/o> .\n" for i in range(first, first + number))


async def graphs(process: QueryProcess) -> Any:
    limits = Limits(20.0, 256 * MIB)
    return pickle.loads(await process.result(ListGraphs(), limits, time.monotonic() + limits.seconds))


async def fill_with_garbage(process: QueryProcess) -> None:
    started, graph = asyncio.Event(), "http://h/g"
    process.starts.watch(started.set)
    for number in range(3):  # removed data is not freed
        process.change({graph: lines(10_000, 10_000 * number)})
    await graphs(process)
    assert process.pid is not None
    limit(process.pid, -8 * MIB)
    with pytest.raises(NotEnoughMemory):
        process.change({graph: lines(10_000)})
    await started.wait()
    process.change({graph: lines(10_000)})
    assert await graphs(process) == [graph]


async def test_a_query_process_full_of_garbage_is_replaced() -> None:
    process = QueryProcess(2, 4)
    await process.start()
    try:
        await asyncio.wait_for(fill_with_garbage(process), PATIENCE)
    finally:
        await process.close()


def test_a_need_beyond_the_available_memory_is_refused_with_both_sizes() -> None:
    left = available_bytes()
    assert left is None or left > 0
    memory = Memory(lambda: MARGIN + 1000 * 1024 * 1024)
    memory.require(900 * 1024 * 1024, "a body of 9 bytes")
    with pytest.raises(NotEnoughMemory, match="A body of 9 bytes may need 1001 MiB of memory, but 1000 MiB are left"):
        memory.require(1001 * 1024 * 1024, "a body of 9 bytes")


def test_a_need_counts_until_memory_is_measured_again() -> None:
    measured = list[int]()

    def measure() -> int:
        measured.append(1)
        return MARGIN + 100

    memory = Memory(measure)
    for _ in range(100):
        memory.require(10, "a body")
    assert 1 < len(measured) < 60


def test_errors_that_mean_a_lack_of_memory_are_recognized() -> None:
    for error in (MemoryError(), OSError(12, "Cannot allocate memory"), RuntimeError("can't start new thread")):
        assert is_out_of_memory(error)
    for other in (RuntimeError("something else"), OSError(2, "No such file or directory")):
        assert not is_out_of_memory(other)


def test_a_container_has_the_least_memory_that_its_groups_leave(tmp_path: Path) -> None:
    groups = "1:cpu:/\n0::/a/b\n"
    for path, most in (("a/b", "max"), ("a", "1000"), ("", "2000")):
        folder = tmp_path / path
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "memory.max").write_text(f"{most}\n")
        (folder / "memory.current").write_text("700\n")
        (folder / "memory.stat").write_text("anon 1\ninactive_file 50\n")
    assert min(cgroup_available_bytes(groups, tmp_path)) == 350
    shutil.rmtree(tmp_path / "a")  # as within a container, whose own group appears as the root
    assert list(cgroup_available_bytes(groups, tmp_path)) == [1350]
