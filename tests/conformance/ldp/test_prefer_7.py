"""LDP 6 and 7: optional extensions, Accept-Post, and preferences."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from pyoxigraph import NamedNode

from rosld.ontology.vocab import ldp

if TYPE_CHECKING:
    from tests.conformance.ldp.conftest import Place

HAS, P = NamedNode("http://ex.org/has"), NamedNode("http://ex.org/p")
MEMBERSHIP, CONTAINMENT = f"{ldp.iri}PreferMembership", f"{ldp.iri}PreferContainment"
MINIMAL, EMPTY = f"{ldp.iri}PreferMinimalContainer", f"{ldp.iri}PreferEmptyContainer"


@pytest.fixture
def house(place: Place) -> Place:
    """A Direct container with a member and a statement of its own."""
    said = f"<> {P} 1 ; <{ldp.iri}membershipResource> <#all> ; <{ldp.iri}hasMemberRelation> {HAS} ."
    place.put("house/", said, model="DirectContainer")
    place.post(to="house/")
    return type(place)(place.at("house/"), place.http)


def told(house: Place, prefer: str) -> set[str]:
    """Return which of its three parts are in a response."""
    parts = {ldp.contains: "containment", HAS: "membership", P: "minimal"}
    return {parts[each.predicate] for each in house.graph(Prefer=prefer) if each.predicate in parts}


def test_6_1_1_a_resource_may_be_a_member_of_several_containers(place: Place) -> None:
    for name in ("one/", "other/"):
        said = f"<> <{ldp.iri}insertedContentRelation> <http://ex.org/topic> ."
        place.put(name, said, model="IndirectContainer")
        place.post("<> <http://ex.org/topic> <http://ex.org/bob#me> .", to=name)
        assert place.objects(name, ldp.member) == {"http://ex.org/bob#me"}


def test_6_1_2_urls_are_used_again_by_who_names_them_alone(place: Place, kinds: dict[str, str]) -> None:
    for url in kinds.values():
        assert place.send("DELETE", url).status_code == 204
        assert place.get(url).status_code == 410
        slug = url.rstrip("/").rpartition("/")[2]
        assert place.post(Slug=slug).rstrip("/") != url.rstrip("/")
        assert place.send("PUT", url, "", "text/turtle").status_code == 201
        assert place.send("DELETE", url).status_code == 204
        assert place.post(Slug=slug).rstrip("/") != url.rstrip("/")


def test_6_2_1_other_representations_are_there_too(containers: list[Place]) -> None:
    for container in containers:
        for media_type in ("application/n-triples", "application/rdf+xml", "text/n3", "application/trig", "text/html"):
            answer = container.get(Accept=media_type)
            assert answer.status_code == 200, container.url
            assert answer.headers["content-type"].startswith(media_type), container.url


def test_7_1_2_accept_post_is_there_wherever_post_is(containers: list[Place]) -> None:
    for container in containers:
        for method in ("GET", "HEAD", "OPTIONS"):
            headers = container.send(method).headers
            assert ("accept-post" in headers) == ("POST" in headers["allow"]), container.url
            listed = headers.get("accept-post", "*/*").split(",")
            assert all(len(each.strip().split("/")) == 2 for each in listed), container.url


@pytest.mark.parametrize(
    ("hints", "parts"),
    [
        (f'include="{MINIMAL}"', {"minimal"}),
        (f'include="{EMPTY}"', {"minimal"}),
        (f'include="{CONTAINMENT}"', {"containment", "minimal"}),
        (f'include="{MEMBERSHIP}"', {"membership", "minimal"}),
        (f'include="{MEMBERSHIP} {CONTAINMENT}"', {"containment", "membership", "minimal"}),
        (f'include="{CONTAINMENT}"; omit="{CONTAINMENT}"', {"containment", "membership", "minimal"}),
        ('include="http://ex.org/PreferBlue"', {"containment", "membership", "minimal"}),
    ],
)
def test_7_2_2_1_include_says_what_is_wanted(hints: str, parts: set[str], house: Place) -> None:
    assert told(house, f"return=representation; {hints}") == parts


@pytest.mark.parametrize(
    ("omit", "parts"),
    [
        (MINIMAL, {"containment", "membership"}),
        (CONTAINMENT, {"membership", "minimal"}),
        (MEMBERSHIP, {"containment", "minimal"}),
        (f"{MEMBERSHIP} {CONTAINMENT}", {"minimal"}),
    ],
)
def test_7_2_2_2_omit_says_what_is_not(omit: str, parts: set[str], house: Place) -> None:
    assert told(house, f'return=representation; omit="{omit}"') == parts


def test_7_2_2_the_answer_says_which_preference_was_applied(house: Place) -> None:
    """Different representations have different ETags."""
    whole = house.get()
    assert "preference-applied" not in whole.headers
    for hint in (MINIMAL, MEMBERSHIP):
        answer = house.get(Prefer=f'return=representation; include="{hint}"')
        assert answer.headers["preference-applied"] == "return=representation"
        assert answer.headers["etag"] != whole.headers["etag"]
        assert "prefer" in answer.headers["vary"].lower()
        again = house.get(Prefer=f'return=representation; include="{hint}"', If_None_Match=answer.headers["etag"])
        assert again.status_code == 304


def test_7_2_2_a_part_guards_a_write_as_the_whole_does(house: Place) -> None:
    part = house.get(Prefer=f'return=representation; include="{MINIMAL}"')
    house.put("", part.text, If_Match=part.headers["etag"])
    assert told(house, "") == {"containment", "membership", "minimal"}


def test_7_2_2_the_robots_containers_say_so_where_they_leave_anything_out(robots: list[Place]) -> None:
    for robot in robots:
        prefer = f'return=representation; omit="{CONTAINMENT}"'
        answer = robot.get(Prefer=prefer)
        assert answer.status_code == 200, robot.url
        assert robot.contained() == robot.contained(Prefer=prefer) or "preference-applied" in answer.headers
