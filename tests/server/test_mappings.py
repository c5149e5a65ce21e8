"""Mapping documents over HTTP: put, read, patched, deleted; a bad one is refused and the old one stays in force."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from importlib.resources import files
from pathlib import Path

import httpx
import pytest
from click.testing import CliRunner
from pyoxigraph import BlankNode, CanonicalizationAlgorithm, Dataset, NamedNode, Quad, RdfFormat, Triple, parse

from rosld.server.cli.main import main

TURTLE = {"Content-Type": "text/turtle"}
UPDATE = {"Content-Type": "application/sparql-update"}
PREFIXES = """
@prefix map: <https://w3id.org/rosld/mapping#> .
@prefix av: <https://w3id.org/rosld/aircraft#> .
@prefix sh: <http://www.w3.org/ns/shacl#> .
"""
COCKPIT = (
    PREFIXES
    + """
<#cockpit> a map:ComplexResource ; map:path "/cockpit/" ;
    map:property [ map:predicate av:power ; map:member "night" ] .
"""
)
SECOND = COCKPIT.replace("av:power", "av:speed").replace('"night"', '"brightness"')
BAD = COCKPIT.replace('"/cockpit/"', '"/cockpit"')
SHIPPED = Path(str(files("rosld.adapters.aircraft"))) / "mapping.ttl"
READABLE = ("text/turtle", "application/ld+json", "application/n-triples", "application/rdf+xml", "text/n3")


@pytest.fixture
def plane(own_aircraft: httpx.Client) -> httpx.Client:
    """An aircraft of this test's own."""
    return own_aircraft


@pytest.fixture
def stored(plane: httpx.Client) -> httpx.Client:
    """The same with a mapping of its cockpit."""
    answer = plane.put("/mappings/cockpit", content=COCKPIT, headers=TURTLE)
    assert answer.status_code == 201, answer.text
    return plane


def canonical(triples: set[Triple]) -> set[Quad]:
    """The triples with canonical blank nodes."""
    dataset = Dataset(Quad(one.subject, one.predicate, one.object) for one in triples)
    dataset.canonicalize(CanonicalizationAlgorithm.UNSTABLE)
    return set(dataset)


def triples(text: str | bytes, url: str) -> set[Triple]:
    return {quad.triple for quad in parse(text, format=RdfFormat.TURTLE, base_iri=url)}


Reader = Callable[[httpx.Response], set[Triple]]


def said(triples: set[Triple], url: str) -> set[Triple]:
    """What the client said: without what the server says of every resource that is kept."""
    managed = ("http://www.w3.org/ns/ldp#", "http://purl.org/dc/terms/")
    return {
        one
        for one in triples
        if one.subject != NamedNode(url)
        or not (one.predicate.value.startswith(managed) or getattr(one.object, "value", "").startswith(managed))
    }


def test_the_aircraft_comes_with_its_mapping(http: httpx.Client, triples_of: Reader) -> None:
    listed = http.get("/mappings/", headers={"Accept": "application/n-triples"})
    assert "/mappings/aircraft>" in listed.text
    assert "ldp#BasicContainer" in listed.headers["link"]
    url = f"{http.base_url}mappings/aircraft"
    found = triples_of(http.get("/mappings/aircraft"))
    assert canonical(said(found, url)) == canonical(triples(SHIPPED.read_bytes(), url))


@pytest.mark.parametrize("accept", READABLE)
def test_a_mapping_is_exactly_the_rdf_that_was_put(stored: httpx.Client, triples_of: Reader, accept: str) -> None:
    answer = stored.get("/mappings/cockpit", headers={"Accept": accept})
    url = f"{stored.base_url}mappings/cockpit"
    assert canonical(said(triples_of(answer), url)) == canonical(triples(COCKPIT, url))


def test_a_mapping_has_a_page(stored: httpx.Client) -> None:
    page = stored.get("/mappings/cockpit", headers={"Accept": "text/html"})
    assert page.status_code == 200
    assert "/cockpit/" in page.text
    assert "Delete it" in page.text
    assert stored.get("/mappings/", headers={"Accept": "text/html"}).status_code == 200


def test_put_creates_and_then_replaces(plane: httpx.Client) -> None:
    assert plane.get("/mappings/cockpit").status_code == 404
    created = plane.put("/mappings/cockpit", content=COCKPIT, headers=TURTLE)
    assert (created.status_code, created.headers["location"]) == (201, f"{plane.base_url}mappings/cockpit")
    before = plane.get("/mappings/cockpit").headers["etag"]
    assert plane.put("/mappings/cockpit", content=SECOND, headers=TURTLE).status_code == 204
    answer = plane.get("/mappings/cockpit")
    assert "brightness" in answer.text
    assert answer.headers["etag"] != before


def test_what_was_read_can_be_put_back_in_every_syntax(stored: httpx.Client, triples_of: Reader) -> None:
    for media_type in READABLE:
        body = stored.get("/mappings/cockpit", headers={"Accept": media_type}).content
        answer = stored.put("/mappings/cockpit", content=body, headers={"Content-Type": media_type})
        assert answer.status_code == 204, answer.text
    url = f"{stored.base_url}mappings/cockpit"
    found = said(triples_of(stored.get("/mappings/cockpit")), url)
    assert canonical(found) == canonical(triples(COCKPIT, url))


def test_post_to_the_container_creates_with_the_name_of_slug(plane: httpx.Client) -> None:
    made = plane.post("/mappings/", content=COCKPIT, headers={**TURTLE, "Slug": "my cockpit"})
    assert (made.status_code, made.headers["location"]) == (201, f"{plane.base_url}mappings/my-cockpit")
    other = SECOND.replace('"/cockpit/"', '"/elsewhere/"')
    again = plane.post("/mappings/", content=other, headers={**TURTLE, "Slug": "my cockpit"})
    assert again.status_code == 201
    assert again.headers["location"].startswith(f"{plane.base_url}mappings/my-cockpit-")
    unnamed = plane.post("/mappings/", content=other.replace("/elsewhere/", "/third/"), headers=TURTLE)
    assert unnamed.status_code == 201
    assert plane.get(unnamed.headers["location"]).status_code == 200


def test_a_mapping_is_patched_by_a_sparql_update(stored: httpx.Client) -> None:
    change = """PREFIX map: <https://w3id.org/rosld/mapping#>
        DELETE { ?p map:member "night" } INSERT { ?p map:member "brightness" } WHERE { ?p map:member "night" }"""
    assert stored.patch("/mappings/cockpit", content=change, headers=UPDATE).status_code == 204
    assert "brightness" in stored.get("/mappings/cockpit").text
    assert stored.patch("/mappings/none", content=change, headers=UPDATE).status_code == 404


def test_a_patch_to_something_bad_is_refused_whole(stored: httpx.Client) -> None:
    before = stored.get("/mappings/cockpit").text
    change = "PREFIX map: <https://w3id.org/rosld/mapping#> DELETE { ?r map:path ?p } WHERE { ?r map:path ?p }"
    answer = stored.patch("/mappings/cockpit", content=change, headers=UPDATE)
    assert answer.status_code == 422
    assert "map:path" in answer.json()["detail"]
    assert stored.get("/mappings/cockpit").text == before


def test_a_mapping_is_deleted(stored: httpx.Client) -> None:
    assert stored.delete("/mappings/cockpit").status_code == 204
    assert stored.get("/mappings/cockpit").status_code == 410
    assert stored.delete("/mappings/cockpit").status_code == 410
    assert stored.get("/resources/cockpit/").text.count("av:power") == 0
    assert "cockpit" not in stored.get("/mappings/").text
    assert stored.put("/mappings/cockpit", content=COCKPIT, headers=TURTLE).status_code == 201
    assert "cockpit" in stored.get("/mappings/").text


def test_a_bad_mapping_is_422_with_a_shacl_report_and_the_old_one_stays(stored: httpx.Client) -> None:
    before = stored.get("/mappings/cockpit").text
    answer = stored.put("/mappings/cockpit", content=BAD, headers={**TURTLE, "Accept": "application/n-triples"})
    assert answer.status_code == 422
    assert "http://www.w3.org/ns/shacl#ValidationReport" in answer.text
    assert f"<{stored.base_url}mappings/cockpit#cockpit>" in answer.text
    assert 'rel="http://www.w3.org/ns/ldp#constrainedBy"' in answer.headers["link"]
    assert "/shapes/mapping>" in answer.headers["link"]
    assert stored.get("/mappings/cockpit").text == before


def test_a_bad_mapping_is_told_field_by_field_in_json(plane: httpx.Client) -> None:
    (violation,) = plane.put("/mappings/cockpit", content=BAD, headers=TURTLE).json()["violations"]
    assert violation["path"] == "<#cockpit> map:path"
    assert violation["value"] == "/cockpit"
    assert plane.get("/mappings/cockpit").status_code == 404


def test_the_shape_of_mappings_is_where_the_link_leads(http: httpx.Client, triples_of: Reader) -> None:
    found = triples_of(http.get("/shapes/mapping"))
    subjects = {str(one.subject) for one in found if not isinstance(one.subject, BlankNode)}
    assert f"<{http.base_url}shapes/mapping#complex-resource>" in subjects
    assert http.get("/shapes/mapping", headers={"Accept": "text/html"}).status_code == 200
    assert "/shapes/mapping>" in http.get("/shapes/", headers={"Accept": "application/n-triples"}).text
    links = http.get("/mappings/aircraft").headers["link"]
    for relation in ("http://purl.org/dc/terms/conformsTo", "http://www.w3.org/ns/ldp#constrainedBy"):
        assert f'<{http.base_url}shapes/mapping>; rel="{relation}"' in links


def test_two_mappings_never_have_one_path(stored: httpx.Client) -> None:
    answer = stored.put("/mappings/other", content=COCKPIT, headers=TURTLE)
    assert answer.status_code == 422
    assert f"{stored.base_url}mappings/cockpit" in answer.json()["detail"]
    assert stored.get("/mappings/other").status_code == 404
    assert stored.delete("/mappings/cockpit").status_code == 204
    assert stored.put("/mappings/other", content=COCKPIT, headers=TURTLE).status_code == 201


@pytest.mark.parametrize(
    ("headers", "body", "status"),
    [
        ({"Content-Type": "application/json"}, b"{}", 415),
        ({}, b"<> a <> .", 415),
        (TURTLE, b"<#a> a", 400),
        (TURTLE, b"\xff", 400),
        (TURTLE, b"", 422),
        (TURTLE, b"<> <x:p> " + b"[ <x:p> " * 20000 + b"]" * 20000 + b".", 400),
        ({"Content-Type": "application/ld+json"}, b'{"@context": "http://127.0.0.1:1/c", "@id": "#a"}', 400),
        (TURTLE, b"".join(b"<#a%d> <x:y> 1 . " % number for number in range(6000)), 422),
    ],
)
def test_what_is_no_mapping_is_refused(http: httpx.Client, headers: dict[str, str], body: bytes, status: int) -> None:
    before = http.get("/mappings/").headers["etag"]
    for method, url in (("PUT", "/mappings/x"), ("POST", "/mappings/")):
        answer = http.request(method, url, content=body, headers=headers)
        assert answer.status_code == status, answer.text
    assert http.get("/mappings/").headers["etag"] == before


@pytest.mark.parametrize(
    "update", ["LOAD <http://127.0.0.1:1/>", "CLEAR ALL", "INSERT DATA { GRAPH <x:g> { <x:a> <x:b> 1 } }"]
)
def test_an_update_reaches_no_further_than_its_document(http: httpx.Client, update: str) -> None:
    assert http.patch("/mappings/aircraft", content=update, headers=UPDATE).status_code == 422


def test_preconditions_guard_a_mapping(stored: httpx.Client) -> None:
    etag = stored.get("/mappings/cockpit").headers["etag"]
    url = "/mappings/cockpit"
    assert stored.put(url, content=COCKPIT, headers={**TURTLE, "If-None-Match": "*"}).status_code == 412
    assert stored.put(url, content=SECOND, headers={**TURTLE, "If-Match": etag}).status_code == 204
    assert stored.put(url, content=COCKPIT, headers={**TURTLE, "If-Match": etag}).status_code == 412
    assert stored.delete(url, headers={"If-Match": etag}).status_code == 412
    assert stored.get(url, headers={"If-None-Match": stored.get(url).headers["etag"]}).status_code == 304


def test_of_two_writes_on_one_state_only_one_is_carried_out(stored: httpx.Client) -> None:
    headers = {**TURTLE, "If-Match": stored.get("/mappings/cockpit").headers["etag"]}
    bodies = [SECOND + f'<> <x:number> "{number}" .' for number in range(8)]
    with ThreadPoolExecutor(len(bodies)) as pool:
        answers = list(pool.map(lambda body: stored.put("/mappings/cockpit", content=body, headers=headers), bodies))
    codes = sorted(answer.status_code for answer in answers)
    assert codes[0] == 204
    assert set(codes[1:]) <= {409, 412}
    winner = bodies[[answer.status_code for answer in answers].index(204)]
    assert winner.rpartition('"')[0][-1] in stored.get("/mappings/cockpit").text.rpartition("x:number")[2]


def test_a_mapping_lies_directly_under_mappings(http: httpx.Client) -> None:
    moved = http.get("/mappings")
    assert (moved.status_code, moved.headers["location"]) == (308, f"{http.base_url}mappings/")
    assert http.get("/mappings/a/b").status_code == 404
    assert http.put("/mappings/a/b", content=COCKPIT, headers=TURTLE).status_code == 409
    assert http.get("/mappings/aircraft/").status_code == 308
    assert http.delete("/mappings/").status_code == 405


def test_names_are_any_unicode(plane: httpx.Client) -> None:
    for name in ("pl%C3%A4ne", "a%20b", "~.", "x%2Fy"):
        url = f"/mappings/{name}"
        assert plane.put(url, content=COCKPIT, headers=TURTLE).status_code == 201
        assert plane.get(url).status_code == 200
        assert plane.delete(url).status_code == 204


def test_a_read_only_server_shows_its_mappings_and_changes_none(serve: Callable[..., object]) -> None:
    client: httpx.Client = serve("aircraft", "--read-only").http  # type: ignore[attr-defined]
    answers = [
        client.put("/mappings/aircraft", content=COCKPIT, headers=TURTLE),
        client.post("/mappings/", content=COCKPIT, headers=TURTLE),
        client.patch("/mappings/aircraft", content="INSERT DATA { <x:a> <x:b> 1 }", headers=UPDATE),
        client.delete("/mappings/aircraft"),
    ]
    for answer in answers:
        assert answer.status_code == 405
        assert answer.json()["detail"] == "This server is read-only."
        assert answer.headers["allow"] == "GET, HEAD, OPTIONS"
    assert client.get("/mappings/aircraft").status_code == 200


def test_options_tell_what_is_taken(http: httpx.Client) -> None:
    one = http.options("/mappings/aircraft").headers
    assert one["allow"] == "DELETE, GET, HEAD, OPTIONS, PATCH, POST, PUT"
    assert "text/turtle" in one["accept-put"]
    assert "application/json" not in one["accept-put"].replace("application/ld+json", "")
    assert one["accept-patch"] == "application/sparql-update, text/n3"
    assert "text/turtle" in http.options("/mappings/").headers["accept-post"]


def test_a_file_given_at_start_is_in_force(serve: Callable[..., object], tmp_path: Path) -> None:
    path = tmp_path / "mine.ttl"
    path.write_text(COCKPIT)
    client: httpx.Client = serve("aircraft", "--mapping", str(path)).http  # type: ignore[attr-defined]
    assert "night" in client.get("/mappings/mine").text
    assert client.get("/mappings/aircraft").status_code == 200


def test_a_file_of_its_name_takes_the_place_of_the_mapping_that_the_robot_comes_with(
    serve: Callable[..., object], tmp_path: Path
) -> None:
    path = tmp_path / "aircraft.ttl"
    path.write_text(COCKPIT)
    client: httpx.Client = serve("aircraft", "--mapping", str(path)).http  # type: ignore[attr-defined]
    assert "night" in client.get("/mappings/aircraft").text
    assert "/aircraft/" not in client.get("/mappings/aircraft").text


def test_files_that_arrange_one_path_are_told_at_start(tmp_path: Path) -> None:
    path = tmp_path / "mine.ttl"
    path.write_bytes(SHIPPED.read_bytes())
    result = CliRunner().invoke(main, ["serve", "aircraft", "--port", "0", "--mapping", str(path)])
    assert result.exit_code == 1
    assert "/mappings/aircraft arranges this path already" in result.stderr


def test_a_bad_file_at_start_is_told_and_nothing_is_served(tmp_path: Path) -> None:
    path = tmp_path / "mine.ttl"
    path.write_text(BAD)
    result = CliRunner().invoke(main, ["serve", "aircraft", "--port", "0", "--mapping", str(path)])
    assert result.exit_code == 1
    assert str(path) in result.stderr
    assert "map:path" in result.stderr
