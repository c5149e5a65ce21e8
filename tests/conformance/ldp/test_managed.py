"""Server-managed properties in bodies of clients: stored, ignored if they are true, or rejected (LDP 4.2.4.3)."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import httpx
import pytest
from pyoxigraph import Literal, NamedNode

from rosld.ontology.vocab import dcterms, ldp, rdf, ros, xsd

if TYPE_CHECKING:
    from tests.conformance.ldp.conftest import Place, Served

TURTLE = "text/turtle"
P = NamedNode("http://ex.org/p")
DCTERMS = "http://purl.org/dc/terms/"
YEAR = Literal("2020-01-01", datatype=NamedNode("http://www.w3.org/2001/XMLSchema#date"))
OTHER = Literal("2021-01-01T00:00:00Z", datatype=xsd.dateTime)
TIMES = (dcterms.created, dcterms.modified)
Write = Callable[[str, str], httpx.Response]


def put(place: Place, served: Served) -> Write:
    return lambda name, triple: place.send("PUT", name, triple + " .", TURTLE)


def patch(place: Place, served: Served) -> Write:
    return lambda name, triple: place.send("PATCH", name, f"INSERT DATA {{ {triple} }}", "application/sparql-update")


def patch_n3(place: Place, served: Served) -> Write:
    head = "@prefix solid: <http://www.w3.org/ns/solid/terms#> . _:x a solid:InsertDeletePatch ; solid:inserts"
    return lambda name, triple: place.send("PATCH", name, f"{head} {{ {triple} . }} .", "text/n3")


def merge(place: Place, served: Served) -> Write:
    return lambda name, triple: place.send("POST", name, triple + " .", TURTLE)


def put_graph(place: Place, served: Served) -> Write:
    return lambda name, triple: served.at("graphs").send("PUT", f"?graph={place.at(name)}", triple + " .", TURTLE)


def insert(place: Place, served: Served) -> Write:
    def send(name: str, triple: str) -> httpx.Response:
        said = triple.replace("<>", f"<{place.at(name)}>")
        text = f"INSERT DATA {{ GRAPH <{place.at(name)}> {{ {said} }} }}"
        return served.at("sparql").send("POST", "", text, "application/sparql-update")

    return send


WAYS = (put, patch, patch_n3, merge, put_graph, insert)


@pytest.mark.parametrize(
    ("way", "name"), [(put, "new"), (put, "new/"), (patch, "new"), (put_graph, "new"), (insert, "new")]
)
def test_managed_the_first_writer_says_when_it_was_created_and_modified(
    way: Callable[..., Write], name: str, place: Place, served: Served
) -> None:
    answer = way(place, served)(name, f"<> <{DCTERMS}created> {YEAR} ; <{DCTERMS}modified> {OTHER} ; {P} 1")
    assert answer.is_success, answer.text
    assert place.objects(name, dcterms.created) == {YEAR}
    assert place.objects(name, dcterms.modified) == {OTHER}
    if name.endswith("/"):
        place.post(to=name)
    else:
        place.put(name, "<> <http://ex.org/p> 2 .")
    assert place.objects(name, dcterms.created) == {YEAR}
    (modified,) = place.objects(name, dcterms.modified)
    assert modified != OTHER
    assert _in_queries(place, served, name, dcterms.created) == [YEAR.value]
    (found,) = _in_queries(place, served, name, dcterms.modified)
    assert found != OTHER.value


@pytest.mark.parametrize("way", WAYS)
def test_managed_another_time_is_refused_from_then_on(way: Callable[..., Write], place: Place, served: Served) -> None:
    place.put("there/", "")
    place.put("said", f"<> <http://ex.org/p> 1 ; <{DCTERMS}created> {YEAR} .")
    for name in ("said", "there/") if way is not merge else ("said",):  # a POST to a container creates a member
        before = place.graph(name)
        for predicate in TIMES:
            answer = way(place, served)(name, f"<> {predicate} {OTHER}")
            assert answer.status_code == 409, answer.text
            assert predicate.value in answer.json()["detail"]
            assert place.graph(name) == before


def test_managed_a_representation_can_be_put_back(place: Place, kinds: dict[str, str]) -> None:
    place.put("said", f"<> <{DCTERMS}created> {YEAR} ; <{DCTERMS}modified> {OTHER} .")
    for name in ("rdf", "basic/", "direct/", "indirect/", "file.txt.meta", "said"):
        for accept in ("text/turtle", "application/ld+json", "application/n-quads"):
            seen = place.get(name, Accept=accept)
            answer = place.send("PUT", name, seen.content, accept, If_Match=seen.headers["etag"])
            assert answer.status_code == 204, answer.text


def test_managed_an_earlier_state_is_put_back_also_with_times_rounded_to_milliseconds(place: Place) -> None:
    """The modification time is then one that the resource had."""
    place.put("a", "<> <http://ex.org/p> 1 .")
    seen = place.get("a", Accept=TURTLE)
    place.put("a", "<> <http://ex.org/p> 2 .")
    assert place.send("PUT", "a", seen.content, TURTLE).status_code == 204
    assert place.objects("a", P) == {Literal("1", datatype=xsd.integer)}
    for predicate in TIMES:
        (value,) = place.objects("a", predicate)
        assert isinstance(value, Literal)
        rounded = value.value[:23].rstrip("Z") + "Z"
        place.put("a", f'<> {predicate} "{rounded}"^^{xsd.dateTime} .')


def test_managed_a_time_is_one_literal(place: Place) -> None:
    for said in (f"created> {YEAR}, {OTHER}", "modified> <http://ex.org/now>", "created> []"):
        answer = place.send("PUT", "a", f"<> <{DCTERMS}{said} .", TURTLE)
        assert answer.status_code == 409
        assert DCTERMS in answer.json()["detail"]


def test_managed_another_interaction_model_is_refused(place: Place, kinds: dict[str, str]) -> None:
    for name in ("rdf", "basic/", "file.txt.meta", "new", "new/"):
        url = place.at(name.removesuffix(".meta"))
        for kind in ("DirectContainer", "IndirectContainer"):
            answer = place.send("PUT", name, f"<{url}> a <{ldp.iri}{kind}> .", TURTLE)
            assert answer.status_code == 409, (name, kind)
            assert rdf.type.value in answer.json()["detail"]


def test_managed_other_statements_about_files_and_membership_are_refused(place: Place, kinds: dict[str, str]) -> None:
    file, direct = kinds["NonRDFSource"], kinds["DirectContainer"]
    wrong = [(f"{file}.meta", file, dcterms.format, '"image/png"'), (f"{file}.meta", file, ros.byteLength, "12345")]
    for predicate in (ldp.membershipResource, ldp.hasMemberRelation, ldp.isMemberOfRelation):
        wrong.append((direct, direct, predicate, "<http://ex.org/other>"))
    for name, subject, predicate, value in wrong:
        answer = place.send("PUT", name, f"<{subject}> {predicate} {value} .", TURTLE)
        assert answer.status_code == 409
        assert predicate.value in answer.json()["detail"]
    place.put(f"{file}.meta", f'<{file}> {ros.byteLength} 10 ; <{DCTERMS}format> "text/plain" .')


def test_managed_other_resources_keep_these_properties(place: Place) -> None:
    """A catalogue states formats, and a document about containers states their membership."""
    said = {
        rdf.type: NamedNode(f"{ldp.iri}PageSortCriterion"),
        dcterms.format: Literal("text/csv"),
        ros.byteLength: Literal("7", datatype=xsd.integer),
        ldp.hasMemberRelation: NamedNode("http://ex.org/has"),
        ldp.membershipResource: NamedNode("http://ex.org/it"),
        ldp.insertedContentRelation: NamedNode("http://ex.org/topic"),
    }
    text = "<> " + " ; ".join(f"{predicate} {value}" for predicate, value in said.items()) + " ."
    for name in ("a", "box/"):
        for _ in range(2):
            place.put(name, text)
            graph = {(each.predicate, each.object) for each in place.graph(name)}
            assert set(said.items()) <= graph


def test_managed_the_member_subject_of_a_direct_container_may_be_stated(place: Place) -> None:
    said = f"<> {ldp.insertedContentRelation} {ldp.MemberSubject} ."
    place.put("direct/", said, model="DirectContainer")
    assert place.objects("direct/", ldp.insertedContentRelation) == {ldp.MemberSubject.value}
    place.put("direct/", said)
    place.put("direct/", "<> <http://ex.org/p> 1 .")
    made = place.post(to="direct/")
    assert place.objects("direct/", ldp.member) == {made}


def _in_queries(place: Place, served: Served, name: str, predicate: NamedNode) -> list[str]:
    """Return the result of a query."""
    query = f"SELECT ?o {{ GRAPH <{place.at(name)}> {{ <{place.at(name)}> {predicate} ?o }} }}"
    answer = served.http.get(
        f"{served.url}sparql", params={"query": query}, headers={"Accept": "application/sparql-results+json"}
    )
    return [row["o"]["value"] for row in answer.json()["results"]["bindings"]]
