"""Large documents: whole in every syntax, a part of them on their page, and none of it on the event loop."""

from __future__ import annotations

from collections.abc import Iterator

import httpx
import pytest
from pyoxigraph import RdfFormat, parse

from tests.server.robots.made_up import MadeUp, served

NUMBERS = 150_000
BUSY_SECONDS = 0.1
"""Work of the loop in one pause: these numbers take it some 0.5 s to read, or to write in one syntax."""
TURTLE = {"Content-Type": "text/turtle"}
SYNTAXES = {
    "text/turtle": RdfFormat.TURTLE,
    "application/n-triples": RdfFormat.N_TRIPLES,
    "application/ld+json": RdfFormat.JSON_LD,
    "application/json": RdfFormat.JSON_LD,
    "application/rdf+xml": RdfFormat.RDF_XML,
    "text/n3": RdfFormat.N3,
    "application/n-quads": RdfFormat.N_QUADS,
    "application/trig": RdfFormat.TRIG,
}


def turtle(numbers: int) -> bytes:
    """So many numbers of one property."""
    return b"<> <http://example.org/p> " + b", ".join(b"%d" % number for number in range(numbers)) + b" ."


@pytest.fixture(scope="module")
def http() -> Iterator[httpx.Client]:
    """A server with a large document."""
    with served(MadeUp()) as client:
        client.timeout = httpx.Timeout(120)
        assert client.put("data/large", content=turtle(NUMBERS), headers=TURTLE).status_code == 201
        yield client


def numbers_of(answer: httpx.Response, form: RdfFormat) -> int:
    """How many of the numbers an answer has."""
    found = {quad.object for quad in parse(answer.content, form) if quad.predicate.value == "http://example.org/p"}
    return len(found)


def busy(http: httpx.Client) -> float:
    """The work of the loop in its longest pause, in seconds."""
    told: dict[str, float] = http.get("status", headers={"Accept": "application/json"}).json()
    return told["longestPauseBusy"]


@pytest.mark.parametrize("accept", SYNTAXES)
def test_a_large_document_is_whole_in_every_syntax(http: httpx.Client, accept: str) -> None:
    answer = http.get("data/large", headers={"Accept": accept})
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith(accept)
    assert int(answer.headers["content-length"]) == len(answer.content)
    assert numbers_of(answer, SYNTAXES[accept]) == NUMBERS
    known = {"Accept": accept, "If-None-Match": answer.headers["etag"]}
    assert http.get("data/large", headers=known).status_code == 304


def test_head_of_a_large_document_says_what_get_does_but_its_length(http: httpx.Client) -> None:
    got = http.get("data/large", headers={"Accept": "text/turtle"})
    head = http.head("data/large", headers={"Accept": "text/turtle"})
    assert head.status_code == 200
    for name in ("etag", "content-type", "allow", "link", "vary"):
        assert head.headers[name] == got.headers[name]


def test_the_page_of_a_large_document_shows_a_part_and_links_to_the_whole(http: httpx.Client) -> None:
    page = http.get("data/large", headers={"Accept": "text/html"})
    assert page.status_code == 200
    assert "This page shows the first 250 of 150,00" in page.text
    assert 'href="?format=ttl"' in page.text
    assert len(page.content) < 200_000


def test_what_a_syntax_cannot_carry_is_406_also_where_it_is_large(http: httpx.Client) -> None:
    body = turtle(NUMBERS) + b' <> <http://example.org/p/> "a property without a name" .'
    assert http.put("data/unnamed", content=body, headers=TURTLE).status_code == 201
    assert http.get("data/unnamed", headers={"Accept": "application/rdf+xml"}).status_code == 406
    assert http.get("data/unnamed", headers={"Accept": "text/turtle"}).status_code == 200


def test_large_documents_keep_the_loop_free(http: httpx.Client) -> None:
    for accept in (*SYNTAXES, "text/html"):
        assert http.get("data/large", headers={"Accept": accept}).status_code == 200
    assert busy(http) < BUSY_SECONDS
