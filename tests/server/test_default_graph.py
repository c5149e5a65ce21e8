"""The default graph is a set, the union of all graphs: over HTTP, whatever else a query or an update names."""

from __future__ import annotations

import csv
import io
import random
from collections.abc import Callable
from typing import Any

import httpx
import pytest

pytestmark = pytest.mark.slow

TURTLE, UPDATE = {"Content-Type": "text/turtle"}, {"Content-Type": "application/sparql-update"}
PATHS = ("a", "b", "c/d")
TEXT = "<urn:s> <urn:p> 10 ; <urn:q> <urn:o> . <urn:o> <urn:p> 5 ."


@pytest.fixture(scope="module")
def http(start_server: Callable[..., Any]) -> httpx.Client:
    """A server with three equal documents, and a different one."""
    client: httpx.Client = start_server("aircraft").http
    for path in PATHS:
        assert client.put(f"/data/{path}", content=TEXT, headers=TURTLE).status_code == 201
    other = "<urn:s> <urn:p> 20 . <urn:t> <urn:p> 10 ."
    assert client.put("/data/other", content=other, headers=TURTLE).status_code == 201
    return client


def rows(http: httpx.Client, query: str, **dataset: Any) -> list[list[str]]:
    answer = http.get("/sparql", params={"query": query, **dataset}, headers={"Accept": "text/csv"})
    assert answer.status_code == 200, answer.text
    return sorted(csv.reader(io.StringIO(answer.text)))


def test_a_triple_of_several_graphs_is_found_once(http: httpx.Client) -> None:
    for query, found in (
        ("SELECT ?o { <urn:s> <urn:q> ?o }", [["o"], ["urn:o"]]),
        ("SELECT (COUNT(*) AS ?n) (SUM(?o) AS ?sum) { ?s <urn:p> ?o }", [["4", "45"], ["n", "sum"]]),
        ("SELECT (COUNT(*) AS ?n) { <urn:s> <urn:p>|<urn:q> ?o }", [["3"], ["n"]]),
        ("SELECT (COUNT(*) AS ?n) { ?s <urn:p> ?v ; <urn:q>/<urn:p> ?o }", [["2"], ["n"]]),
        ("SELECT (COUNT(*) AS ?n) { { SELECT * { ?s <urn:q> ?o } } UNION { ?s <urn:q> ?o } }", [["2"], ["n"]]),
        ("SELECT (COUNT(*) AS ?n) { GRAPH ?g { <urn:s> <urn:q> ?o } }", [["3"], ["n"]]),
        ("SELECT (COUNT(*) AS ?n) { ?s <urn:q> ?o GRAPH ?g { ?s <urn:q> ?o } }", [["3"], ["n"]]),
        ("SELECT (SUM(?o) AS ?n) FROM <data/a> FROM <data/b> { <urn:s> <urn:p> ?o }", [["10"], ["n"]]),
        ("SELECT (SUM(?o) AS ?n) FROM <data/a> FROM <data/other> { ?s <urn:p> ?o }", [["45"], ["n"]]),
        ("SELECT ?s ?p ?o { ?s ?p ?o } GROUP BY ?s ?p ?o HAVING (COUNT(*) > 1)", [["s", "p", "o"]]),
    ):
        assert rows(http, query) == found, query
    graphs = {"default-graph-uri": [f"{http.base_url}data/{path}" for path in PATHS]}
    assert rows(http, "SELECT (COUNT(*) AS ?n) { ?s <urn:p> ?o }", **graphs) == [["2"], ["n"]]


@pytest.mark.parametrize("using", ["", "USING <data/a> USING <data/b> USING <data/other>"])
def test_an_update_counts_it_once_also_after_another_operation(http: httpx.Client, using: str) -> None:
    for first in ("", "INSERT DATA { GRAPH <data/sum> { <urn:x> <urn:p> 10 } } ; "):
        where = "{ SELECT (SUM(?o) AS ?sum) { ?s <urn:p> ?o FILTER(?s != <urn:x>) } }"
        text = f"{first}INSERT {{ GRAPH <data/sum> {{ <urn:all> <urn:sum> ?sum }} }} {using} WHERE {{ {where} }}"
        assert http.post("/sparql", content=text, headers=UPDATE).status_code == 204
        assert rows(http, "SELECT ?sum { <urn:all> <urn:sum> ?sum }") == [["45"], ["sum"]]
        assert http.delete("/data/sum").status_code == 204


def test_it_is_there_for_as_long_as_any_graph_says_so(http: httpx.Client) -> None:
    query = "SELECT ?o { <urn:u> <urn:p> ?o }"
    for path in ("u", "v", "w"):
        http.put(f"/data/{path}", content="<urn:u> <urn:p> 1 .", headers=TURTLE)
        assert rows(http, query) == [["1"], ["o"]]
    http.patch("/data/u", content="DELETE DATA { <urn:u> <urn:p> 1 }", headers=UPDATE)
    assert rows(http, query) == [["1"], ["o"]]
    http.delete("/data/v")
    assert rows(http, query) == [["1"], ["o"]]
    http.put("/data/w", content="<urn:u> <urn:p> 2 .", headers=TURTLE)
    assert rows(http, query) == [["2"], ["o"]]


def test_it_is_the_union_however_much_is_replaced(http: httpx.Client) -> None:
    """So much is replaced that the dataset copies itself, after losing four times its size."""
    chosen, held = random.Random(1), dict[str, set[int]]()
    for turn in range(60):
        path = f"m{turn % 4}"
        held[path] = set(chosen.sample(range(1500), 700))
        text = "".join(f"<urn:m> <urn:m> {number} ." for number in held[path])
        assert http.put(f"/data/{path}", content=text, headers=TURTLE).is_success
        if turn % 4 == 3:
            union = set[int]().union(*held.values())
            query = "SELECT (COUNT(*) AS ?n) (SUM(?o) AS ?sum) { <urn:m> <urn:m> ?o }"
            assert rows(http, query) == [[str(len(union)), str(sum(union))], ["n", "sum"]]


def test_what_is_there_for_looks_at_everything_alone_is_there_every_time(http: httpx.Client) -> None:
    status = f"{http.base_url}status"
    for query in ("ASK {}", "SELECT * { GRAPH <resources/aircraft/power> { ?s ?p ?o } }", "ASK { ?s ?p ?o }"):
        for _ in range(2):
            rows(http, "SELECT ?n { <topics/cockpit/display> ros:name ?n }")
            assert http.get("/sparql", params={"query": query}).status_code == 200
            assert f"<{status}> ." in http.get("/graphs?all").text
