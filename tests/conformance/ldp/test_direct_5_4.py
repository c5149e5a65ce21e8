"""LDP 5.4: Direct containers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from pyoxigraph import NamedNode, Triple

from rosld.ontology.vocab import ldp, rdf
from tests.conformance.ldp.conftest import models

if TYPE_CHECKING:
    from tests.conformance.ldp.conftest import Place

PART, OF = NamedNode("http://ex.org/hasPart"), NamedNode("http://ex.org/partOf")
FORWARD = f"<> <{ldp.iri}membershipResource> <#house> ; <{ldp.iri}hasMemberRelation> {PART} ."
BACKWARD = f"<> <{ldp.iri}membershipResource> <#house> ; <{ldp.iri}isMemberOfRelation> {OF} ."


def made(place: Place, said: str, name: str = "rooms/") -> str:
    place.put(name, said, model="DirectContainer")
    return place.at(name)


def test_5_4_1_1_a_direct_container_is_a_container(place: Place) -> None:
    rooms = made(place, FORWARD)
    assert models(place.get(rooms)) == {"Resource", "RDFSource", "DirectContainer"}
    assert {ldp.Container.value, ldp.DirectContainer.value} <= place.objects(rooms, rdf.type)
    kitchen = place.post(to=rooms)
    assert place.contained(rooms) == {kitchen}


def test_5_4_1_3_there_is_one_membership_resource_and_relation(place: Place) -> None:
    for number, (said, relation, value) in enumerate(
        (
            (FORWARD, ldp.hasMemberRelation, PART.value),
            (BACKWARD, ldp.isMemberOfRelation, OF.value),
            ("", ldp.hasMemberRelation, ldp.member.value),
        )
    ):
        rooms = made(place, said, f"rooms{number}/")
        assert place.objects(rooms, ldp.membershipResource) == {f"{rooms}#house" if said else rooms}
        found = {each: place.objects(rooms, each) for each in (ldp.hasMemberRelation, ldp.isMemberOfRelation)}
        assert found.pop(relation) == {value}
        assert list(found.values()) == [set()]


def test_5_4_1_4_two_relations_are_refused(place: Place) -> None:
    both = f"<> <{ldp.iri}hasMemberRelation> {PART} ; <{ldp.iri}isMemberOfRelation> {OF} ."
    two = f"<> <{ldp.iri}hasMemberRelation> {PART} , {OF} ."
    constants = f"<> <{ldp.iri}membershipResource> <#a> , <#b> ."
    for said in (both, two, constants):
        assert place.send("PUT", "rooms/", said, "text/turtle", model="DirectContainer").status_code == 409
        assert place.get("rooms/").status_code == 404


def test_5_4_1_5_the_member_is_what_was_put_into_it(place: Place) -> None:
    """An ldp:insertedContentRelation of ldp:MemberSubject states the default; any other is rejected."""
    rooms = made(place, f"{FORWARD} <> <{ldp.iri}insertedContentRelation> <{ldp.iri}MemberSubject> .")
    kitchen = place.post(f"<> {PART} <#cupboard> .", to=rooms)
    assert Triple(NamedNode(f"{rooms}#house"), PART, NamedNode(kitchen)) in place.graph(rooms)
    other = f"{FORWARD} <> <{ldp.iri}insertedContentRelation> {PART} ."
    assert place.send("PUT", "more/", other, "text/turtle", model="DirectContainer").status_code == 409


@pytest.mark.parametrize("said", [FORWARD, BACKWARD, ""])
def test_5_4_2_1_each_new_member_is_one_by_membership_too(said: str, place: Place) -> None:
    """Until it is deleted; the document that was read may be put back."""
    rooms = made(place, said)
    kitchen = place.post(to=rooms)
    members = {kitchen, place.send("POST", rooms, b"x", "image/png").headers["location"], f"{rooms}attic"}
    place.put(f"{rooms}attic", "")
    assert _members(place, rooms) == members == place.contained(rooms)
    place.put(rooms, place.get(rooms, Accept="text/turtle").text)
    assert _members(place, rooms) == members
    assert place.send("DELETE", kitchen).status_code == 204
    assert _members(place, rooms) == members - {kitchen}


def test_5_4_1_4_what_membership_is_made_of_stays_as_it_was_said(place: Place) -> None:
    rooms = made(place, FORWARD)
    kitchen = place.post(to=rooms)
    assert place.send("PUT", rooms, BACKWARD, "text/turtle").status_code == 409
    other = f"DELETE DATA {{ <> <{ldp.iri}hasMemberRelation> {PART} }}"
    place.send("PATCH", rooms, other, "application/sparql-update")
    assert place.objects(rooms, ldp.hasMemberRelation) == {PART.value}
    assert _members(place, rooms) == {kitchen}


def _members(place: Place, url: str) -> set[str]:
    """Return the members according to the membership triples of a container."""
    said = place.graph(url)
    forward, backward = place.objects(url, ldp.hasMemberRelation), place.objects(url, ldp.isMemberOfRelation)
    (constant,) = place.objects(url, ldp.membershipResource)
    found = set()
    for each in said:
        assert isinstance(each.subject, NamedNode)
        if {each.predicate.value} == forward and each.subject.value == constant:
            found.add(each.object.value)
        if {each.predicate.value} == backward and each.object == NamedNode(str(constant)):
            found.add(each.subject.value)
    return found
