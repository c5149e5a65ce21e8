"""Limits of clients over HTTP: in force from PUT to DELETE, listed, stored; unusable ones are rejected."""

from __future__ import annotations

from pathlib import Path

import httpx
import pytest
import rdflib
from rdflib import SH, XSD

from tests.server.robots.durable import running

pytestmark = pytest.mark.slow

TURTLE = {"Content-Type": "text/turtle"}
NT = {"Accept": "application/n-triples"}
JSON = {"Content-Type": "application/json"}
PREFIXES = """
@prefix sh: <http://www.w3.org/ns/shacl#> .
@prefix rdf: <http://www.w3.org/1999/02/22-rdf-syntax-ns#> .
@prefix std: <https://w3id.org/rosld/types/std_msgs/msg/> .
"""
SLOW = (
    PREFIXES
    + """
<#slow> a sh:NodeShape ; sh:targetNode <../resources/aircraft/engine/speed> ;
    sh:property [ sh:path rdf:value ; sh:maxInclusive 100 ] .
"""
)
SHORT = (
    PREFIXES
    + """
<#short> a sh:NodeShape ; sh:targetClass std:String ;
    sh:property [ sh:path <https://w3id.org/rosld/types/std_msgs/msg/String#data> ; sh:maxLength 5 ] .
"""
)


@pytest.fixture
def plane(own_aircraft: httpx.Client) -> httpx.Client:
    """An aircraft for one test, which has been started."""
    assert own_aircraft.post("/resources/aircraft/start").status_code == 200
    return own_aircraft


def put(client: httpx.Client, name: str, text: str | bytes, **headers: str) -> httpx.Response:
    return client.put(f"/shapes/{name}", content=text, headers={**TURTLE, **headers})


def fly(client: httpx.Client, speed: int) -> int:
    """Set the engine's speed; return the status."""
    return client.put("/resources/aircraft/engine/speed", content=str(speed), headers=JSON).status_code


def show(client: httpx.Client, text: str) -> int:
    """Publish a message for a display; return the status."""
    return client.put("/topics/cockpit/display", json={"data": text}).status_code


def contained(client: httpx.Client) -> set[str]:
    """Return the listed names below /shapes/."""
    lines = client.get("/shapes/", headers=NT).text.splitlines()
    return {line.split("/shapes/")[-1].split(">")[0] for line in lines if "ldp#contains" in line}


def test_the_limits_of_a_file_are_shown_with_names_and_datatypes(http: httpx.Client) -> None:
    text = http.get("/shapes/limits", headers=NT).text
    assert f"<{http.base_url}#" not in text
    said = rdflib.Graph().parse(data=text, format="nt")
    speed = rdflib.URIRef(f"{http.base_url}shapes/limits#speed")
    assert (speed, SH.targetNode, rdflib.URIRef(f"{http.base_url}resources/aircraft/engine/speed")) in said
    found = {
        str(said.value(shape, SH.targetNode)).rpartition("/")[2]: said.value(
            said.value(shape, SH.property), SH.datatype
        )
        for shape in said.subjects(SH.targetNode)
    }
    assert found == {"speed": XSD.double, "direction": XSD.double, "power": XSD.string}
    query = f"SELECT (COUNT(*) AS ?n) {{ GRAPH <{http.base_url}shapes/limits> {{ ?s <{SH.datatype}> ?o }} }}"
    counted = http.get("/sparql", params={"query": query, "format": "json"})
    assert counted.json()["results"]["bindings"][0]["n"]["value"] == "3"


def test_a_limit_is_in_force_from_the_put_to_the_delete(plane: httpx.Client) -> None:
    assert fly(plane, 500) == 204
    made = put(plane, "slow", SLOW)
    assert (made.status_code, made.headers["location"]) == (201, f"{plane.base_url}shapes/slow")
    refused = plane.put("/resources/aircraft/engine/speed", content="500", headers=JSON)
    assert refused.status_code == 422
    assert "at most 100" in refused.json()["detail"]
    assert fly(plane, 99) == 204
    assert put(plane, "slow", SLOW.replace("100", "600")).status_code == 204
    assert fly(plane, 500) == 204
    assert fly(plane, 700) == 422
    assert plane.delete("/shapes/slow").status_code == 204
    assert fly(plane, 700) == 204
    assert fly(plane, 2000) == 422  # the aircraft's own
    assert plane.get("/shapes/slow").status_code == 410
    assert put(plane, "slow", SLOW).status_code == 201
    assert fly(plane, 700) == 422


def test_limits_of_several_documents_hold_together_and_can_be_patched(plane: httpx.Client) -> None:
    posted = plane.post("/shapes/", content=SLOW, headers={**TURTLE, "Slug": "std_msgs"})
    url = posted.headers["location"]
    assert url == f"{plane.base_url}shapes/std_msgs-2"
    assert put(plane, "quick", SLOW.replace("sh:maxInclusive 100", "sh:minInclusive 50")).status_code == 201
    assert [fly(plane, speed) for speed in (49, 50, 100, 101)] == [422, 204, 204, 422]
    assert put(plane, "short", SHORT).status_code == 201
    assert show(plane, "short") in (200, 202, 204)
    assert show(plane, "longer") == 422
    etag = plane.get(url).headers["etag"]
    assert plane.put(url, content=SLOW, headers={**TURTLE, "If-Match": etag}).status_code == 204
    assert plane.put(url, content=SLOW, headers={**TURTLE, "If-Match": etag}).status_code == 412
    assert plane.put(url, content="{}", headers=JSON).status_code == 415
    change = """PREFIX sh: <http://www.w3.org/ns/shacl#>
        DELETE { ?p sh:maxInclusive ?m } INSERT { ?p sh:maxInclusive 200 } WHERE { ?p sh:maxInclusive ?m }"""
    assert plane.patch(url, content=change, headers={"Content-Type": "application/sparql-update"}).status_code == 204
    assert [fly(plane, speed) for speed in (150, 250)] == [204, 422]
    options = plane.options(url).headers
    assert {"DELETE", "GET", "PATCH", "PUT"} <= set(options["allow"].split(", "))
    assert "/shapes/limits>" in options["link"]
    assert "text/turtle" in plane.options("/shapes/").headers["accept-post"]


def test_limits_are_part_of_what_resources_say_of_themselves(plane: httpx.Client) -> None:
    url = "/resources/aircraft/engine/speed"
    before = plane.get(url, headers=NT)
    assert put(plane, "slow", SLOW).status_code == 201
    after = plane.get(url, headers=NT)
    assert '"100"' in after.text
    assert '"100"' not in before.text
    assert "#slow>" in plane.get("/shapes/limits", headers=NT).text
    query = "SELECT ?s { GRAPH ?g { ?s <http://www.w3.org/ns/shacl#targetNode> ?o } }"
    found = plane.post(
        "/sparql", content=query, headers={"Content-Type": "application/sparql-query", "Accept": "text/csv"}
    )
    assert f"{plane.base_url}shapes/slow#slow" in found.text
    assert {"slow", "limits", "query", "std_msgs/"} <= contained(plane)
    assert "/shapes/slow" in plane.get("/shapes/", headers={"Accept": "text/html"}).text
    listed = "ASK { GRAPH <shapes/> { ?c <http://www.w3.org/ns/ldp#contains> <shapes/slow> , <shapes/std_msgs/> } }"
    answer = plane.get("/sparql", params={"query": listed}, headers={"Accept": "application/sparql-results+json"})
    assert answer.json()["boolean"] is True
    assert plane.delete("/shapes/slow").status_code == 204
    assert "#slow>" not in plane.get("/shapes/limits", headers=NT).text
    assert '"100"' not in plane.get(url, headers=NT).text


NESTED = "<#a> a sh:NodeShape ; sh:targetClass std:String ; sh:not " + "[ sh:not " * 100 + "[]" + " ]" * 100 + " ."
USELESS = (
    ("", "limits nothing"),
    ("<> <x:p> 1 .", "limits nothing"),
    (SLOW.replace("sh:targetNode <../resources/aircraft/engine/speed> ;", ""), "limits nothing"),
    (SLOW.replace("../resources", "resources"), "which is not a resource"),
    (SLOW.replace("../resources/aircraft/engine/speed", "http://other.example/x"), "which is not a resource"),
    (SLOW.replace("sh:targetNode", "sh:targetSubjectsOf"), "name what it limits by sh:targetNode"),
    (SLOW.replace("sh:maxInclusive 100", 'sh:sparql [ sh:select "SELECT $this {}" ]'), ""),
    (SLOW.replace("sh:maxInclusive 100", "sh:maxInclusive <x:y>"), ""),
    (SLOW.replace("sh:maxInclusive 100", 'sh:pattern "(?=a)"'), ""),
    (SLOW.replace("sh:maxInclusive 100", "sh:node <#slow>"), ""),
    (SHORT.replace("std:String ;", "<x:Strange> ;"), "which is not a message type"),
    (PREFIXES + NESTED, ""),
    ("".join(f"<x:s{n}> <x:p> {n} .\n" for n in range(6000)), "the limit is 5000"),
)


def test_what_cannot_be_used_is_422_and_changes_nothing(http: httpx.Client) -> None:
    before = contained(http)
    for text, words in USELESS:
        answer = put(http, "bad", text)
        assert answer.status_code == 422, answer.text
        assert words in answer.json()["detail"]
        assert '/shapes/limits>; rel="http://www.w3.org/ns/ldp#constrainedBy"' in answer.headers["link"]
        assert http.post("/shapes/", content=text, headers=TURTLE).status_code == 422
    assert http.get("/shapes/bad").status_code == 404
    assert contained(http) == before


def test_names_of_the_servers_own_are_not_for_limits(http: httpx.Client) -> None:
    for path in ("limits", "std_msgs", "std_msgs/", "std_msgs/msg/String", "mine/"):
        assert put(http, path, SLOW).status_code == 405, path
    assert http.delete("/shapes/mapping").status_code == 405
    assert put(http, "mine/more", SLOW).status_code == 308
    named = http.get("/shapes/std_msgs")
    assert (named.status_code, named.headers["location"]) == (308, f"{http.base_url}shapes/std_msgs/")


def test_limits_survive_a_restart(tmp_path: Path) -> None:
    with running(tmp_path, 0) as client:
        port = client.base_url.port
        assert put(client, "slow", SHORT).status_code == 201
    with running(tmp_path, port) as client:
        assert show(client, "longer") == 422
        assert client.delete("/shapes/slow").status_code == 204
        assert show(client, "longer") in (200, 202, 204)
