"""PATCH (LDP 4.2.7) over HTTP; `tests/server/rest/test_n3patch.py` and `tests/server/sparql` test the languages."""

from __future__ import annotations

from typing import TYPE_CHECKING

import httpx
import pytest
from pyoxigraph import Literal, NamedNode

from rosld.ontology.vocab import ldp

if TYPE_CHECKING:
    from tests.conformance.ldp.conftest import Place, Served

P, Q = NamedNode("http://ex.org/p"), NamedNode("http://ex.org/q")
PREFIXES = "@prefix solid: <http://www.w3.org/ns/solid/terms#> . @prefix ex: <http://ex.org/> .\n"
NEW = 'INSERT DATA { <> <http://ex.org/p> "new" }'


def update(place: Place, text: str, name: str = "a", **headers: str) -> httpx.Response:
    return place.send("PATCH", name, text, "application/sparql-update", **headers)


def n3(place: Place, said: str, name: str = "a") -> httpx.Response:
    return place.send("PATCH", name, f"{PREFIXES}_:x a solid:InsertDeletePatch ; {said} .", "text/n3")


def merge(place: Place, text: str, name: str = "a.json") -> httpx.Response:
    return place.send("PATCH", name, text, "application/merge-patch+json")


@pytest.fixture(autouse=True)
def patched(place: Place) -> None:
    """Put the resources to be patched."""
    place.put("a", '<> <http://ex.org/p> "old", 1.50 ; <http://ex.org/q> "kept" .')
    assert place.send("PUT", "a.json", '{"a": {"b": 1, "c": 2}, "d": [1, 2]}', "application/json").status_code == 201


def test_sparql_update_changes_the_resource(place: Place) -> None:
    """It sees no other resource."""
    place.put("b", '<> <http://ex.org/p> "of b" .')
    assert update(place, 'DELETE { <> ?p "old" } INSERT { <> ?p "new" } WHERE { ?s ?p "old" }').is_success
    assert update(place, 'INSERT { <> ?p "seen" } WHERE { ?s ?p "of b" }').is_success
    assert {str(each) for each in place.objects("a", P)} == {
        '"new"',
        '"1.50"^^<http://www.w3.org/2001/XMLSchema#decimal>',
    }
    assert place.objects("a", Q) == {Literal("kept")}
    assert update(place, NEW, If_Match='"another"').status_code == 412


def test_n3_patch_changes_the_resource_or_is_refused(place: Place) -> None:
    answer = n3(place, 'solid:where { ?s ex:q ?o } ; solid:deletes { <> ex:p "old" } ; solid:inserts { ?s ex:p ?o }')
    assert answer.is_success, answer.text
    assert Literal("old") not in place.objects("a", P)
    assert Literal("kept") in place.objects("a", P)
    before = place.get("a").headers["etag"]
    assert n3(place, 'solid:deletes { <> ex:p "never said" }').status_code == 409
    assert n3(place, "solid:where { <> ex:p ?o } ; solid:deletes { <> ex:p ?o }").status_code == 409
    assert n3(place, "solid:inserts { <> ex:p _:blank }").status_code == 422
    assert place.get("a").headers["etag"] == before


def test_n3_patch_changes_a_container(place: Place) -> None:
    made = place.post()
    assert n3(place, 'solid:inserts { <> ex:p "mine" }', "").is_success
    assert place.objects("", P) == {Literal("mine")}
    assert n3(place, f"solid:deletes {{ <> <{ldp.iri}contains> <{made}> }}", "").status_code == 409
    assert made in place.contained()


def test_merge_patch_changes_a_json_file_and_nothing_else(place: Place) -> None:
    assert merge(place, '{"a": {"b": null, "e": "x"}, "d": [3]}').is_success
    assert merge(place, "{no json").status_code == 400
    answer = place.get("a.json")
    assert answer.json() == {"a": {"c": 2, "e": "x"}, "d": [3]}
    assert answer.headers["content-type"] == "application/json"
    place.send("PUT", "picture", b"\x89PNG", "image/png")
    assert [merge(place, "{}", name).status_code for name in ("picture", "a")] == [415, 415]


@pytest.mark.parametrize("name", ["new", "deep/er/new", "box/", "gone"])
def test_a_patch_that_only_inserts_creates_the_resource(name: str, place: Place) -> None:
    """Solid Protocol, 5.3.1."""
    place.put("gone", "<> <http://ex.org/p> 1 .")
    assert place.send("DELETE", "gone").status_code == 204
    answer = update(place, NEW, name)
    assert (answer.status_code, answer.headers["location"]) == (201, place.at(name)), answer.text
    assert place.objects(name, P) == {Literal("new")}
    assert n3(place, 'solid:inserts { <> ex:p "new" . }', "by-n3").status_code == 201
    assert place.objects("by-n3", P) == {Literal("new")}


def test_any_other_patch_of_a_missing_resource_creates_nothing(place: Place, served: Served) -> None:
    for text in (
        'DELETE { <> ?p "old" } INSERT { <> <http://ex.org/p> "new" } WHERE { <> ?p "old" }',
        f'{NEW} ; DELETE DATA {{ <> <http://ex.org/p> "old" }}',
        "DELETE WHERE { <> <http://ex.org/p> ?o }",
    ):
        assert update(place, text, "other").status_code == 404
    assert n3(place, 'solid:inserts { <> ex:p 1 . } ; solid:deletes { <> ex:p "old" . }', "other").status_code == 409
    assert n3(place, "solid:where { <> ex:q ?q . } ; solid:inserts { <> ex:p ?q . }", "other").status_code == 409
    assert merge(place, '{"a": 1}', "other").status_code == 404
    assert update(place, "INSERT DATA { nonsense", "other").status_code == 400
    assert update(place, NEW, "other", If_Match="*").status_code == 412
    assert place.get("other").status_code == 404
    graph = f"?graph={place.at('other')}"
    assert served.at("graphs").send("PATCH", graph, NEW, "application/sparql-update").status_code == 201
