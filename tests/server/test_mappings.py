"""Mapping documents over HTTP: put, read, patched, deleted; an invalid one is rejected and the old one remains."""

from __future__ import annotations

from collections.abc import Callable
from importlib.resources import files
from pathlib import Path

import httpx
import pytest
from click.testing import CliRunner
from pyoxigraph import CanonicalizationAlgorithm, Dataset, NamedNode, Quad, RdfFormat, Triple, parse

from rosld.adapters.base import AdapterOptions
from rosld.adapters.registry import adapter_for
from rosld.server.cli.main import main
from tests.server.robots.made_up import served

pytestmark = pytest.mark.slow

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
BAD = COCKPIT.replace('"/cockpit/"', '"/cockpit"')
SHIPPED = Path(str(files("rosld.adapters.aircraft"))) / "mapping.ttl"


@pytest.fixture
def stored(own_aircraft: httpx.Client) -> httpx.Client:
    """An aircraft for one test with a mapping of its cockpit."""
    answer = own_aircraft.put("/mappings/cockpit", content=COCKPIT, headers=TURTLE)
    assert (answer.status_code, answer.headers["location"]) == (201, f"{own_aircraft.base_url}mappings/cockpit")
    return own_aircraft


def canonical(triples: set[Triple]) -> set[Quad]:
    """Return the triples with canonical blank nodes."""
    dataset = Dataset(Quad(one.subject, one.predicate, one.object) for one in triples)
    dataset.canonicalize(CanonicalizationAlgorithm.UNSTABLE)
    return set(dataset)


def triples(text: str | bytes, url: str) -> set[Triple]:
    return {quad.triple for quad in parse(text, format=RdfFormat.TURTLE, base_iri=url)}


Reader = Callable[[httpx.Response], set[Triple]]


def said(triples: set[Triple], url: str) -> set[Triple]:
    """Return the client's statements, without those of the server about every stored resource."""
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


def test_a_mapping_is_the_very_rdf_that_was_put_and_can_be_put_back(stored: httpx.Client, triples_of: Reader) -> None:
    url = f"{stored.base_url}mappings/cockpit"
    for accept in ("text/turtle", "application/ld+json", "application/n-triples", "application/rdf+xml", "text/n3"):
        answer = stored.get("/mappings/cockpit", headers={"Accept": accept})
        assert canonical(said(triples_of(answer), url)) == canonical(triples(COCKPIT, url))
        back = stored.put("/mappings/cockpit", content=answer.content, headers={"Content-Type": accept})
        assert back.status_code == 204, back.text
    page = stored.get("/mappings/cockpit", headers={"Accept": "text/html"})
    assert page.status_code == 200
    assert "/cockpit/" in page.text
    assert "Delete it" in page.text
    assert stored.get("/mappings/", headers={"Accept": "text/html"}).status_code == 200


def test_a_mapping_is_patched_by_a_sparql_update_that_keeps_it_one(stored: httpx.Client) -> None:
    prefix = "PREFIX map: <https://w3id.org/rosld/mapping#> "
    before = stored.get("/mappings/cockpit").text
    bad = f"{prefix} DELETE {{ ?r map:path ?p }} WHERE {{ ?r map:path ?p }}"
    answer = stored.patch("/mappings/cockpit", content=bad, headers=UPDATE)
    assert answer.status_code == 422
    assert "map:path" in answer.json()["detail"]
    for far in ("LOAD <http://127.0.0.1:1/>", "CLEAR ALL", "INSERT DATA { GRAPH <x:g> { <x:a> <x:b> 1 } }"):
        assert stored.patch("/mappings/cockpit", content=far, headers=UPDATE).status_code == 422, far
    assert stored.get("/mappings/cockpit").text == before
    change = f"""{prefix} DELETE {{ ?p map:member "night" }} INSERT {{ ?p map:member "brightness" }}
        WHERE {{ ?p map:member "night" }}"""
    assert stored.patch("/mappings/cockpit", content=change, headers=UPDATE).status_code == 204
    assert "brightness" in stored.get("/mappings/cockpit").text
    assert stored.patch("/mappings/none", content=change, headers=UPDATE).status_code == 404


def test_a_bad_mapping_is_422_with_a_shacl_report_and_the_old_one_stays(stored: httpx.Client) -> None:
    before = stored.get("/mappings/cockpit").text
    answer = stored.put("/mappings/cockpit", content=BAD, headers={**TURTLE, "Accept": "application/n-triples"})
    assert answer.status_code == 422
    assert "http://www.w3.org/ns/shacl#ValidationReport" in answer.text
    assert f"<{stored.base_url}mappings/cockpit#cockpit>" in answer.text
    assert 'rel="http://www.w3.org/ns/ldp#constrainedBy"' in answer.headers["link"]
    assert "/shapes/mapping>" in answer.headers["link"]
    (violation,) = stored.put("/mappings/cockpit", content=BAD, headers=TURTLE).json()["violations"]
    assert violation["path"] == "<#cockpit> map:path"
    assert violation["value"] == "/cockpit"
    assert stored.get("/mappings/cockpit").text == before


def test_two_mappings_never_have_one_path(stored: httpx.Client) -> None:
    answer = stored.put("/mappings/other", content=COCKPIT, headers=TURTLE)
    assert answer.status_code == 422
    assert f"{stored.base_url}mappings/cockpit" in answer.json()["detail"]
    assert stored.get("/mappings/other").status_code == 404
    assert stored.delete("/mappings/cockpit").status_code == 204
    assert stored.put("/mappings/other", content=COCKPIT, headers=TURTLE).status_code == 201


def test_a_condition_is_described_by_one_mapping(stored: httpx.Client) -> None:
    shape = '<http://x/c> a sh:NodeShape ; map:about "/z/" ; sh:property [ sh:path av:p ; sh:minCount 1 ] .'

    def put(name: str, when: str) -> httpx.Response:
        text = f'{PREFIXES} <#r> a map:ComplexResource ; map:path "/{name}/" {when} .'
        return stored.put(f"/mappings/{name}", content=text, headers=TURTLE)

    described = f"; map:existsWhen <http://x/c> . {shape[:-1]}"
    assert put("a", described).status_code == 201
    answer = put("b", described)
    assert (answer.status_code, "http://x/c" in answer.json()["detail"]) == (422, True)
    assert put("a", "").status_code == 204
    assert put("b", described).status_code == 201


def test_what_is_no_mapping_is_refused(http: httpx.Client) -> None:
    before = http.get("/mappings/").headers["etag"]
    bodies: tuple[tuple[dict[str, str], bytes, int], ...] = (
        ({"Content-Type": "application/json"}, b"{}", 415),
        ({}, b"<> a <> .", 415),
        (TURTLE, b"<#a> a", 400),
        (TURTLE, b"\xff", 400),
        (TURTLE, b"", 422),
        (TURTLE, b"<> <x:p> " + b"[ <x:p> " * 20000 + b"]" * 20000 + b".", 400),
        ({"Content-Type": "application/ld+json"}, b'{"@context": "http://127.0.0.1:1/c", "@id": "#a"}', 400),
        (TURTLE, b"".join(b"<#a%d> <x:y> 1 . " % number for number in range(6000)), 422),
    )
    for headers, body, status in bodies:
        for method, url in (("PUT", "/mappings/x"), ("POST", "/mappings/")):
            answer = http.request(method, url, content=body, headers=headers)
            assert answer.status_code == status, answer.text
    assert http.get("/mappings/").headers["etag"] == before


def test_a_mapping_lies_directly_under_mappings_and_options_tell_what_is_taken(http: httpx.Client) -> None:
    moved = http.get("/mappings")
    assert (moved.status_code, moved.headers["location"]) == (308, f"{http.base_url}mappings/")
    assert http.get("/mappings/a/b").status_code == 404
    assert http.put("/mappings/a/b", content=COCKPIT, headers=TURTLE).status_code == 409
    assert http.get("/mappings/aircraft/").status_code == 308
    assert http.delete("/mappings/").status_code == 405
    one = http.options("/mappings/aircraft").headers
    assert one["allow"] == "DELETE, GET, HEAD, OPTIONS, PATCH, POST, PUT"
    assert "text/turtle" in one["accept-put"]
    assert "application/json" not in one["accept-put"].replace("application/ld+json", "")
    assert one["accept-patch"] == "application/sparql-update, text/n3"
    assert "text/turtle" in http.options("/mappings/").headers["accept-post"]


def test_a_file_given_at_start_is_in_force_also_in_place_of_that_of_the_robot(tmp_path: Path) -> None:
    for name, is_replaced in (("mine", False), ("aircraft", True)):
        path = tmp_path / f"{name}.ttl"
        path.write_text(COCKPIT)
        with served(adapter_for("aircraft", AdapterOptions()), mapping=(path,)) as http:
            assert "night" in http.get(f"/mappings/{name}").text
            assert ("/aircraft/" not in http.get("/mappings/aircraft").text) is is_replaced


def test_a_bad_file_or_a_second_for_one_path_is_told_at_start_and_nothing_is_served(tmp_path: Path) -> None:
    path = tmp_path / "mine.ttl"
    for text, words in (
        (SHIPPED.read_text(), ("/mappings/aircraft already defines this path",)),
        (BAD, (str(path), "map:path")),
    ):
        path.write_text(text)
        result = CliRunner().invoke(main, ["serve", "aircraft", "--port", "0", "--mapping", str(path)])
        assert result.exit_code == 1
        assert all(each in result.stderr for each in words)
