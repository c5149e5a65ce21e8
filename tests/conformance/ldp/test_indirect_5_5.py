"""LDP 5.5: Indirect containers."""

from __future__ import annotations

from typing import TYPE_CHECKING
from urllib.parse import quote

import pytest
from pyoxigraph import NamedNode, Triple

from rosld.ontology.vocab import ldp, rdf

if TYPE_CHECKING:
    from tests.conformance.ldp.conftest import Place, Served

TOPIC, HAS = NamedNode("http://ex.org/topic"), NamedNode("http://ex.org/has")
SAID = (
    f"<> <{ldp.iri}membershipResource> <#all> ; <{ldp.iri}hasMemberRelation> {HAS} ;"
    f" <{ldp.iri}insertedContentRelation> {TOPIC} ."
)


@pytest.fixture
def topics(place: Place) -> str:
    """The URL of an Indirect container."""
    place.put("topics/", SAID, model="IndirectContainer")
    return place.at("topics/")


def test_5_5_1_1_an_indirect_container_is_a_container(topics: str, place: Place) -> None:
    assert {ldp.Container.value, ldp.IndirectContainer.value} <= place.objects(topics, rdf.type)
    assert place.objects(topics, ldp.membershipResource) == {f"{topics}#all"}
    assert place.objects(topics, ldp.hasMemberRelation) == {HAS.value}


def test_5_5_1_2_there_is_one_inserted_content_relation(topics: str, place: Place) -> None:
    assert place.objects(topics, ldp.insertedContentRelation) == {TOPIC.value}
    two = f"<> <{ldp.iri}insertedContentRelation> {TOPIC} , {HAS} ."
    for said in ("", two):
        answer = place.send("PUT", "more/", said, "text/turtle", model="IndirectContainer")
        assert answer.status_code == 409
        assert "insertedContentRelation" in answer.text


def test_5_5_1_2_what_names_two_members_or_none_that_can_be_is_refused(topics: str, place: Place) -> None:
    two = f"<> {TOPIC} <#a> , <#b> ."
    for said in (two, f'<> {TOPIC} "a word" .'):
        assert place.send("POST", topics, said, "text/turtle").status_code == 409
    assert place.contained(topics) == set()


def test_5_5_1_2_what_says_no_member_is_contained_and_no_member_until_it_does(topics: str, place: Place) -> None:
    made = [place.post("<> <http://ex.org/p> 1 .", to=topics) for _ in range(3)]
    assert place.contained(topics) == set(made)
    assert not _membership(topics, place)
    place.put(made[0], f"<> {TOPIC} <#it> .")
    update = f"INSERT DATA {{ <> {TOPIC} <http://ex.org/bob#me> }}"
    assert place.send("PATCH", made[1], update, "application/sparql-update").status_code == 204
    expected = {f"{made[0]}#it", "http://ex.org/bob#me"}
    assert {each.object.value for each in _membership(topics, place)} == expected
    two = f"<> {TOPIC} <#a> , <#b> ."
    assert place.send("PUT", made[2], two, "text/turtle").status_code == 409
    place.put(made[0], "<> <http://ex.org/p> 2 .")
    assert {each.object.value for each in _membership(topics, place)} == expected
    for url in made:
        assert place.send("DELETE", url).status_code == 204
    assert (place.contained(topics), _membership(topics, place)) == (set(), set())


def test_5_5_1_2_a_file_is_contained_and_no_member_until_its_description_says_so(topics: str, place: Place) -> None:
    answer = place.send("POST", topics, b"\x89PNG", "image/png", Slug="photo")
    assert answer.status_code == 201, answer.text
    photo = answer.headers["location"]
    assert place.contained(topics) == {photo}
    assert not _membership(topics, place)
    assert place.send("PUT", photo, b"\x89PNG2", "image/png").status_code == 204
    place.put(f"{photo}.meta", f"<{photo}> {TOPIC} <#it> .")
    assert [each.object.value for each in _membership(topics, place)] == [f"{photo}.meta#it"]


def test_5_5_1_2_queries_see_the_same(topics: str, place: Place, served: Served) -> None:
    made = place.post("<> <http://ex.org/p> 1 .", to=topics)
    query = f"SELECT ?m {{ GRAPH <{topics}> {{ ?s {HAS} ?m }} }}"

    def members() -> list[str]:
        return served.at("sparql").send("GET", f"?query={quote(query)}", Accept="text/csv").text.split()[1:]

    assert members() == []
    place.put(made, f"<> {TOPIC} <#it> .")
    assert members() == [f"{made}#it"]


def test_5_5_2_1_containment_is_of_the_document_itself(topics: str, place: Place) -> None:
    made = place.post(f"<> {TOPIC} <#it> .", to=topics)
    elsewhere = place.post(f"<> {TOPIC} <http://ex.org/bob#me> .", to=topics)
    assert place.contained(topics) == {made, elsewhere}
    subject = NamedNode(f"{topics}#all")
    members = {Triple(subject, HAS, NamedNode(each)) for each in (f"{made}#it", "http://ex.org/bob#me")}
    assert _membership(topics, place) == members
    for url in (made, elsewhere):
        assert place.send("DELETE", url).status_code == 204
    assert (place.contained(topics), _membership(topics, place)) == (set(), set())


def _membership(topics: str, place: Place) -> set[Triple]:
    return {each for each in place.graph(topics) if each.predicate == HAS}
