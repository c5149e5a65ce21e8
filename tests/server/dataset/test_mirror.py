"""The mirror: another store converges to the dataset in spite of any failure, and never blocks anything else."""

from __future__ import annotations

import shutil
import socket
import threading
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, Any, TypeAlias
from urllib.parse import parse_qs

import httpx
import pytest
from pyoxigraph import QueryResultsFormat, Store

from tests.server.dataset.conftest import Failing
from tests.server.robots.made_up import MadeUp, served
from tests.waiting import until

if TYPE_CHECKING:
    from tests.server.conftest import Served
    from tests.server.dataset.conftest import Behaviour, Oxigraph

pytestmark = pytest.mark.slow

Serve: TypeAlias = "Callable[..., Served]"
NewOxigraph: TypeAlias = "Callable[..., Oxigraph]"
TURTLE, UPDATE = {"Content-Type": "text/turtle"}, {"Content-Type": "application/sparql-update"}
OTHER = "http://elsewhere/g"
P = "<http://h/p>"
JSON = "application/sparql-results+json"
RATE = ("--store-rate", "20")


def mirror(http: httpx.Client) -> dict[str, Any]:
    found: dict[str, Any] = http.get("mirror", headers={"Accept": "application/json"}).json()
    return found


def is_told(http: httpx.Client) -> bool:
    """Whether the store has everything."""
    found = mirror(http)
    return found["failure"] is None and found["lag"] == 0


def listed(http: httpx.Client) -> set[str]:
    """Return the graphs of the dataset."""
    query = {"query": "SELECT DISTINCT ?g { GRAPH ?g { ?s ?p ?o } }"}
    return set(http.get("sparql", params=query, headers={"Accept": "text/csv"}).text.split()[1:])


def test_one_query_spans_two_robots_and_neither_drops_the_others_graphs(
    serve: Serve, new_oxigraph: NewOxigraph, tmp_path: Path
) -> None:
    """One of them is killed and restarted; an orderly end removes the data that was only true of the run."""
    oxigraph = new_oxigraph()
    options = ("--store", oxigraph.url, *RATE, "--subscribe", "*")
    one = serve("aircraft", *options)
    two = serve("aircraft", *options, "--data", str(tmp_path), process=True)
    assert two.http.put("data/note", content=f'<> {P} "kept" .', headers=TURTLE).status_code == 201

    def topics() -> dict[str, str]:
        data = "<https://w3id.org/rosld/types/std_msgs/msg/Float64#data>"
        ros = "https://w3id.org/rosld#"
        rows = oxigraph.select(f"SELECT ?t ?at {{ ?t <{ros}latest> ?m . ?m {data} ?speed ; <{ros}received> ?at }}")
        return {row["t"]: row["at"] for row in rows}

    both = {one.topic("/aircraft/engine/speed"), two.topic("/aircraft/engine/speed")}
    until(lambda: topics().keys() == both, "both")
    before = topics()
    until(lambda: all(moment > before[topic] for topic, moment in topics().items()), "newer values")
    until(lambda: f"{two.url}data/note" in oxigraph.graphs(), "the note")

    two.process.kill()  # type: ignore[union-attr]
    two.process.wait(60)
    assert topics().keys() == both
    for graph in (f"{two.url}topics/gone", OTHER):
        oxigraph.update(f"INSERT DATA {{ GRAPH <{graph}> {{ <http://h/s> {P} 1 }} }}")
    again = serve("aircraft", *options, "--data", str(tmp_path), "--base-url", two.url)
    until(lambda: f"{two.url}topics/gone" not in oxigraph.graphs(), "what an earlier run left is gone")
    speed = two.topic("/aircraft/engine/speed")
    until(lambda: topics().get(speed, "") > before[speed], "newer values of the second run")

    ones = {graph for graph in oxigraph.graphs() if graph.startswith(one.url)}
    assert again.stop() == 0
    left = oxigraph.graphs()
    assert {graph for graph in left if graph.startswith(one.url)} == ones
    assert {OTHER, f"{two.url}data/note"} <= left
    assert not any(graph.startswith(f"{two.url}topics") for graph in left)
    [row] = oxigraph.select(f"SELECT ?o {{ GRAPH <{two.url}mirror> {{ ?s <https://w3id.org/rosld#state> ?o }} }}")
    assert row["o"] == "https://w3id.org/rosld#Stale"


def test_a_store_that_is_away_holds_no_request_up_and_is_caught_up_with_though_it_lost_everything(
    serve: Serve, new_oxigraph: NewOxigraph, http: httpx.Client
) -> None:
    assert http.get("mirror").status_code == 404  # there is none without a store
    oxigraph = new_oxigraph()
    served = serve("aircraft", "--store", oxigraph.url, *RATE, "--subscribe", "*")
    assert f"<{served.url}mirror>" in served.http.get("sparql", headers={"Accept": "text/turtle"}).text
    until(lambda: f"{served.url}mirror" in oxigraph.graphs() and mirror(served.http)["failure"] is None, "the store")
    oxigraph.stop()
    until(lambda: mirror(served.http)["failure"] is not None, "the failure")
    large = "".join(f'<http://h/{n}> {P} "{"x" * 500}" .\n_:b{n} {P} [ {P} {n} ] .\n' for n in range(3000))
    assert served.http.put("data/large", content=large, headers=TURTLE).status_code == 201
    for number in range(20):
        put = served.http.put(f"data/{number}", content=f"<> <http://h/q> {number} .", headers=TURTLE, timeout=20)
        assert put.status_code == 201
    asked = served.http.get("sparql", params={"query": "ASK { ?s <http://h/q> 19 }"}, timeout=20)
    assert asked.json()["boolean"] is True
    until(lambda: mirror(served.http)["lag"] > 0.2, "a lag")
    described = served.http.get("mirror", headers={"Accept": "text/turtle"})
    assert "ros:Stale" in described.text
    assert "ros:reason" in described.text
    oxigraph.start()
    until(lambda: f"{served.url}data/19" in oxigraph.graphs(), "the last document")
    until(lambda: mirror(served.http)["failure"] is None and mirror(served.http)["lag"] < 0.5, "no lag")
    own = {f"{served.url}mirror", f"{served.url}status"}  # the latter exists for clients that read everything
    until(lambda: oxigraph.graphs() - own == listed(served.http) - own, "all other graphs")
    graph = f"GRAPH <{served.url}data/large>"
    [all_there] = oxigraph.select(f"SELECT (COUNT(*) AS ?n) {{ {graph} {{ ?s {P} ?o }} }}")
    [joined] = oxigraph.select(f"SELECT (COUNT(*) AS ?n) {{ {graph} {{ ?s {P} ?b . ?b {P} ?o }} }}")
    assert (all_there["n"], joined["n"]) == ("9000", "3000")


def test_a_store_put_back_to_an_earlier_day_is_told_everything_anew(
    serve: Serve, new_oxigraph: NewOxigraph, tmp_path: Path
) -> None:
    place, backup = tmp_path / "store", tmp_path / "backup"
    oxigraph = new_oxigraph(place)
    served = serve("aircraft", "--store", oxigraph.url, *RATE)
    until(lambda: is_told(served.http), "the store")
    oxigraph.stop()
    shutil.copytree(place, backup)
    oxigraph.start()
    assert served.http.put("data/since", content=f"<> {P} 1 .", headers=TURTLE).status_code == 201
    until(lambda: f"{served.url}data/since" in oxigraph.graphs(), "the document")
    assert served.http.put("data/then", content=f"<> {P} 1 .", headers=TURTLE).status_code == 201
    until(lambda: f"{served.url}data/then" in oxigraph.graphs() and is_told(served.http), "the next document")
    oxigraph.stop()
    shutil.rmtree(place)
    shutil.copytree(backup, place)
    oxigraph.start()
    until(lambda: {f"{served.url}data/since", f"{served.url}data/then"} <= oxigraph.graphs(), "both again")


FATES = ("done", "done", "busy", "lost", "done and lost")


class Flaky:
    """A store that carries updates out or not, and reports that or not, until it has failed five times."""

    def __init__(self) -> None:
        self.store = Store()
        self.failures = 5
        self.refuses = b"no such thing"
        self._random = Random(0)
        self._lock = threading.Lock()

    def __call__(self, server: Failing, connection: socket.socket, body: bytes) -> bool:
        with self._lock:
            if body.startswith(b"query="):
                [query] = parse_qs(body.decode())["query"]
                found = self.store.query(query, use_default_graph_as_union=True)
                answer = found.serialize(format=QueryResultsFormat.JSON)  # type: ignore[union-attr, call-arg]
                return server.answer(connection, "200 OK", answer or b"", JSON)
            if self.refuses in body:
                return server.answer(connection, "400 Bad", b"I do not take this")
            fate = self._random.choice(FATES) if self.failures else "done"
            self.failures -= fate != "done"
            if fate not in ("busy", "lost"):
                self.store.update(body.decode())
            if fate in ("lost", "done and lost"):
                return False  # the connection ends
            return server.answer(connection, "503 Busy" if fate == "busy" else "204 Done")

    def said(self, start: str) -> set[tuple[str, ...]]:
        """Return the graphs with this prefix, with the subjects and objects of P in them."""
        query = f"SELECT ?g ?s ?o {{ GRAPH ?g {{ ?s {P} ?o }} FILTER(STRSTARTS(STR(?g), '{start}')) }}"
        with self._lock:
            return {tuple(term.value for term in row) for row in self.store.query(query)}  # type: ignore[union-attr]


def test_a_store_that_fails_at_random_ends_up_with_the_same(failing: Callable[[Behaviour], Failing]) -> None:
    flaky, robot = Flaky(), MadeUp()
    for number in range(3):
        robot.parameter(f"/p{number}", number)
    with served(robot, store=failing(flaky).url.removesuffix("/sparql"), store_rate=100.0) as http:
        random, base = Random(1), str(http.base_url)
        for turn in range(40):
            path = f"data/{random.choice('abc')}"
            said = " , ".join(f'"{random.randrange(4)}\\u2028"' for _ in range(random.randrange(1, 4)))
            kind = random.choice(["put", "put", "patch", "patch", "delete"])
            if kind == "put":
                http.put(path, content=f"<> {P} {said} .", headers=TURTLE)
            elif kind == "patch":
                text = f"DELETE WHERE {{ ?s {P} '1\\u2028' }} ; INSERT DATA {{ <> {P} {said} }}"
                http.patch(path, content=text, headers=UPDATE)
            else:
                http.delete(path)
            if turn % 10 == 9:
                until(lambda: is_told(http), "the store")

        def same() -> bool:
            query = {"query": f"SELECT ?g ?s ?o {{ GRAPH ?g {{ ?s {P} ?o }} }}"}
            found = http.get("sparql", params=query, headers={"Accept": JSON}).json()["results"]["bindings"]
            here = {tuple(row[name]["value"] for name in "gso") for row in found}
            return here == flaky.said(f"{base}data/")

        until(same, "the same")


def test_a_graph_that_is_refused_is_left_out_and_those_of_others_are_not_touched(
    failing: Callable[[Behaviour], Failing], serve: Serve, caplog: pytest.LogCaptureFixture
) -> None:
    picky = Flaky()
    picky.failures, picky.refuses = 0, b"poison"
    picky.store.update(f"INSERT DATA {{ GRAPH <{OTHER}> {{ <a:a> {P} 1 }} }}")
    server = failing(picky)
    http = serve("aircraft", "--store", server.url.removesuffix("/sparql"), *RATE).http
    for number in range(30):
        value = "poison" if number == 13 else f"value {number}."
        assert http.put(f"data/{number}", content=f"<> {P} '{value}' .", headers=TURTLE).status_code == 201
    until(lambda: mirror(http)["refused"] == 2 and mirror(http)["lag"] == 0, "it and its receipt are refused")
    assert http.put("data/last", content=f"<> {P} 'the last' .", headers=TURTLE).status_code == 201
    until(lambda: picky.said(f"{http.base_url}data/last"), "the last one")
    taken = {row[2] for row in picky.said(f"{http.base_url}data/")}
    assert taken == {f"value {number}." for number in range(30) if number != 13} | {"the last"}
    assert picky.said(OTHER)
    left_out = [record.getMessage() for record in caplog.records if "is omitted" in record.getMessage()]
    assert len(left_out) == 2
    assert any(f"{http.base_url}data/13 " in each for each in left_out)


def silent(server: Failing, connection: socket.socket, body: bytes) -> bool:
    server.ended.wait(60)
    return False


def test_where_a_store_fails_all_the_time_nothing_grows_and_the_end_is_quick(
    failing: Callable[[Behaviour], Failing], serve: Serve, caplog: pytest.LogCaptureFixture
) -> None:
    server = failing(silent)
    options = ("--store", server.url.removesuffix("/sparql"), *RATE, "--setting", "store_time_limit", "0.3")
    running = serve("aircraft", *options)
    until(lambda: len(server.bodies) >= 2 and mirror(running.http)["failure"], "failures")
    for number in range(10):
        assert running.http.put("data/one", content=f"<> {P} {number} .", headers=TURTLE, timeout=20).is_success
    assert mirror(running.http)["pending"] < 1000
    assert running.stop() == 0
    assert len([record for record in caplog.records if "out of date" in record.getMessage()]) == 1
