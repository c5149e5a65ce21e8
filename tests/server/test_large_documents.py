"""Large documents: complete in every syntax, partial on their page, and never blocking the event loop."""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import cache

import httpx
import pytest
from pyoxigraph import BlankNode, RdfFormat, parse

from rosld.server.rest.state import LARGE_BYTES
from tests.server.robots.made_up import MadeUp, served

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("frozen_heap")]

NUMBERS = 30_000
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
    """Return Turtle with this number of values of one property."""
    return b"<> <http://example.org/p> " + b", ".join(b"%d" % number for number in range(numbers)) + b" ."


@pytest.fixture(scope="module")
def http() -> Iterator[httpx.Client]:
    """A server with a large document."""
    with served(MadeUp()) as client:
        client.timeout = httpx.Timeout(120)
        assert client.put("data/large", content=turtle(NUMBERS), headers=TURTLE).status_code == 201
        yield client


def numbers_of(answer: httpx.Response, form: RdfFormat) -> int:
    """Return how many of the numbers a response has."""
    found = {quad.object for quad in parse(answer.content, form) if quad.predicate.value == "http://example.org/p"}
    return len(found)


def busy(http: httpx.Client) -> float:
    """Return the longest uninterrupted work of the loop in CPU seconds, which do not depend on the machine's load."""
    told: dict[str, float] = http.get("status", headers={"Accept": "application/json"}).json()
    return told["longestWork"]


@cache
def busy_seconds(numbers: int = NUMBERS) -> float:
    """Return six times the CPU time for parsing this many numbers; loading them takes ten times as long."""
    body = turtle(numbers)
    began = time.thread_time()
    for _ in parse(body, format=RdfFormat.TURTLE, base_iri="http://example.org/"):
        pass
    return max(6 * (time.thread_time() - began), 0.1)


def test_a_large_document_is_whole_in_every_syntax_and_a_part_of_it_on_its_page(http: httpx.Client) -> None:
    for accept, syntax in SYNTAXES.items():
        answer = http.get("data/large", headers={"Accept": accept})
        assert answer.status_code == 200
        assert answer.headers["content-type"].startswith(accept)
        assert int(answer.headers["content-length"]) == len(answer.content)
        assert numbers_of(answer, syntax) == NUMBERS
        known = {"Accept": accept, "If-None-Match": answer.headers["etag"]}
        assert http.get("data/large", headers=known).status_code == 304
        head = http.head("data/large", headers={"Accept": accept})
        assert head.status_code == 200
        for name in ("etag", "content-type", "allow", "link", "vary"):
            assert head.headers[name] == answer.headers[name]
    page = http.get("data/large", headers={"Accept": "text/html"})
    assert page.status_code == 200
    assert f"This page shows the first 250 of {NUMBERS:,}"[:-1] in page.text
    assert 'href="?format=ttl"' in page.text
    assert len(page.content) < 200_000
    assert busy(http) < busy_seconds()


def test_the_page_of_a_large_document_of_few_triples_shows_all_of_them(http: httpx.Client) -> None:
    body = f'<> <http://example.org/p> "{"a" * LARGE_BYTES}", "the second" .'
    assert http.put("data/long", content=body, headers=TURTLE).status_code == 201
    page = http.get("data/long", headers={"Accept": "text/html"}).text
    assert "the second" in page
    assert "This page shows the first" not in page


def test_what_is_wrong_in_a_large_body_is_told_as_in_a_small_one(http: httpx.Client) -> None:
    broken = turtle(NUMBERS) + b"\n<> <p> ."
    answer = http.put("data/broken", content=broken, headers=TURTLE)
    assert answer.status_code == 400
    assert "line 2" in answer.json()["detail"]
    assert http.get("data/broken").status_code == 404
    contains = turtle(NUMBERS) + b" <> <http://www.w3.org/ns/ldp#contains> <x> ."
    assert http.put("data/container/", content=contains, headers=TURTLE).status_code == 409
    body = turtle(NUMBERS) + b' <> <http://example.org/p/> "a property without a name" .'
    assert http.put("data/unnamed", content=body, headers=TURTLE).status_code == 201
    assert http.get("data/unnamed", headers={"Accept": "application/rdf+xml"}).status_code == 406
    assert http.get("data/unnamed", headers={"Accept": "text/turtle"}).status_code == 200


def test_a_large_document_is_patched_merged_and_replaced_beside_the_loop(http: httpx.Client) -> None:
    assert http.put("data/changed", content=turtle(NUMBERS), headers=TURTLE).status_code == 201
    update = "INSERT DATA { <> <http://example.org/q> 'one more' }"
    sparql = {"Content-Type": "application/sparql-update"}
    assert http.patch("data/changed", content=update, headers=sparql).status_code == 204
    n3 = (
        "@prefix solid: <http://www.w3.org/ns/solid/terms#> . <#p> a solid:InsertDeletePatch ;"
        " solid:deletes { <> <http://example.org/q> 'one more' } ; solid:inserts { <> <http://example.org/r> 2 } ."
    )
    assert http.patch("data/changed", content=n3, headers={"Content-Type": "text/n3"}).status_code == 204
    assert http.post("data/changed", content="<> <http://example.org/s> _:b .", headers=TURTLE).status_code == 204
    found = http.get("data/changed", headers={"Accept": "application/n-triples"}).text
    assert "example.org/q" not in found
    assert found.count("example.org/r") == found.count("example.org/s") == 1
    assert found.count("example.org/p") == NUMBERS
    assert http.put("data/changed", content=turtle(10), headers=TURTLE).status_code == 204
    assert http.get("data/changed", headers={"Accept": "text/turtle"}).text.count(",") < 20
    assert busy(http) < busy_seconds()


def test_data_of_an_update_may_be_as_long_as_a_body_and_are_taken_beside_the_loop() -> None:
    with served(MadeUp()) as http:
        http.timeout = httpx.Timeout(120)
        numbers = 40_000
        triples = turtle(numbers).decode().replace("<>", f"<{http.base_url}data/large>").rstrip(" .")
        update = {"Content-Type": "application/sparql-update"}
        text = f"INSERT DATA {{ GRAPH <{http.base_url}data/large> {{ {triples} }} }}"
        assert len(text) > 262_144
        assert http.post("sparql", content=text, headers=update).status_code == 204
        found = http.get("data/large", headers={"Accept": "application/n-triples"}).text
        assert found.count("example.org/p") == numbers
        broken = http.post("sparql", content=text.replace("39998", "fifty", 1), headers=update)
        assert broken.status_code == 400
        assert "fifty" in broken.json()["detail"]
        assert http.post("sparql", content=text.replace("INSERT", "DELETE", 1), headers=update).status_code == 204
        assert "example.org/p" not in http.get("data/large", headers={"Accept": "application/n-triples"}).text
        assert busy(http) < busy_seconds(numbers)


def test_a_patch_that_makes_much_of_little_is_done_whole_beside_the_loop(http: httpx.Client) -> None:
    assert http.put("data/small", content=turtle(30), headers=TURTLE).status_code == 201
    update = (
        "INSERT { <> <http://example.org/q> ?sum } WHERE {"
        " <> <http://example.org/p> ?a , ?b , ?c BIND(?a + 30 * ?b + 900 * ?c AS ?sum) }"
    )
    answer = http.patch("data/small", content=update, headers={"Content-Type": "application/sparql-update"})
    assert answer.status_code == 204
    assert http.get("data/small", headers={"Accept": "application/n-triples"}).text.count("example.org/q") == 27_000
    assert busy(http) < busy_seconds()


def test_the_description_of_very_many_parameters_is_of_bounded_size_and_made_beside_the_loop() -> None:
    robot = MadeUp()
    for group in range(30):
        robot.parameter(f"/group{group}", {f"p{number}": number for number in range(100)})
    with served(robot) as http:
        http.timeout = httpx.Timeout(120)
        answer = http.get("openapi.json")
        paths = answer.json()["paths"]
        assert {"/resources/{name}", "/parameters/{name}"} <= paths.keys()
        assert len(paths) < 2_500
        for accept in ("text/turtle", "text/html"):
            assert http.get("parameters/", headers={"Accept": accept}).status_code == 200
        assert busy(http) < busy_seconds(400_000)


def test_a_large_json_file_is_patched_beside_the_loop() -> None:
    with served(MadeUp()) as http:
        http.timeout = httpx.Timeout(120)
        numbers = list(range(700_000))
        assert http.put("data/numbers.json", json={"numbers": numbers}).status_code == 201
        patch = {"Content-Type": "application/merge-patch+json"}
        assert http.patch("data/numbers.json", content=b'{"more": 1}', headers=patch).status_code == 204
        assert http.get("data/numbers.json").json() == {"numbers": numbers, "more": 1}
        broken = http.patch("data/numbers.json", content=b'{"more": NaN}', headers=patch)
        assert broken.status_code == 400
        assert busy(http) < busy_seconds(50_000)


EX = "http://example.org/"
START = (
    f'<> <{EX}title> "plain" , "tagged"@en-GB , "01"^^<http://www.w3.org/2001/XMLSchema#integer> , 1.50 , '
    f'"two\\nlines \\"quoted\\"" ; <{EX}part> [ <{EX}label> "inner" ] .'
)


def rename(old: str, new: str) -> str:
    """Return an update that renames a property."""
    return f"DELETE {{ ?s <{EX}{old}> ?o }} INSERT {{ ?s <{EX}{new}> ?o }} WHERE {{ ?s <{EX}{old}> ?o }}"


CHANGES: tuple[tuple[str, str, str, int], ...] = (
    ("PATCH", "sparql-update", f"INSERT DATA {{ <> <{EX}a> 1 , 01 , 'x'@en , 'é' }}", 204),
    ("PATCH", "sparql-update", f"DELETE DATA {{ <> <{EX}a> 01 , 'never there' }}", 204),
    ("PATCH", "sparql-update", f"DELETE DATA {{ <> <{EX}a> 1 }} ; INSERT DATA {{ <> <{EX}a> 1 , 2 }}", 204),
    ("PATCH", "sparql-update", f"INSERT DATA {{ <> <{EX}b> 1 , 2 }} ; DELETE DATA {{ <> <{EX}b> 1 }}", 204),
    ("PATCH", "sparql-update", f"INSERT DATA {{ <> <{EX}blank> _:one . _:one <{EX}of> <> }}", 204),
    ("PATCH", "sparql-update", rename("label", "name"), 204),
    ("PATCH", "sparql-update", "INSERT DATA { <> a <http://www.w3.org/ns/ldp#RDFSource> }", 204),
    ("PATCH", "sparql-update", "INSERT DATA { <> a <http://www.w3.org/ns/ldp#BasicContainer> }", 409),
    ("PATCH", "sparql-update", "INSERT DATA { <> <http://www.w3.org/ns/ldp#contains> <x> }", 409),
    ("PATCH", "sparql-update", "INSERT DATA { GRAPH <x> { <> <x> 1 } }", 422),
    ("PATCH", "n3", f"solid:deletes {{ <> <{EX}b> 2 }} ; solid:inserts {{ <> <{EX}n> 2 }}", 204),
    ("PATCH", "n3", f"solid:deletes {{ <> <{EX}n> 'never there' }}", 409),
    ("PATCH", "n3", f"solid:where {{ ?s <{EX}name> ?n }} ; solid:inserts {{ ?s <{EX}found> ?n }}", 204),
    ("POST", "turtle", f"<> <{EX}n> 2 ; <{EX}m> [ <{EX}label> 'merged' ] .", 204),
    ("UPDATE", "", f"INSERT DATA {{ GRAPH <URL> {{ <URL> <{EX}u> 1 , 01 , 'x'@en }} }}", 204),
    ("UPDATE", "", f"DELETE DATA {{ GRAPH <URL> {{ <URL> <{EX}u> 01 , 'never there' }} }}", 204),
    ("UPDATE", "", f"WITH <URL> {rename('name', 'label')}", 204),
    ("UPDATE", "", f"WITH <URL> DELETE {{ ?s <{EX}u> ?o }} WHERE {{ ?s <{EX}u> ?o }} ; "
     f"WITH <URL> INSERT {{ <URL> <{EX}left> 1 }} WHERE {{ FILTER NOT EXISTS {{ ?s <{EX}u> ?o }} }}", 204),
    ("UPDATE", "", "INSERT DATA { GRAPH <URL> { <URL> a <http://www.w3.org/ns/ldp#BasicContainer> } }", 409),
)  # fmt: skip
SOLID = "@prefix solid: <http://www.w3.org/ns/solid/terms#> . <#patch> a solid:InsertDeletePatch ; "


def change(http: httpx.Client, name: str, method: str, kind: str, body: str) -> httpx.Response:
    """Make one of the changes to a document."""
    if method == "UPDATE":
        text = body.replace("URL", f"{http.base_url}data/{name}")
        return http.post("sparql", content=text, headers={"Content-Type": "application/sparql-update"})
    media_type = {"sparql-update": "application/sparql-update", "n3": "text/n3", "turtle": "text/turtle"}[kind]
    content = f"{SOLID}{body} ." if kind == "n3" else body
    return http.request(method, f"data/{name}", content=content, headers={"Content-Type": media_type})


def said(http: httpx.Client, name: str) -> set[tuple[str, str, str]]:
    """Return the statements of a document without the numbers, its times, and labels of blank nodes."""
    answer = http.get(f"data/{name}", headers={"Accept": "application/n-triples"})
    return {
        (spelt(quad.subject, name), str(quad.predicate), spelt(quad.object, name))
        for quad in parse(answer.content, RdfFormat.N_TRIPLES)
        if quad.predicate.value != f"{EX}p" and not quad.predicate.value.startswith("http://purl.org/dc/terms/")
    }


def spelt(term: object, name: str) -> str:
    return "_:" if isinstance(term, BlankNode) else str(term).replace(f"/{name}>", "/>")


def test_a_change_of_a_large_document_comes_to_the_same_as_of_a_small_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rosld.server.rest.large.MAX_FILES", 4)  # so that files of former states are removed
    with served(MadeUp()) as http:
        http.timeout = httpx.Timeout(120)
        for name, numbers in (("small", 3), ("large", 3_500)):
            body = turtle(numbers) + START.encode()
            assert http.put(f"data/{name}", content=body, headers=TURTLE).status_code == 201
        assert said(http, "small") == said(http, "large")
        for method, kind, body, status in CHANGES:
            answers = [change(http, name, method, kind, body) for name in ("small", "large")]
            assert [answer.status_code for answer in answers] == [status, status], (body, answers[1].text)
            assert said(http, "small") == said(http, "large"), body
        asked = {"query": f"ASK {{ GRAPH <{http.base_url}data/large> {{ ?s <{EX}left> 1 ; <{EX}p> 3499 }} }}"}
        assert http.get("sparql", params=asked, headers={"Accept": "application/json"}).json()["boolean"] is True
        found = http.get("data/large", headers={"Accept": "application/n-triples"}).text
        assert found.count(f"<{EX}p> ") == 3_500
