"""A crash of the query process affects nothing else: over real connections, with real signals."""

from __future__ import annotations

import os
import signal
import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlsplit

import httpx
import pytest

from tests.server.sparql.killing import OF_SPARQL, OPTIONS, REQUESTS, STREAMS, Load, kill
from tests.server.sparql.processes import children_of, command_of, is_running, query_processes
from tests.waiting import until

pytestmark = pytest.mark.slow
if sys.platform != "linux":
    pytest.skip("it looks at /proc", allow_module_level=True)

# `Served` of conftest.py is the value of its fixture.
Served = Any
PATIENCE = 60.0
KILLS = 4
ACCEPT = {"Accept": "text/csv, application/problem+json;q=0.9"}
TURTLE = {"Content-Type": "text/turtle"}
COUNT = "SELECT (COUNT(*) AS ?n) { ?s <http://h/size> ?o }"
HEAVY = "SELECT (COUNT(*) AS ?n) { ?a ?b ?c . ?d ?e ?f . ?g ?h ?i . ?j ?k ?l }"


@pytest.fixture(scope="module")
def served(start_server: Callable[..., Served]) -> Iterator[Served]:
    one = start_server("aircraft", "--max-publish-rate", "100000", process=True)
    yield one
    assert one.process.poll() is None, "the server died"


def process_of(served: Served, other_than: int | None = None) -> int:
    """Return the query process, as soon as there is one (different from `other`)."""
    pid: int
    [pid] = until(lambda: query_processes(served) - {other_than}, "a query process")
    return pid


def has_ended(pid: int) -> bool:
    """Whether a process has ended, or is a zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except (FileNotFoundError, ProcessLookupError):
        return True


def ask(served: Served, query: str) -> httpx.Response:
    answer: httpx.Response = served.http.get("/sparql", params={"query": query}, headers=ACCEPT)
    return answer


def answered(served: Served, query: str) -> str:
    """Return the response, repeating the request while the server sends Retry-After."""

    def answer() -> httpx.Response | None:
        found = ask(served, query)
        assert found.status_code != 503 or found.headers["retry-after"].isdigit()
        return None if found.status_code == 503 else found

    found = until(answer, "an answer")
    assert found.status_code == 200, found.text
    text: str = found.text
    return text


def working(pid: int) -> set[int]:
    """Return the workers of a query process, once one of them computes."""
    workers = children_of(pid)
    return workers if any(map(is_running, workers)) else set()


def name(served: Served) -> str:
    return f"SELECT ?n {{ <{served.topic('/cockpit/display')}> ros:name ?n }}"


def test_a_query_process_that_is_killed_is_replaced_and_knows_all_that_the_last_one_knew(served: Served) -> None:
    assert served.http.put("/data/p", content="<> <http://h/v> 1 .", headers=TURTLE).status_code == 201
    graphs = "SELECT DISTINCT ?g { GRAPH ?g { ?s ?p ?o } FILTER(!CONTAINS(STR(?g), '/activity')) } ORDER BY ?g"
    before = answered(served, graphs)
    for number in (signal.SIGKILL, signal.SIGTERM):
        pid = process_of(served)
        os.kill(pid, number)
        assert served.http.get("/data/p").status_code == 200
        assert served.http.put("/data/q", content="<> <http://h/v> 2 .", headers=TURTLE).status_code in (201, 204)
        assert answered(served, "SELECT ?v { <data/q> <http://h/v> ?v }") == "v\r\n2\r\n"
        assert served.http.delete("/data/q").status_code == 204
        process_of(served, other_than=pid)
        assert answered(served, graphs) == before
        assert has_ended(pid)


def test_killed_again_and_again_under_load_it_costs_queries_a_503_and_others_nothing(
    serve: Callable[..., Served],
) -> None:
    served = serve("aircraft", *OPTIONS, process=True)
    answered(served, name(served))
    load = Load(served.url)
    try:
        for _ in kill(served, load, KILLS):
            pass
    finally:
        load.end()
    assert not load.wrong
    assert not load.without_retry
    for kind in REQUESTS:
        may_be = {200, 204, 503} if kind in OF_SPARQL else {200, 201, 204}
        assert load.statuses_of(kind) <= may_be, (kind, load.statuses)
        assert load.statuses_of(kind) & {200, 201, 204}, (kind, load.statuses)
    assert {load.statuses[kind, 200] for kind in STREAMS} == {1}
    assert all(load.events[kind] > KILLS for kind in STREAMS), load.events
    assert any(load.statuses[kind, 503] for kind in OF_SPARQL), load.statuses
    assert answered(served, name(served))


def test_a_query_that_ends_its_worker_is_500_and_named_in_the_log_and_nothing_else_notices(
    serve: Callable[..., Served], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """A function that ends its process stands for any crash in the library."""
    (tmp_path / "sitecustomize.py").write_text(
        "import os, sys\n"
        "if 'sparql.process' in ' '.join(sys.orig_argv):\n"
        "    from rosld.server.dataset.private_functions import FUNCTIONS\n"
        "    FUNCTIONS['http://h/abort'] = lambda *terms: os.abort()\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    served = serve("aircraft", environment=environment)
    display, pid = served.topic("/cockpit/display"), process_of(served)
    for query in (
        f"SELECT ?n {{ <{display}> ros:name ?n FILTER(<http://h/abort>(?n)) }}",
        "SELECT (COUNT(*) AS ?n) { ?s ?p ?o FILTER(<http://h/abort>(?o)) }",
    ):
        answer = ask(served, query)
        assert (answer.status_code, answer.headers["content-type"]) == (500, "application/problem+json"), answer.text
        assert served.http.get("/topics/cockpit/display").status_code == 200
        assert answered(served, name(served))
    assert process_of(served) == pid
    assert "<http://h/abort>" in capfd.readouterr().err


def test_while_what_clients_keep_is_read_anew_queries_are_503_with_how_far_it_is(served: Served) -> None:
    for number in range(6):
        lines = "".join(f'<http://h/{number}-{line}> <http://h/size> "{"x" * 1000}" .\n' for line in range(1000))
        headers = {"Content-Type": "application/n-triples"}
        assert served.http.put(f"/data/d{number}", content=lines, headers=headers).status_code == 201
    assert answered(served, COUNT) == "n\r\n6000\r\n"
    pid = process_of(served)
    os.kill(pid, signal.SIGKILL)
    new = process_of(served, pid)
    os.kill(new, signal.SIGSTOP)
    try:
        asked = {"query": "ASK { <http://h/1-1> ?p ?o }", "timeout": "0.2"}
        answer = served.http.get("/sparql", params=asked, headers=ACCEPT)
        assert answer.status_code == 503
        assert answer.headers["retry-after"].isdigit()
        assert "% done" in answer.json()["detail"]
        assert served.http.get("/data/d1").status_code == 200
        assert served.http.put("/data/other", content="<> <http://h/size> 1 .", headers=TURTLE).status_code == 201
    finally:
        os.kill(new, signal.SIGCONT)
    assert answered(served, COUNT) == "n\r\n6001\r\n"


def test_whatever_is_at_work_ends_with_the_server_even_if_that_is_killed(serve: Callable[..., Served]) -> None:
    for number in (signal.SIGTERM, signal.SIGKILL):
        served = serve("aircraft", "--setting", "query_time_limit", "60", process=True)
        pid = process_of(served)
        address = urlsplit(served.url)
        with closing(socket.create_connection((address.hostname, address.port), timeout=PATIENCE)) as connection:
            target = f"/sparql?query={quote(HEAVY)}"
            connection.sendall(f"GET {target} HTTP/1.1\r\nHost: {address.netloc}\r\n\r\n".encode())
            workers = until(lambda pid=pid: working(pid), "a worker computes")
            served.process.send_signal(number)
            served.process.wait(PATIENCE)
            until(lambda pid=pid, workers=workers: all(map(has_ended, (pid, *workers))), "their ends")
            assert "sparql.process" not in command_of(pid)
