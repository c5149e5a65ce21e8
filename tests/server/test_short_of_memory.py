"""Short of memory: what there is none for is refused, and the server lives."""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest

from rosld.server.memory import MARGIN, Memory, NotEnoughMemory, available, is_shortage, of_groups
from tests.server.disks.server import Server, server_on

ADDRESS_SPACE = 1100 * 1024 * 1024
"""Bytes: some hundred more than a server that has just started."""
FEW = 760 * 1024 * 1024
TURTLE = {"Content-Type": "text/turtle"}
UPDATE = {"Content-Type": "application/sparql-update"}
COUNT = "SELECT (COUNT(*) AS ?n) WHERE { GRAPH ?g { ?s ?p ?o } }"


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Server]:
    with server_on(tmp_path / "data", tmp_path / "log") as served:
        yield served


def limited(server: Server) -> None:
    """Start it with little memory."""
    server.start(address_space=ADDRESS_SPACE)


def triples(number: int) -> str:
    chance = random.Random(number)
    return "".join(f"<#s{chance.getrandbits(40)}> <http://e.org/p{i % 9}> {i} .\n" for i in range(number))


def asked(server: Server) -> httpx.Response:
    return server.http.get("/sparql", params={"query": COUNT}, headers={"Accept": "text/csv"})


def require_alive(server: Server) -> None:
    assert server.process is not None
    assert server.process.poll() is None, server.log.read_text()[-3000:]
    assert server.http.get("/").status_code == 200
    assert server.http.post("/stop").status_code in (200, 201, 204)


def grow(server: Server, send: Callable[[int], httpx.Response], done: int) -> int:
    """Send more and more, with a query after each, until it is refused; how many were not."""
    for number in range(1, 40):
        answer = send(number)
        query = asked(server)
        assert query.status_code in {200, 503}, query.text
        require_alive(server)
        if answer.status_code != done:
            assert answer.status_code in {503, 507}, answer.text
            assert "memory" in answer.json()["detail"]
            return number - 1
    raise AssertionError("nothing was refused")


def test_documents_that_there_is_no_memory_for_are_refused_and_the_server_lives(server: Server) -> None:
    limited(server)

    def put(number: int) -> httpx.Response:
        return server.http.put(f"/data/{number}", content=triples(min(9000 * number, 60_000)), headers=TURTLE)

    made = grow(server, put, 201)
    assert made
    assert server.http.put("/data/small", content="<> a <http://e.org/Small> .", headers=TURTLE).status_code == 201
    server.kill()
    limited(server)
    assert {server.http.head(f"/data/{number + 1}").status_code for number in range(made)} == {200}
    for _ in range(2):
        assert asked(server).status_code in {200, 503}
    require_alive(server)
    assert server.http.delete("/data/1").status_code == 204


def test_an_index_that_there_is_no_memory_for_is_not_built_and_all_else_is_served(server: Server) -> None:
    server.start()
    for number in range(3):
        answer = server.http.put(f"/data/{number}", content=triples(60_000), headers=TURTLE)
        assert answer.status_code == 201, answer.text
    server.kill()
    server.start(address_space=FEW)
    for _ in range(2):
        answer = asked(server)
        assert answer.status_code == 503, answer.text
        assert "MiB of memory" in answer.json()["detail"]
        require_alive(server)
    assert server.http.put("/data/small", content="<> a <http://e.org/Small> .", headers=TURTLE).status_code == 201
    for number in range(3):
        assert server.http.delete(f"/data/{number}").status_code == 204
    answer = asked(server)
    assert answer.status_code == 200, answer.text + server.log.read_text()


def test_updates_that_there_is_no_memory_for_are_refused_and_the_server_lives(server: Server) -> None:
    limited(server)

    def update(number: int) -> httpx.Response:
        graph = f"{server.http.base_url}data/{number}"
        body = f"INSERT DATA {{ GRAPH <{graph}> {{ {triples(min(9000 * number, 60_000))} }} }}"
        return server.http.post("/sparql", content=body, headers=UPDATE)

    assert grow(server, update, 204)


def test_what_may_be_taken_is_told_and_what_is_more_is_refused_with_both_sizes() -> None:
    left = available()
    assert left is None or left > 0
    memory = Memory(lambda: MARGIN + 1000 * 1024 * 1024)
    memory.require(900 * 1024 * 1024, "a body of 9 bytes")
    with pytest.raises(NotEnoughMemory, match="A body of 9 bytes may need 1001 MiB of memory, and 1000 MiB are left"):
        memory.require(1001 * 1024 * 1024, "a body of 9 bytes")


def test_what_was_asked_for_a_moment_ago_counts() -> None:
    measured = list[int]()

    def measure() -> int:
        measured.append(1)
        return MARGIN + 100

    memory = Memory(measure)
    for _ in range(100):
        memory.require(10, "a body")
    assert 1 < len(measured) < 60


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (MemoryError(), True),
        (OSError(12, "Cannot allocate memory"), True),
        (RuntimeError("can't start new thread"), True),
        (RuntimeError("something else"), False),
        (OSError(2, "No such file or directory"), False),
    ],
)
def test_errors_that_tell_of_a_lack_of_memory_are_known(error: Exception, expected: bool) -> None:
    assert is_shortage(error) is expected


@pytest.mark.parametrize(
    ("groups", "place", "limit", "used", "files"),
    [
        ("0::/a/b\n", "", "memory.max", "memory.current", "inactive_file"),
        (
            *("1:cpu:/\n4:memory:/a/b\n0::/\n", "memory"),
            *("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
        ),
    ],
    ids=["version 2", "version 1"],
)
def test_what_a_container_leaves_is_the_least_that_its_groups_do(
    tmp_path: Path, groups: str, place: str, limit: str, used: str, files: str
) -> None:
    for path, most in (("a/b", "max"), ("a", "1000"), ("", "2000")):
        folder = tmp_path / place / path
        folder.mkdir(parents=True, exist_ok=True)
        (folder / limit).write_text(f"{most}\n")
        (folder / used).write_text("700\n")
        (folder / "memory.stat").write_text(f"anon 1\n{files} 50\n")
    assert min(of_groups(groups, tmp_path)) == 350
    shutil.rmtree(tmp_path / place / "a")  # as within a container, which sees its own group as the top
    assert list(of_groups(groups, tmp_path)) == [1350]
