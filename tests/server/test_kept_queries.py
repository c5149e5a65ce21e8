"""Stored queries of clients over HTTP: put, run with parameters, described, listed, deleted, or rejected."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path

import httpx
import pytest
from pyoxigraph import NamedNode, Triple

from rosld.ontology.vocab import dcterms, ldp, rdf, ros
from rosld.server.storage.record import Model, Put
from rosld.server.storage.sqlite import open_records
from tests.crawl.description import inlined
from tests.server.robots.durable import running

pytestmark = pytest.mark.slow

QUERY = {"Content-Type": "application/sparql-query"}
CSV = {"Accept": "text/csv"}
TEXT = {"Accept": "application/sparql-query"}
NT = {"Accept": "application/n-triples"}
TOPICS = """\
# Which topics have a name that begins so.
# @param start string /air -- how it begins
# @param least integer 0 -- the least length
SELECT ?name WHERE { ?topic a ros:Topic ; ros:name ?name FILTER(STRSTARTS(?name, ?start) && STRLEN(?name) >= ?least) }
ORDER BY ?name
"""
ONE = "# One number.\nSELECT (1 AS ?x) {}"
TWO = "# Another number.\nSELECT (2 AS ?x) {}"
Reader = Callable[[httpx.Response], set[Triple]]


@pytest.fixture
def stored(own_aircraft: httpx.Client) -> httpx.Client:
    """An aircraft for one test with a query of a client."""
    answer = put(own_aircraft, "mine", TOPICS)
    assert answer.status_code == 201, answer.text
    return own_aircraft


@pytest.fixture(scope="module")
def shared(start_server: Callable[..., object]) -> httpx.Client:
    """An aircraft with a query of a client, for tests that leave that query unchanged."""
    client: httpx.Client = start_server("aircraft").http  # type: ignore[attr-defined]
    assert put(client, "mine", TOPICS).status_code == 201
    return client


def put(client: httpx.Client, name: str, text: str | bytes) -> httpx.Response:
    return client.put(f"/queries/{name}", content=text, headers=QUERY)


def ask(client: httpx.Client, query: str) -> list[list[str]]:
    """Return the rows of a query's result."""
    answer = client.post("/sparql", content=query, headers={**QUERY, **CSV})
    assert answer.status_code == 200, answer.text
    return [line.split(",") for line in answer.text.splitlines()[1:]]


def contained(client: httpx.Client) -> set[str]:
    """Return the names of the listed queries."""
    lines = client.get("/queries/", headers=NT).text.splitlines()
    return {line.split("/queries/")[-1].split(">")[0] for line in lines if ldp.contains.value in line}


def test_put_makes_a_query_and_then_replaces_it(own_aircraft: httpx.Client) -> None:
    http, name = own_aircraft, "mine"
    assert http.get("/queries/mine").status_code == 404
    made = put(http, name, ONE)
    assert (made.status_code, made.headers["location"]) == (201, f"{http.base_url}queries/mine")
    assert f'<{http.base_url}queries/mine.meta>; rel="describedby"' in made.headers["link"]
    assert "ldp#NonRDFSource" in made.headers["link"]
    assert http.get("/queries/mine", headers=CSV).text.splitlines() == ["x", "1"]
    assert put(http, name, TWO).status_code == 204
    assert http.get("/queries/mine", headers=CSV).text.splitlines() == ["x", "2"]
    kept = http.options("/queries/mine").headers
    assert (kept["allow"], kept["accept-put"]) == ("DELETE, GET, HEAD, OPTIONS, PUT", "application/sparql-query")
    assert http.options("/queries/none").headers["accept-put"] == "application/sparql-query"
    room = http.options("/queries/").headers
    assert room["accept-post"] == "application/sparql-query"
    assert "POST" in room["allow"]
    assert "ldp#BasicContainer" in room["link"]


def test_post_makes_a_query_with_the_name_of_slug(shared: httpx.Client) -> None:
    made = shared.post("/queries/", content=ONE, headers={**QUERY, "Slug": "../my query"})
    assert (made.status_code, made.headers["location"]) == (201, f"{shared.base_url}queries/my-query")
    again = shared.post("/queries/", content=TWO, headers={**QUERY, "Slug": "../my query"})
    assert again.headers["location"] == f"{shared.base_url}queries/my-query-2"
    shipped = shared.post("/queries/", content=TWO, headers={**QUERY, "Slug": "inventory"})
    assert shipped.headers["location"] == f"{shared.base_url}queries/inventory-2"
    unnamed = shared.post("/queries/", content=TWO, headers=QUERY)
    assert shared.get(unnamed.headers["location"], headers=CSV).text.splitlines() == ["x", "2"]


def test_what_is_put_is_what_is_got_byte_for_byte(shared: httpx.Client) -> None:
    for text in (TOPICS, ONE + "\r\n# à la fin \U0001f600\t", "#A\n#\n# @param p iri -- é\nASK { ?p ?a '''\n'''}"):
        assert put(shared, "bytes", text.encode()).status_code in (201, 204)
        answer = shared.get("/queries/bytes", headers=TEXT)
        assert answer.content == text.encode()
        assert answer.headers["content-type"] == "application/sparql-query"
        known = {**TEXT, "If-None-Match": answer.headers["etag"]}
        assert shared.get("/queries/bytes", headers=known).status_code == 304


def test_parameters_are_taken_from_the_url_as_terms_and_by_default(shared: httpx.Client) -> None:
    def names(**given: str) -> list[str]:
        answer = shared.get("/queries/mine", params=given, headers=CSV)
        assert answer.status_code == 200, answer.text
        return answer.text.splitlines()[1:]

    assert names() == names(least="") == ["/aircraft/engine/speed"]
    assert names(start="/cock") == ["/cockpit/display"]
    assert names(start="/cock", least="99") == []
    hostile = ('") } #', '/air") || true || STRSTARTS("', "\\", "\\u0022) || true #", "'''", "?name", "\n\r\t\0", "<x>")
    assert {value: names(start=value) for value in hostile} == {value: [] for value in hostile}
    for given, words in (
        ({"least": "many"}, "'many' is not an integer"),
        ({"least": "1) || (1=1"}, "is not an integer"),
        ({"least": "9" * 30}, "exceeds 64 bits"),
        ({"begin": "/"}, "there is no parameter 'begin'"),
    ):
        refused = shared.get("/queries/mine", params=given, headers=CSV)
        assert refused.status_code == 400
        assert words in refused.json()["detail"]
        assert [one["name"] for one in refused.json()["parameters"]] == ["start", "least"]


def test_a_parameter_that_must_be_given_may_be_a_path_of_the_server(shared: httpx.Client) -> None:
    text = "# Its name.\n# @param thing iri -- which\nSELECT ?name { GRAPH ?thing { ?thing ros:name ?name } }"
    assert put(shared, "called", text).status_code == 201
    assert shared.get("/queries/called", headers=CSV).status_code == 400
    answer = shared.get("/queries/called", params={"thing": "/nodes/aircraft"}, headers=CSV)
    assert answer.text.splitlines() == ["name", "/aircraft"]


def test_its_page_has_its_purpose_its_fields_and_links(shared: httpx.Client) -> None:
    text = """# <b>Topics</b> by name.
# @param start string "" -- how <i>it</i> begins
SELECT ?t { ?t a ros:Topic ; ros:name ?n FILTER(STRSTARTS(?n, ?start)) }"""
    assert put(shared, "paged", text).status_code == 201
    page = shared.get("/queries/paged", params={"start": "/cock"}, headers={"Accept": "text/html"})
    assert page.status_code == 200
    assert "&lt;b&gt;Topics&lt;/b&gt; by name." in page.text
    assert 'name="start"' in page.text
    assert 'href="/topics/cockpit/display"' in page.text
    listed = shared.get("/queries/", headers={"Accept": "text/html"}).text
    assert "&lt;b&gt;Topics&lt;/b&gt; by name." in listed
    assert "How many nodes, topics" in listed
    assert "&lt;b&gt;Topics&lt;/b&gt; by name." in shared.get("/sparql", headers={"Accept": "text/html"}).text


def test_a_query_is_described_as_rdf(shared: httpx.Client, triples_of: Reader) -> None:
    subject = NamedNode(f"{shared.base_url}queries/mine")
    for url in ("/queries/mine", "/queries/mine.meta"):
        found = triples_of(shared.get(url, headers=NT))
        said = {(one.predicate, getattr(one.object, "value", "")) for one in found if one.subject == subject}
        assert {
            (rdf.type, ros.Query.value),
            (rdf.type, ldp.NonRDFSource.value),
            (dcterms.description, "Which topics have a name that begins so."),
            (ros.queryParameter, "start"),
            (ros.queryParameter, "least"),
            (ros.text, TOPICS),
            (dcterms.format, "application/sparql-query"),
        } <= said


def test_queries_are_in_the_dataset_each_once(stored: httpx.Client) -> None:
    found = ask(stored, "SELECT ?q { ?q a ros:Query ; dcterms:description ?d ; ros:text ?t }")
    names = sorted(url.rpartition("/")[2] for (url,) in found)
    assert names == sorted(contained(stored))
    assert {"mine", "inventory"} <= set(names)
    graph = f"{stored.base_url}queries/mine.meta"
    assert ask(stored, f"SELECT ?d {{ GRAPH <{graph}> {{ ?q dcterms:description ?d }} }}") == [
        ["Which topics have a name that begins so."]
    ]
    more = stored.get(graph, headers={"Accept": "text/turtle"}).text + '<mine> <http://ex.org/by> "me" .'
    assert stored.put(graph, content=more, headers={"Content-Type": "text/turtle"}).status_code == 204
    assert put(stored, "mine", ONE).status_code == 204
    assert ask(stored, f"SELECT ?d {{ GRAPH <{graph}> {{ ?q dcterms:description ?d }} }}") == [["One number."]]
    assert ask(stored, 'SELECT ?d { ?q <http://ex.org/by> "me" ; dcterms:description ?d }') == [["One number."]]
    container = f"SELECT ?q {{ GRAPH <{stored.base_url}queries/> {{ ?c ldp:contains ?q }} }}"
    assert len(ask(stored, container)) == len(names)
    assert stored.delete("/queries/mine").status_code == 204
    assert ask(stored, f"SELECT ?d {{ GRAPH <{graph}> {{ ?q ?p ?d }} }}") == []
    assert len(ask(stored, container)) == len(names) - 1


def test_each_kept_query_is_an_operation_of_the_description(stored: httpx.Client) -> None:
    description = stored.get("/openapi.json").json()
    place = inlined(description)["/queries/mine"]
    assert place["get"]["summary"] == "Read: Which topics have a name that begins so."
    told = {one["name"]: one["schema"] for one in place["get"]["parameters"] if one.get("in") == "query"}
    assert (told["start"], told["least"]) == ({"type": "string"}, {"type": "integer"})
    assert "application/sparql-query" in place["put"]["requestBody"]["content"]
    assert "put" not in description["paths"]["/queries/inventory"]
    assert "put" in description["paths"]["/queries/{name}"]
    assert stored.delete("/queries/mine").status_code == 204
    assert "/queries/mine" not in stored.get("/openapi.json").json()["paths"]


BAD: tuple[tuple[str | bytes, str], ...] = (
    ("", "mine:1: must begin with a comment"),
    (b"\xef\xbb\xbf# A.\nASK {}", "mine:1: must begin with a comment"),
    (b"# A.\n# \xff\nASK {}", "mine:2: this is not valid UTF-8"),
    ("# A.\n# @param p date -- it\nASK { ?p ?a ?b }", "mine:2: 'date' is not a parameter type"),
    ("# A.\n# @param p integer -- it\nASK { ?a ?p ?b }", "mine:3: it is not a valid query with its parameters bound"),
    ("# A.\nPREFIX a: <x:>\nDELETE WHERE { ?s ?p ?o }", "mine:3: DELETE is an update"),
    ("# A.\nASK { SERVICE <http://127.0.0.1:1/> { ?a ?b ?c } }", "SERVICE"),
    ("# A.\nASK { " + "{" * 9000 + "}" * 9000 + " }", "nests deeper"),
    ("# A.\nASK { FILTER(" + "!" * 9000 + "true) }", ""),
    ("# A.\nSELECT * { " + "?a ?b ?c . " * 500 + "}", ""),
    ("# A.\n" + "".join(f"# @param p{n} iri -- it\n" for n in range(60)) + "ASK {}", "at most 50 parameters"),
)


def test_what_is_no_stored_query_is_422_told_with_its_line_and_changes_nothing(shared: httpx.Client) -> None:
    before = contained(shared)
    for text, words in BAD:
        answer = put(shared, "mine", text)
        assert answer.status_code == 422, answer.text
        assert words in answer.json()["detail"]
        shape = f"{shared.base_url}shapes/query"
        assert f'<{shape}>; rel="http://www.w3.org/ns/ldp#constrainedBy"' in answer.headers["link"]
        assert shared.post("/queries/", content=text, headers=QUERY).status_code == 422
    assert "@param" in shared.get("/shapes/query", headers={"Accept": "text/turtle"}).text
    assert shared.get("/queries/mine", headers=TEXT).text == TOPICS
    assert contained(shared) == before


def test_a_query_that_would_take_for_ever_is_taken_at_once_and_stopped_when_it_is_run(shared: httpx.Client) -> None:
    tables = " ".join(f"VALUES ?v{n} {{ {' '.join(map(str, range(100)))} }}" for n in range(8))
    assert put(shared, "long", f"# A.\nASK {{ {tables} FILTER(?v0 + ?v7 < 0) }}").status_code == 201
    for accept in ("application/sparql-results+json", "text/html"):
        stopped = shared.get("/queries/long", params={"timeout": "0.2"}, headers={"Accept": accept})
        assert stopped.status_code == 503
    assert shared.get("/queries/long", params={"timeout": "-1"}, headers=CSV).status_code == 400


def test_what_is_too_long_is_413(http: httpx.Client) -> None:
    before = contained(http)
    assert put(http, "long", ONE + "#" * 300_000).status_code == 422
    assert put(http, "long", ONE + "#" * 2_000_000).status_code == 413
    assert http.post("/queries/", content=ONE + "#" * 2_000_000, headers=QUERY).status_code == 413

    def chunks() -> Iterator[bytes]:
        yield ONE.encode()
        for _ in range(20):
            yield b"#" * 100_000

    assert http.put("/queries/long", content=chunks(), headers=QUERY).status_code == 422
    assert contained(http) == before


def test_only_sparql_is_taken(http: httpx.Client) -> None:
    before = contained(http)
    container = '<http://www.w3.org/ns/ldp#BasicContainer>; rel="type"'
    for headers, status in (
        ({"Content-Type": "text/turtle"}, 415),
        ({"Content-Type": "application/sparql-update"}, 415),
        ({"Content-Type": "application/sparql-query; charset=klingon"}, 415),
        ({**QUERY, "Content-Encoding": "gzip"}, 415),
        ({**QUERY, "Link": container}, 409),
    ):
        for method, url in (("PUT", "/queries/mine"), ("POST", "/queries/")):
            answer = http.request(method, url, content=ONE.encode(), headers=headers)
            assert answer.status_code == status, (method, headers, answer.text)
    assert contained(http) == before


def test_queries_lie_directly_in_their_room_with_names_encoded_as_in_all_urls(shared: httpx.Client) -> None:
    for path in ("/queries/a/b", "/queries/a/", "/queries/mine/b/"):
        assert shared.put(path, content=ONE, headers=QUERY).status_code in (409, 415)
        assert shared.get(path).status_code in (404, 308)
    assert len([name for name in contained(shared) if name.startswith(("a", "mine"))]) == 1
    for name in ("pl%C3%A4ne", "~.", "x%2Fy", "%3Cscript%3E"):
        assert put(shared, name, ONE).status_code == 201
        assert shared.get(f"/queries/{name}", headers=CSV).text.splitlines() == ["x", "1"]
        assert name in contained(shared)
        assert shared.get("/queries/", headers={"Accept": "text/html"}).status_code == 200
        assert shared.get("/openapi.json").status_code == 200
        assert shared.delete(f"/queries/{name}").status_code == 204


def test_what_comes_with_rosld_stays_as_it_is(http: httpx.Client) -> None:
    for method in ("PUT", "DELETE", "PATCH"):
        answer = http.request(method, "/queries/inventory", content=ONE, headers=QUERY)
        assert answer.status_code == 405
        assert answer.headers["allow"] == "GET, HEAD, OPTIONS"
        assert "another name" in answer.json()["detail"]
    assert "How many" in http.get("/queries/inventory", headers=TEXT).text


async def test_a_query_that_is_none_any_more_is_listed_and_says_why(tmp_path: Path) -> None:
    bad = b"# It was good once.\nSELECT * { ?s ?p }"

    async def chunks() -> AsyncIterator[bytes]:
        yield bad

    records = open_records(tmp_path, roots=("queries/",))
    for name in ("old", "inventory"):
        blob = await records.receive(chunks(), "application/sparql-query", limit=1000)
        await records.write(Put(f"queries/{name}", Model.NON_RDF_SOURCE, blob=blob))
    await records.close()
    with running(tmp_path, 0) as client:
        assert "old" in contained(client)
        answer = client.get("/queries/old", headers=CSV)
        assert answer.status_code == 409
        assert "old:2: it is not a valid query with its parameters bound" in answer.json()["detail"]
        assert client.get("/queries/old", headers={"Accept": "text/html"}).status_code == 409
        assert client.get("/queries/old", headers=TEXT).content == bad
        assert [f"{client.base_url}queries/old"] in ask(client, "SELECT ?q { ?q a ros:Query }")
        assert "It was good once." in client.get("/queries/old.meta", headers=NT).text
        assert client.get("/queries/inventory", headers=TEXT).content == bad
        assert client.get("/openapi.json").status_code == 200
        assert put(client, "old", ONE).status_code == 204
        assert client.get("/queries/old", headers=CSV).text.splitlines() == ["x", "1"]
        assert client.delete("/queries/inventory").status_code == 204
        shipped = client.get("/queries/inventory", params={"format": "json"})
        assert shipped.json()["head"]["vars"] == ["kind", "count"]
