"""What is drawn at random in a fork of the query process is drawn nowhere else."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import httpx
import pytest

UPDATE = {"Content-Type": "application/sparql-update"}
SHORT = "{ GRAPH </data/there> { <urn:a> <urn:p> ?x } }"
"""What is done in the query process itself."""
LONG = "{ ?a ?b ?c . ?d ?e ?f } LIMIT 1"
"""What may take long, and is done in a fork."""


@pytest.fixture(scope="module")
def plane(start_server: Callable[..., Any]) -> httpx.Client:
    """An aircraft of this module's own."""
    client: httpx.Client = start_server("aircraft").http
    client.put("/data/there", content="<urn:a> <urn:p> 1 .", headers={"Content-Type": "text/turtle"}).raise_for_status()
    return client


@pytest.mark.parametrize("function", ["UUID()", "STRUUID()", "RAND()"])
def test_no_two_queries_draw_the_same(plane: httpx.Client, function: str) -> None:
    texts = [f"SELECT ({function} AS ?y) {SHORT}", *[f"SELECT ({function} AS ?x) {LONG}"] * 3]
    answers = [plane.get("/sparql", params={"query": text}, headers={"Accept": "text/csv"}).text for text in texts]
    assert len(set(answers)) == len(texts)
    assert all(answer.count("\n") == 2 for answer in answers)


@pytest.mark.parametrize(
    "inserted",
    [
        "INSERT {{ GRAPH <{0}> {{ [] <urn:p> 1 }} }} WHERE {{}}",
        "INSERT {{ GRAPH <{0}> {{ ?b <urn:p> 1 }} }} WHERE {{ BIND(BNODE() AS ?b) }}",
        "INSERT DATA {{ GRAPH <{0}> {{ [] <urn:p> 1 }} }}",
    ],
)
def test_no_two_updates_make_the_same_blank_node(plane: httpx.Client, inserted: str) -> None:
    """SPARQL 1.1 Update 3.1.3, 19.6 of SPARQL 1.1 Query: they are new."""
    graph = f"/data/random-{len(inserted)}"
    first = f"INSERT DATA {{ GRAPH <{graph}> {{ <urn:a> <urn:p> 1 }} }}"
    last = f"DELETE {{ GRAPH <{graph}> {{ ?s <urn:none> 1 }} }} WHERE {{ GRAPH <{graph}> {{ ?s <urn:none> 1 }} }}"
    plane.get("/sparql", params={"query": f"SELECT (UUID() AS ?y) {SHORT}"}).raise_for_status()
    for _ in range(3):
        text = f"{first} ; {inserted.format(graph)} ; {last}"
        plane.post("/sparql", content=text, headers=UPDATE).raise_for_status()
    assert plane.get(graph, headers={"Accept": "application/n-triples"}).text.count("_:") == 3
