"""Malicious updates: each is refused in time, has no effect, and the server survives."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable
from typing import Any
from urllib.parse import urlsplit

import httpx
import pytest

from tests.waiting import once_started, until

UPDATE = {"Content-Type": "application/sparql-update"}
TURTLE = {"Content-Type": "text/turtle"}
pytestmark = pytest.mark.slow

CROSS = "?a ?b ?c . ?d ?e ?f . ?g ?h ?i . ?j ?k ?l"


@pytest.fixture(scope="module")
def plane(start_server: Callable[..., Any]) -> httpx.Client:
    """An aircraft with a time limit of half a second for queries."""
    client: httpx.Client = start_server("aircraft", "--setting", "query_time_limit", "0.5").http
    client.timeout = httpx.Timeout(60)
    client.put("/data/numbers", content=" , ".join(["<> <urn:n> 0", *map(str, range(1, 400))]) + " .", headers=TURTLE)
    return client


def update(client: httpx.Client, text: str | bytes) -> httpx.Response:
    """Send an update."""
    return client.post("/sparql", content=text, headers=UPDATE)


def lives(client: httpx.Client) -> None:
    """Check that the server answers, and carries out updates."""
    answer = once_started(lambda: update(client, "INSERT DATA { GRAPH </data/lives> { <urn:a> <urn:b> 1 } }"))
    assert answer.status_code == 204, answer.text
    assert client.get("/data/never").status_code == 404


CROSS_PRODUCTS = [
    f"{CROSS} FILTER(CONCAT(STR(?c), STR(?f), STR(?i), STR(?l)) = 'x')",
    f"{{ SELECT (COUNT(*) AS ?a) WHERE {{ {CROSS} }} }}",
    f"{{ SELECT ?a WHERE {{ {CROSS} }} ORDER BY ?l DESC(?a) }}",
]


@pytest.mark.parametrize("where", CROSS_PRODUCTS)
def test_a_cross_product_is_stopped_and_nothing_is_done(plane: httpx.Client, where: str) -> None:
    before = "INSERT DATA { GRAPH </data/never> { <urn:a> <urn:b> 1 } } ; "
    answer = update(plane, f"{before}INSERT {{ GRAPH </data/never> {{ <urn:a> <urn:b> ?a }} }} WHERE {{ {where} }}")
    assert answer.status_code in (503, 422), answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    lives(plane)


def test_more_solutions_than_an_update_may_have_are_422(start_server: Callable[..., Any]) -> None:
    client: httpx.Client = start_server("aircraft", "--setting", "query_time_limit", "60").http
    client.timeout = httpx.Timeout(90)
    for number, fine in ((400, False), (100, True)):
        body = " , ".join(["<> <urn:n> 0", *map(str, range(1, number))]) + " ."
        assert client.put("/data/numbers", content=body, headers=TURTLE).status_code in (201, 204)
        answer = update(
            client,
            "INSERT { GRAPH </data/sums> { <urn:a> <urn:b> ?z } } WHERE { GRAPH </data/numbers> { ?s <urn:n> ?x , ?y } "
            "BIND(?x + ?y AS ?z) }",
        )
        assert answer.status_code == (204 if fine else 422), answer.text
        if not fine:
            assert "more than the limit of 100000 solutions" in answer.json()["detail"]
            assert client.get("/data/sums").status_code == 404
    assert client.get("/data/sums").status_code == 200


BOMBS = [
    ("INSERT DATA { GRAPH </data/never> { <urn:a> <urn:b> " + "( " * 20_000 + ") " * 20_000 + "} }", 400),
    ("INSERT DATA { GRAPH </data/never> { <urn:a> <urn:b> " + "[ <urn:b> " * 20_000 + "] " * 20_000 + "} }", 400),
    ("INSERT { } WHERE " + "{ " * 20_000 + "} " * 20_000, 400),
    ("INSERT { } WHERE { FILTER(" + "!" * 20_000 + "true) }", 400),
    ("INSERT { } WHERE { ?s " + "<urn:p>/" * 5_000 + "<urn:p> ?o }", 400),
    ("INSERT DATA { } ; " * 5_000, 400),
    ("PREFIX e: <urn:e:> " * 5_000, 400),
    ("DELETE DATA { " + "GRAPH </data/never> { } " * 5_000 + "}", 204),
    ("INSERT DATA { GRAPH </data/never> { <urn:a> <urn:b> '" + "x" * 200_000, 400),
    ("#" * 500_000, 204),
    (";" * 20_000, 400),
    ("INSERT DATA { GRAPH </data/never> { <urn:a> <urn:b> " + "'" * 100_001 + " } }", 400),
    ("\x00", 400),
    ("INSERT DATA { GRAPH </data/nul> { <urn:a> <urn:b> '\x00' } }", 204),
]


def test_bombs_are_refused_at_once(plane: httpx.Client) -> None:
    wrong = []
    for text, status in BOMBS:
        if (answer := update(plane, text)).status_code != status:
            wrong.append((text[:60], answer.status_code, answer.text[:500]))
    assert not wrong, wrong
    lives(plane)


def test_a_client_that_hangs_up_does_no_harm(plane: httpx.Client) -> None:
    """Whether or not its update was carried out, it is atomic, and other clients are served."""
    address = urlsplit(str(plane.base_url))
    assert address.hostname is not None
    texts = [
        f"INSERT {{ GRAPH </data/unheard> {{ <urn:a> <urn:b> ?a }} }} WHERE {{ {CROSS} }}",
        "INSERT DATA { GRAPH </data/left> { <urn:a> <urn:b> 1 , 2 , 3 } }",
    ]
    for text in texts:
        for _ in range(4):
            with socket.create_connection((address.hostname, address.port or 80)) as connection:
                head = f"POST /sparql HTTP/1.1\r\nHost: {address.netloc}\r\nContent-Type: application/sparql-update\r\n"
                connection.sendall(f"{head}Content-Length: {len(text)}\r\n\r\n{text}".encode())
    lives(plane)
    assert plane.get("/data/unheard").status_code == 404
    query = "SELECT (COUNT(*) AS ?n) { GRAPH </data/left> { <urn:a> <urn:b> ?o } }"
    results = {"Accept": "application/sparql-results+json"}
    # 503 while workers still end what nobody waits for.

    def counted() -> httpx.Response | None:
        answer = plane.get("/sparql", params={"query": query}, headers=results)
        return answer if answer.is_success else None

    found = until(counted, "a free worker")
    assert json.loads(found.text)["results"]["bindings"][0]["n"]["value"] in ("0", "3")
