"""PATCH: SPARQL Update of the one resource, N3 patches as Solid has them, JSON merge patches (LDP 4.2.7)."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import httpx
import pytest
from pyoxigraph import Literal, NamedNode

from rosld.ontology.vocab import ldp

if TYPE_CHECKING:
    from tests.conformance.ldp.conftest import Place, Served

P, Q = NamedNode("http://ex.org/p"), NamedNode("http://ex.org/q")
PREFIXES = "@prefix solid: <http://www.w3.org/ns/solid/terms#> . @prefix ex: <http://ex.org/> .\n"


def update(place: Place, text: str, name: str = "a", **headers: str) -> httpx.Response:
    return place.send("PATCH", name, text, "application/sparql-update", **headers)


def n3(place: Place, said: str, name: str = "a", **headers: str) -> httpx.Response:
    return place.send("PATCH", name, f"{PREFIXES}_:x a solid:InsertDeletePatch ; {said} .", "text/n3", **headers)


def merge(place: Place, text: str, name: str = "a.json") -> httpx.Response:
    return place.send("PATCH", name, text, "application/merge-patch+json")


@pytest.fixture(autouse=True)
def there(place: Place) -> None:
    """What is patched."""
    place.put("a", '<> <http://ex.org/p> "old" ; <http://ex.org/q> "kept" .')
    assert place.send("PUT", "a.json", '{"a": {"b": 1, "c": 2}, "d": [1, 2]}', "application/json").status_code == 201


# SPARQL Update


def test_sparql_update_changes_the_resource(place: Place) -> None:
    assert update(place, 'DELETE { <> ?p "old" } INSERT { <> ?p "new" } WHERE { <> ?p "old" }').is_success
    assert place.objects("a", P) == {Literal("new")}
    assert place.objects("a", Q) == {Literal("kept")}


def test_sparql_update_sees_this_resource_only(place: Place) -> None:
    place.put("b", '<> <http://ex.org/p> "of b" .')
    assert update(place, "INSERT { <> <http://ex.org/seen> ?o } WHERE { ?s <http://ex.org/p> ?o }").is_success
    assert place.objects("a", NamedNode("http://ex.org/seen")) == {Literal("old")}


@pytest.mark.parametrize(
    "text",
    [
        "INSERT DATA { GRAPH <http://ex.org/g> { <> <http://ex.org/p> 1 } }",
        "WITH <http://ex.org/g> DELETE { ?s ?p ?o } WHERE { ?s ?p ?o }",
        "DELETE { ?s ?p ?o } USING <http://ex.org/g> WHERE { ?s ?p ?o }",
        "INSERT { ?s ?p ?o } WHERE { GRAPH ?g { ?s ?p ?o } }",
        "INSERT { ?s ?p ?o } WHERE { SERVICE <http://127.0.0.1:9/> { ?s ?p ?o } }",
        "LOAD <http://127.0.0.1:9/>",
        "CLEAR ALL",
        "DROP DEFAULT",
        "COPY DEFAULT TO <http://ex.org/g>",
    ],
)
def test_sparql_update_beyond_the_resource_is_refused(text: str, place: Place) -> None:
    before = place.get("a").headers["etag"]
    assert update(place, text).status_code in (400, 422)
    assert place.get("a").headers["etag"] == before


def test_sparql_update_that_cannot_be_parsed_is_400(place: Place) -> None:
    assert update(place, "INSERT NOTHING").status_code == 400


def test_sparql_update_keeps_spellings(place: Place) -> None:
    place.put("a", "<> <http://ex.org/p> 01 , 1.50 .")
    assert update(place, 'INSERT DATA { <> <http://ex.org/q> "x" }').is_success
    assert {each.value for each in place.objects("a", P) if isinstance(each, Literal)} == {"01", "1.50"}


def test_sparql_update_is_guarded_by_if_match(place: Place) -> None:
    text = "INSERT DATA { <> <http://ex.org/p> 1 }"
    assert update(place, text, If_Match='"another"').status_code == 412
    assert update(place, text, If_Match=place.get("a").headers["etag"]).is_success


def test_sparql_update_may_leave_nothing(place: Place) -> None:
    assert update(place, "DELETE WHERE { <> <http://ex.org/p> ?o ; <http://ex.org/q> ?o2 }").is_success
    assert place.objects("a", P) | place.objects("a", Q) == set()


# N3 patches


def test_n3_patch_inserts_and_deletes(place: Place) -> None:
    answer = n3(place, 'solid:deletes { <> ex:p "old" } ; solid:inserts { <> ex:p "new" }')
    assert answer.is_success, answer.text
    assert place.objects("a", P) == {Literal("new")}
    assert place.objects("a", Q) == {Literal("kept")}


def test_n3_patch_binds_what_where_finds(place: Place) -> None:
    answer = n3(place, "solid:where { ?s ex:p ?o } ; solid:deletes { ?s ex:p ?o } ; solid:inserts { ?s ex:q ?o }")
    assert answer.is_success, answer.text
    assert place.objects("a", Q) == {Literal("old"), Literal("kept")}


def test_n3_patch_of_what_is_not_there_is_409(place: Place) -> None:
    before = place.get("a").headers["etag"]
    assert n3(place, 'solid:deletes { <> ex:p "never said" }').status_code == 409
    assert n3(place, "solid:where { <> ex:nothing ?o } ; solid:deletes { <> ex:nothing ?o }").status_code == 409
    assert place.get("a").headers["etag"] == before


def test_n3_patch_that_is_ambiguous_is_409(place: Place) -> None:
    place.put("a", "<> <http://ex.org/p> 1 , 2 .")
    assert n3(place, "solid:where { <> ex:p ?o } ; solid:deletes { <> ex:p ?o }").status_code == 409


@pytest.mark.parametrize(
    "text",
    [
        "<> <http://ex.org/p> 1 .",
        f"{PREFIXES}_:x solid:inserts {{ <> ex:p 1 }} .",
        f"{PREFIXES}_:x a solid:InsertDeletePatch ; solid:inserts {{ <> ex:p ?unbound }} .",
        f"{PREFIXES}_:x a solid:InsertDeletePatch ; solid:inserts {{ <> ex:p _:blank }} .",
        f"{PREFIXES}_:x a solid:InsertDeletePatch ; solid:inserts {{ <> ex:p 1 }} , {{ <> ex:p 2 }} .",
    ],
)
def test_n3_patch_that_makes_no_sense_is_422(text: str, place: Place) -> None:
    before = place.get("a").headers["etag"]
    assert place.send("PATCH", "a", text, "text/n3").status_code == 422
    assert place.get("a").headers["etag"] == before


def test_n3_patch_changes_a_container(place: Place) -> None:
    made = place.post()
    assert n3(place, 'solid:inserts { <> ex:p "mine" }', "").is_success
    assert place.objects("", P) == {Literal("mine")}
    assert made in place.contained()
    assert n3(place, f"solid:deletes {{ <> <{ldp.iri}contains> <{made}> }}", "").status_code == 409


# JSON merge patches


def test_merge_patch_changes_a_json_file(place: Place) -> None:
    assert merge(place, '{"a": {"b": null, "e": "x"}, "d": [3]}').is_success
    answer = place.get("a.json")
    assert answer.json() == {"a": {"c": 2, "e": "x"}, "d": [3]}
    assert answer.headers["content-type"] == "application/json"


def test_merge_patch_of_what_is_no_json_is_415(place: Place) -> None:
    place.send("PUT", "picture", b"\x89PNG", "image/png")
    assert merge(place, "{}", "picture").status_code == 415
    assert merge(place, "{}", "a").status_code == 415


def test_merge_patch_that_cannot_be_parsed_is_400(place: Place) -> None:
    assert merge(place, "{no json").status_code == 400
    assert place.get("a.json").json() == {"a": {"b": 1, "c": 2}, "d": [1, 2]}


# What is not there yet (Solid Protocol 5.3.1)


@pytest.mark.parametrize("name", ["new", "deep/er/new", "box/", "gone"])
def test_a_patch_that_only_inserts_makes_what_is_not_there(name: str, place: Place) -> None:
    place.put("gone", "<> <http://ex.org/p> 1 .")
    assert place.send("DELETE", "gone").status_code == 204
    answer = update(place, 'INSERT DATA { <> <http://ex.org/p> "new" }', name)
    assert (answer.status_code, answer.headers["location"]) == (201, place.at(name)), answer.text
    assert place.objects(name, P) == {Literal("new")}
    assert update(place, 'INSERT { <> <http://ex.org/q> ?o } WHERE { <> ?p ?o FILTER(?o = "new") }', name).is_success
    assert place.objects(name, Q) == {Literal("new")}


def test_an_n3_patch_that_only_inserts_makes_what_is_not_there(place: Place) -> None:
    answer = n3(place, 'solid:inserts { <> ex:p "new" . }', "new")
    assert answer.status_code == 201, answer.text
    assert place.objects("new", P) == {Literal("new")}
    answer = n3(place, 'solid:inserts { <> ex:p "new" . } ; solid:deletes { <> ex:p "old" . }', "other")
    assert answer.status_code == 409
    answer = n3(place, "solid:where { <> ex:q ?q . } ; solid:inserts { <> ex:p ?q . }", "other")
    assert answer.status_code == 409
    assert place.get("other").status_code == 404


def test_a_patch_that_deletes_or_merges_makes_nothing(place: Place) -> None:
    for text in (
        'DELETE { <> ?p "old" } INSERT { <> <http://ex.org/p> "new" } WHERE { <> ?p "old" }',
        'INSERT DATA { <> <http://ex.org/p> "new" } ; DELETE DATA { <> <http://ex.org/p> "old" }',
        "DELETE WHERE { <> <http://ex.org/p> ?o }",
    ):
        assert update(place, text, "other").status_code == 404
    assert merge(place, '{"a": 1}', "other.json").status_code == 404
    assert update(place, "INSERT DATA { nonsense", "other").status_code == 400
    assert update(place, "INSERT DATA { <> <http://ex.org/p> 1 }", "other", If_Match="*").status_code == 412
    assert [place.get(name).status_code for name in ("other", "other.json")] == [404, 404]


def test_of_patches_that_make_the_same_each_is_applied(place: Place) -> None:
    with ThreadPoolExecutor(8) as threads:
        answers = list(
            threads.map(lambda each: update(place, f"INSERT DATA {{ <> <http://ex.org/p> {each} }}", "new"), range(8))
        )
    assert sorted(answer.status_code for answer in answers) == [201] + [204] * 7
    assert len(place.objects("new", P)) == 8


def test_a_patch_makes_a_graph_by_its_name_too(place: Place, served: Served) -> None:
    text = "INSERT DATA { <> <http://ex.org/p> 1 }"
    answer = served.at("graphs").send("PATCH", f"?graph={place.at('new')}", text, "application/sparql-update")
    assert (answer.status_code, place.get("new").status_code) == (201, 200)
