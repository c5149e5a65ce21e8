"""No query crashes the server: over real connections, with real processes that are killed."""

from __future__ import annotations

import os
import select
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from typing import Any
from urllib.parse import quote, urlsplit

import httpx
import pytest
from pyoxigraph import Literal, NamedNode, RdfFormat, parse

from tests.server.sparql.processes import children_of, is_running, query_processes, until_ready
from tests.waiting import once_started, until

pytestmark = pytest.mark.slow
if sys.platform != "linux":
    pytest.skip("it looks at /proc", allow_module_level=True)

# `Served` of conftest.py is the value of its fixture.
Served = Any
CROSS = "SELECT * { ?a ?b ?c . ?d ?e ?f . ?g ?h ?i . ?j ?k ?l }"
ENDLESS = f"{CROSS} ORDER BY ?a ?d ?g"
HEAVY = "SELECT (COUNT(*) AS ?n) { ?a ?b ?c . ?d ?e ?f . ?g ?h ?i . ?j ?k ?l }"
NEVER = 'FILTER(STR(?c) = CONCAT(STR(?f), STR(?i), "*", STR(?l)))'
PATIENCE = 20.0
ACCEPT = "text/csv, application/problem+json;q=0.9, text/turtle;q=0.8"


@pytest.fixture(scope="module")
def single(start_server: Callable[..., Served]) -> Served:
    """A server that runs one query at a time, for a minute; one more may wait."""
    return until_ready(start_server(
        "aircraft", "--setting", "query_time_limit", "60", "--setting", "query_concurrency", "1",
        "--setting", "query_queue", "1", "--query-row-limit", "30000", process=True,
    ))  # fmt: skip


def workers(served: Served) -> set[int]:
    """Return the processes of queries."""
    return set().union(*(children_of(pid) for pid in query_processes(served)))


def quiet(served: Served) -> None:
    """Wait until no query is running."""
    until_ready(served)
    until(lambda: not any(map(is_running, workers(served))), "no query is at work")


@pytest.fixture
def served(single: Served) -> Iterator[Served]:
    """The server that runs one query at a time, while it has none."""
    quiet(single)
    yield single
    assert single.process.poll() is None


def worker_of(served: Served) -> int:
    """Return the worker of the query that was just sent, as soon as it computes."""
    until(lambda: any(map(is_running, workers(served))), "a worker computes")
    return next(filter(is_running, workers(served)), 0) or worker_of(served)


def ends(pid: int, within: float = PATIENCE) -> bool:
    """Whether a process ends in time."""
    try:
        descriptor = os.pidfd_open(pid)
    except ProcessLookupError:
        return True
    try:
        return bool(select.select([descriptor], [], [], within)[0])
    finally:
        os.close(descriptor)


def asked(served: Served, query: str, more: str = "") -> socket.socket:
    """Open a connection on which a query was sent, and nothing read yet."""
    address = urlsplit(served.url)
    connection = socket.create_connection((address.hostname, address.port), timeout=PATIENCE)
    target = f"/sparql?query={quote(query)}{more}"
    fields = f"Host: {address.netloc}\r\nAccept: {ACCEPT}\r\nConnection: close"
    connection.sendall(f"GET {target} HTTP/1.1\r\n{fields}\r\n\r\n".encode())
    return connection


def everything(connection: socket.socket) -> bytes:
    """Return all data until the connection ends."""
    found = b""
    while data := connection.recv(65536):
        found += data
    return found


def get(served: Served, query: str, **parameters: str) -> httpx.Response:
    answer: httpx.Response = served.http.get(
        "/sparql", params={"query": query, **parameters}, headers={"Accept": ACCEPT}, timeout=PATIENCE
    )
    return answer


def stopped(answer: httpx.Response, reason: str) -> None:
    assert answer.status_code == 503, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    assert answer.json()["reason"] == reason
    assert answer.json()["detail"]


# Time limit


KINDS = {
    "a cross product": HEAVY,
    "ORDER BY": ENDLESS,
    "a property path": "SELECT (COUNT(*) AS ?n) { ?a (!<a:b>|^!<a:b>)* ?b . ?c (!<a:b>|^!<a:b>)* ?d }",
    "a regular expression": (
        'SELECT (COUNT(*) AS ?n) { ?a ?b ?c . ?d ?e ?f . ?g ?h ?i FILTER(REGEX(STR(?c), CONCAT("^(((a?){30}){30}", '
        'STR(?f), STR(?i), ")*$"))) }'
    ),
    "OPTIONAL": "SELECT (COUNT(*) AS ?n) { ?a ?b ?c "
    + "OPTIONAL { ?d ?e ?f OPTIONAL { ?g ?h ?i " * 6
    + "} } " * 6
    + "}",
    "VALUES": "SELECT (COUNT(*) AS ?n) { "
    + " ".join(f"VALUES ?v{at} {{ {' '.join(map(str, range(300)))} }}" for at in range(5))
    + "}",
    "EXISTS": "SELECT (COUNT(*) AS ?n) { ?a ?b ?c FILTER NOT EXISTS "
    "{ ?d ?e ?f . ?g ?h ?i . ?j ?k 1.5e300 } }",
    "a subquery": f"SELECT * {{ {{ {HEAVY} }} ?x ?y ?z }}",
    "CONSTRUCT": f"CONSTRUCT {{ ?a ?b ?f }} WHERE {{ {CROSS[10:-1]} {NEVER} }}",
    "ASK": f"ASK {{ {CROSS[10:-1]} {NEVER} }}",
    "what starts at one place": "SELECT (COUNT(*) AS ?n) { ?t a ros:Topic . ?t ?p ?x . ?u ?q ?x . ?u ?r ?y . "
    "?v ?s ?y . ?v ?w ?z . ?a ?w ?z . ?a ?b ?c }",
}  # fmt: skip


def test_every_kind_of_query_ends_when_its_time_is_over_and_frees_the_processor(served: Served) -> None:
    for kind, query in KINDS.items():
        # On a busy machine its time may be over before its process has started, or before the robot has been read.
        answer = once_started(lambda query=query: get(served, query, timeout="0.1"))
        stopped(answer, "time")
        assert "0.1 s" in answer.json()["detail"], kind
        quiet(served)


def test_the_time_of_a_query_is_a_number_up_to_the_limit(serve: Callable[..., Served]) -> None:
    served = until_ready(serve("aircraft", "--setting", "query_time_limit", "0.3"))
    for given in ("0", "-1", "nan", "inf", "soon", "", "1&timeout=2", "\u0661"):
        value = given if "&" in given else quote(given)
        answer = served.http.get(f"/sparql?query={quote('ASK {}')}&timeout={value}")
        assert (answer.status_code, "timeout" in answer.json()["detail"]) == (400, True), given
    answer = once_started(lambda: get(served, HEAVY, timeout="100000"))
    stopped(answer, "time")
    assert "0.3 s" in answer.json()["detail"]
    stopped(once_started(lambda: served.http.post("/sparql", data={"query": HEAVY, "timeout": "0.2"})), "time")
    assert served.http.get("/topics/aircraft/engine/speed").status_code == 200


# Memory and rows


def test_a_query_that_needs_too_much_memory_is_stopped_and_says_so(serve: Callable[..., Served]) -> None:
    served = serve("aircraft", "--setting", "query_memory_limit", str(64 * 1024 * 1024))
    answer = get(served, ENDLESS)
    stopped(answer, "memory")
    assert "memory limit of 64 MiB" in answer.json()["detail"]
    growing = 'SELECT ?z { BIND("0123456789" AS ?x0) '
    growing += (
        " ".join(f"BIND(CONCAT(?x{at}, ?x{at}) AS ?x{at + 1})" for at in range(40)) + " BIND(STRLEN(?x40) AS ?z) }"
    )
    stopped(get(served, growing), "memory")
    assert get(served, "ASK {}").status_code == 200


def test_an_answer_has_at_most_the_permitted_rows(serve: Callable[..., Served]) -> None:
    http = serve("aircraft", "--query-row-limit", "100").http
    for limit, status in ((100, 200), (101, 503)):
        for pattern, kinds in (("?s ?p ?o", ("json",)), ("?a ?b ?c . ?d ?e ?f", ("json", "xml", "csv", "tsv"))):
            for kind in kinds:
                query = f"SELECT * {{ {pattern} }} LIMIT {limit}"
                answer = http.get("/sparql", params={"query": query, "format": kind})
                assert answer.status_code == status, answer.text[:500]
                if status == 503:
                    stopped(answer, "rows")
                    assert "100 rows" in answer.json()["detail"]
        construct = f"CONSTRUCT {{ ?s ?p ?o }} WHERE {{ SELECT DISTINCT ?s ?p ?o {{ ?s ?p ?o }} LIMIT {limit} }}"
        for accept in ("text/turtle", "application/n-triples", "application/ld+json", "application/rdf+xml"):
            headers = {"Accept": f"{accept};q=0.9, application/problem+json"}
            answer = http.get("/sparql", params={"query": construct}, headers=headers)
            assert answer.status_code == status, answer.text[:500]
            if status == 503:
                stopped(answer, "rows")


def test_an_answer_that_is_stopped_after_its_first_byte_never_looks_whole(served: Served) -> None:
    # By time, which on a busy machine may be over before the first byte, and by rows.
    for tries in (("&timeout=1", "&timeout=4", "&timeout=8"), ("",)):
        for more in tries:
            with closing(asked(served, CROSS, more)) as connection:
                found = everything(connection)
            if not found.startswith(b"HTTP/1.1 503"):
                break
        head, _, body = found.partition(b"\r\n\r\n")
        assert head.startswith(b"HTTP/1.1 200")
        assert b"transfer-encoding: chunked" in head.lower()
        assert len(body) > 100_000
        assert not body.endswith(b"\r\n0\r\n\r\n")
    assert get(served, "ASK {}").status_code == 200


# Waiting and disconnecting clients


def test_a_query_whose_client_hangs_up_is_killed_and_frees_its_place(served: Served) -> None:
    with closing(asked(served, HEAVY)):
        pid = worker_of(served)
        assert not ends(pid, 0.1)
    assert ends(pid, 5)
    quiet(served)
    with closing(asked(served, CROSS.replace("?a ?b ?c", "?a ?b ?c FILTER(?b != <x:y>)"))) as connection:
        assert connection.recv(1000).startswith(b"HTTP/1.1 200")
        before = workers(served)
    until(lambda: before - workers(served), "its worker ends")
    assert get(served, "SELECT (COUNT(*) AS ?n) { ?a a ?c . ?b a ?c }").status_code == 200


def test_a_client_that_hangs_up_while_waiting_frees_its_place_in_the_queue(served: Served) -> None:
    with closing(asked(served, HEAVY)) as first:
        pid = worker_of(served)
        with closing(waiting(served, HEAVY)):
            refused(served, HEAVY)
        with closing(waiting(served, HEAVY)):
            first.close()
            assert ends(pid, 5)
            assert worker_of(served) != pid


def waiting(served: Served, query: str) -> socket.socket:
    """Open a connection whose query waits for its turn, sending it again while the queue is full."""
    until = time.monotonic() + PATIENCE
    while True:
        connection = asked(served, query)
        if not select.select([connection], [], [], 1.0)[0]:
            return connection
        assert b'"reason": "busy"' in everything(connection)
        connection.close()
        assert time.monotonic() < until, "there is no place to wait"


def refused(served: Served, query: str) -> None:
    """Check that even the queue is full for a query."""
    with closing(asked(served, query)) as connection:
        answer = everything(connection)
    assert answer.startswith(b"HTTP/1.1 503"), answer
    assert b"retry-after: 1" in answer.lower()
    assert b'"reason": "busy"' in answer


def test_a_small_query_is_answered_while_all_workers_are_busy(served: Served) -> None:
    with closing(asked(served, HEAVY)), closing(asked(served, HEAVY)):
        worker_of(served)
        assert get(served, f"SELECT ?n {{ <{served.topic('/cockpit/display')}> ros:name ?n }}").status_code == 200
        assert get(served, "SELECT ?t { ?t a ros:Topic }").status_code == 200


# Crashes


def test_a_killed_process_is_one_failure_and_other_queries_go_on(served: Served) -> None:
    for number in (signal.SIGKILL, signal.SIGSEGV):
        quiet(served)
        with closing(asked(served, HEAVY)) as connection:
            os.kill(worker_of(served), number)
            answer = everything(connection)
        assert answer.startswith(b"HTTP/1.1 500"), answer
        assert b"died before it finished" in answer
        assert get(served, "SELECT (COUNT(*) AS ?n) { ?a a ?c . ?b a ?c }").status_code == 200
    quiet(served)
    with closing(asked(served, "SELECT * { ?a ?b ?c . ?d ?e ?f FILTER(?a != ?d) }")) as connection:
        begun = connection.recv(10)
        os.kill(worker_of(served), signal.SIGKILL)
        found = begun + everything(connection)
    assert found.startswith(b"HTTP/1.1 200")
    assert not found.endswith(b"\r\n0\r\n\r\n"), "the connection breaks, so that the answer does not look whole"


def test_the_limits_are_in_the_description_of_the_service(served: Served) -> None:
    answer = served.http.get("/sparql", headers={"Accept": "text/turtle"})
    ros = "https://w3id.org/rosld#"
    told = {
        quad.predicate.value.removeprefix(ros): float(quad.object.value)
        for quad in parse(answer.content, RdfFormat.TURTLE, base_iri=f"{served.url}sparql")
        if quad.subject == NamedNode(f"{served.url}sparql")
        and quad.predicate.value.startswith(ros)
        and isinstance(quad.object, Literal)
    }
    expected = {"timeLimit": 60, "memoryLimit": 2**30, "rowLimit": 30000, "concurrencyLimit": 1, "queueLimit": 1}
    assert expected.items() <= told.items()


def test_a_long_query_is_read_without_keeping_others_waiting(aircraft: Served) -> None:
    query = "SELECT (COUNT(*) AS ?n) { VALUES ?x { " + "1 " * 20_000 + "} }"
    text = query.encode()
    address = urlsplit(aircraft.url)
    with closing(socket.create_connection((address.hostname, address.port), timeout=PATIENCE * 3)) as connection:
        fields = f"Host: {address.netloc}\r\nContent-Type: application/sparql-query\r\nAccept: {ACCEPT}"
        head = f"POST /sparql HTTP/1.1\r\n{fields}\r\nConnection: close\r\nContent-Length: {len(text)}\r\n\r\n"
        connection.sendall(head.encode() + text)
        answered = 0
        while not select.select([connection], [], [], 0)[0]:
            assert aircraft.http.get("/topics/cockpit/display").status_code == 200
            answered += 1
        found = everything(connection)
    assert found.startswith((b"HTTP/1.1 200", b"HTTP/1.1 503")), found[:300]  # a busy machine may be too slow for it
    assert answered > 5
    headers = {"Content-Type": "application/sparql-query", "Accept": ACCEPT}
    late = aircraft.http.post("/sparql", params={"timeout": "0.01"}, content=text, headers=headers)
    stopped(late, "time")
