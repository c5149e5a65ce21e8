"""Interaction models and membership (LDP 4.2.1.4, 4.4, 5.2.3.4, 5.4.1, 5.5.1)."""

from __future__ import annotations

import pytest
from pyoxigraph import NamedNode, Quad, Triple

from rosld.ontology.body import index_quads, parse_body
from rosld.ontology.vocab import ldp, rdf
from rosld.server.http.link import Link, parse
from rosld.server.http.problem import Problem
from rosld.server.rest.interaction import (
    member_derived_uri,
    membership_declaration,
    membership_triples,
    model_links,
    parse_membership,
    requested_model,
)
from rosld.server.storage import NO_MEMBER, Membership, Model
from rosld.server.storage.models import rdf_types

ROOT = "http://host/data/"
LEAF, BOX = f"{ROOT}leaf", f"{ROOT}box/"
EX = "http://example.org/"
TURTLE, IMAGE = "text/turtle", "image/png"
CONTAINERS = (Model.BASIC_CONTAINER, Model.DIRECT_CONTAINER, Model.INDIRECT_CONTAINER)


def types(*names: str) -> list[Link]:
    return [Link(f"{ldp.iri}{name}", "type") for name in names]


def put(url: str, media_type: str | None, *names: str) -> Model:
    return requested_model(types(*names), url, media_type, container_hint=url.endswith("/"))


def post(media_type: str | None, *names: str) -> Model:
    return requested_model(types(*names), ROOT, media_type, container_hint=False)


# What is asked for (LDP 5.2.3.4)


def test_the_media_type_and_the_slash_decide_the_model_unless_the_links_say_more() -> None:
    for media_type in (TURTLE, "application/ld+json", "application/n-triples", "application/rdf+xml"):
        assert put(LEAF, media_type) is post(media_type) is put(LEAF, media_type, "Resource") is Model.RDF_SOURCE
    for media_type in (IMAGE, "application/json", "text/html", "application/octet-stream"):
        assert put(LEAF, media_type) is post(media_type) is Model.NON_RDF_SOURCE
        assert put(LEAF, media_type, "Resource", "NonRDFSource") is Model.NON_RDF_SOURCE
    assert put(LEAF, TURTLE, "NonRDFSource") is post(TURTLE, "NonRDFSource") is Model.NON_RDF_SOURCE
    assert put(BOX, TURTLE) is put(BOX, None) is post(TURTLE, "Container") is Model.BASIC_CONTAINER


def test_the_kind_of_container_that_the_link_says_is_made() -> None:
    for model in CONTAINERS:
        assert put(BOX, TURTLE, model.value) is post(TURTLE, model.value) is post(None, model.value) is model
        assert post(TURTLE, "Resource", "RDFSource", "Container", model.value) is model


def test_only_types_of_ldp_in_links_of_the_resource_itself_count() -> None:
    links = parse(
        f'<{EX}Robot>; rel="type", <{ldp.iri}BasicContainer>; rel="up", '
        f'<{ldp.iri}BasicContainer>; rel="type"; anchor="{EX}other"'
    )
    assert requested_model(links, LEAF, TURTLE, container_hint=False) is Model.RDF_SOURCE
    links = parse(f'<{ldp.iri}DirectContainer>; rel="describes TYPE"; anchor="{ROOT}"')
    assert requested_model(links, ROOT, TURTLE, container_hint=False) is Model.DIRECT_CONTAINER


def test_an_unknown_model_is_refused_by_name() -> None:
    for name in (
        "Page",
        "BasicCOntainer",
        "",
        "Sequence",
    ):
        with pytest.raises(Problem, match=f"ldp#{name}> is no interaction model") as refused:
            post(TURTLE, name)
        assert refused.value.status == 400


def test_models_that_exclude_each_other_are_refused() -> None:
    for names in (
        ("NonRDFSource", "RDFSource"),
        ("NonRDFSource", "BasicContainer"),
        ("NonRDFSource", "Container"),
        ("BasicContainer", "DirectContainer"),
        ("DirectContainer", "IndirectContainer"),
    ):
        with pytest.raises(Problem, match=r"exclude each other|of one kind") as refused:
            post(TURTLE, *names)
        assert refused.value.status == 400


def test_a_model_that_does_not_fit_the_url_or_the_body_is_refused() -> None:
    for url, media_type, names, words in (
        (LEAF, TURTLE, ("BasicContainer",), r"send it to http://host/data/leaf/"),
        (BOX, TURTLE, ("RDFSource",), "leave out the slash"),
        (BOX, TURTLE, ("Resource",), "leave out the slash"),
        (BOX, IMAGE, ("NonRDFSource",), "leave out the slash"),
        (BOX, IMAGE, (), "the body is image/png"),
        (BOX, IMAGE, ("DirectContainer",), "the body is image/png"),
        (LEAF, IMAGE, ("RDFSource",), "with a body of image/png"),
    ):
        with pytest.raises(Problem, match=words) as refused:
            put(url, media_type, *names)
        assert refused.value.status == 409


# What is told (LDP 4.2.1.4, 4.4.1.2, 5.2.1.4)


def test_links_and_rdf_say_the_types_of_a_model_which_can_be_requested_again() -> None:
    for model in Model:
        links = model_links(model)
        targets = [each.target for each in links]
        assert {each.rel for each in links} == {"type"}
        assert {f"{ldp.iri}Resource", f"{ldp.iri}{model.value}"} <= set(targets)
        assert len([each for each in targets if each.endswith("Container")]) == model.is_container
        url = BOX if model.is_container else LEAF
        assert requested_model(links, url, TURTLE, container_hint=model.is_container) is model
        assert set(targets) <= {kind.value for kind in rdf_types(model)}
        assert (ldp.Container in rdf_types(model)) is model.is_container


# What membership is made of (LDP 5.4.1, 5.5.1)


def said(turtle: str, url: str = BOX) -> list[Triple]:
    body = parse_body(f"@prefix ldp: <{ldp.iri}> . @prefix ex: <{EX}> . {turtle}".encode(), TURTLE, url)
    return [
        Triple(subject, predicate, each)
        for subject, properties in body.subjects.items()
        for predicate, objects in properties.items()
        for each in objects
    ]


def direct(turtle: str) -> Membership | None:
    return parse_membership(said(turtle), BOX, Model.DIRECT_CONTAINER)


def indirect(turtle: str) -> Membership | None:
    return parse_membership(said(turtle), BOX, Model.INDIRECT_CONTAINER)


def test_a_direct_container_says_its_membership_either_way_round_or_has_members_by_ldp_member() -> None:
    about = "<> ldp:membershipResource <#robot> ; "
    default = Membership(BOX, ldp.member.value)
    assert direct(f"{about} ldp:hasMemberRelation ex:part .") == Membership(f"{BOX}#robot", f"{EX}part")
    assert direct(f"{about} ldp:isMemberOfRelation ex:partOf .") == Membership(f"{BOX}#robot", f"{EX}partOf", True)
    assert direct("<> ldp:hasMemberRelation ex:part, ex:part .") == Membership(BOX, f"{EX}part")
    assert direct("<> ex:label 'a box' .") == direct("<other/> ldp:hasMemberRelation ex:part .") == default
    members_themselves = Membership(BOX, ldp.member.value, content=ldp.MemberSubject.value)
    assert direct("<> ldp:insertedContentRelation ldp:MemberSubject .") == members_themselves
    assert parse_membership(said("<> ldp:hasMemberRelation ex:part ."), BOX, Model.BASIC_CONTAINER) is None


def test_an_indirect_container_says_what_stands_for_its_members() -> None:
    found = indirect("<> ldp:hasMemberRelation ex:part ; ldp:insertedContentRelation ex:topic .")
    assert found == Membership(BOX, f"{EX}part", content=f"{EX}topic")
    assert indirect("<> ldp:insertedContentRelation ldp:MemberSubject .") == Membership(
        BOX, ldp.member.value, content=ldp.MemberSubject.value
    )


def test_a_direct_container_that_makes_no_sense_is_refused() -> None:
    for turtle, words in (
        ("<> ldp:membershipResource <#a>, <#b> .", "once, not as"),
        ("<> ldp:hasMemberRelation ex:a, ex:b .", "once, not as"),
        ("<> ldp:hasMemberRelation ex:a ; ldp:isMemberOfRelation ex:b .", "not both"),
        ("<> ldp:membershipResource 'a' .", "must be an IRI"),
        ("<> ldp:hasMemberRelation [] .", "must be an IRI"),
        ("<> ldp:hasMemberRelation ldp:contains .", "name another property"),
        ("<> ldp:isMemberOfRelation a .", "name another property"),
        ("<> ldp:insertedContentRelation ex:topic .", "Direct container"),
    ):
        with pytest.raises(Problem, match=words) as refused:
            direct(turtle.replace(" a .", f" <{rdf.type.value}> ."))
        assert refused.value.status == 409


def test_an_indirect_container_must_say_one_inserted_content_relation() -> None:
    for turtle, words in (
        ("<> ldp:hasMemberRelation ex:part .", "ldp:insertedContentRelation"),
        ("<> ldp:insertedContentRelation ex:a, ex:b .", "once, not as"),
        ("<> ldp:insertedContentRelation 'a' .", "must be an IRI"),
    ):
        with pytest.raises(Problem, match=words) as refused:
            indirect(turtle)
        assert refused.value.status == 409


def test_what_was_left_to_the_defaults_is_said_by_the_server() -> None:
    found = direct("")
    assert found is not None
    assert membership_declaration(found, BOX) == said(
        f"<> ldp:membershipResource <{BOX}> ; ldp:hasMemberRelation ldp:member ."
    )


def test_what_is_declared_reads_as_the_same_membership() -> None:
    for inverse in (
        False,
        True,
    ):
        found = Membership(f"{BOX}#it", f"{EX}part", inverse, f"{EX}topic")
        assert parse_membership(membership_declaration(found, BOX), BOX, Model.INDIRECT_CONTAINER) == found


# What stands for a member (LDP 5.4.1.5, 5.5.1.2)

TOPIC = Membership(BOX, f"{EX}part", content=f"{EX}topic")
NEW = f"{BOX}new"


def member(turtle: str, membership: Membership | None = TOPIC) -> str:
    triples = said(turtle, NEW)
    return member_derived_uri(membership, index_quads((Quad(*triple) for triple in triples), NEW), NEW)


def test_a_member_stands_for_itself() -> None:
    for membership in (
        None,
        Membership(BOX, f"{EX}part"),
        Membership(BOX, f"{EX}part", content=ldp.MemberSubject.value),
    ):
        assert member("<> ex:topic <#it> .", membership) == NEW


def test_what_the_body_says_by_the_inserted_content_relation_is_the_member_first_of_the_member_itself() -> None:
    assert member("<> ex:topic <#it> .") == f"{NEW}#it"
    assert member("<#other> ex:topic <#it> .") == f"{NEW}#it"
    assert member("<#other> ex:topic <#that> . <> ex:topic <#it>, <#it> .") == f"{NEW}#it"
    assert member("<> ex:label 'x' .") == NO_MEMBER


def test_a_body_that_does_not_say_which_is_the_member_is_refused() -> None:
    for turtle, words in (
        ("<> ex:topic <#a>, <#b> .", "2 triples"),
        ("<> ex:topic 'it' .", "must be an IRI"),
        ("<> ex:topic [] .", "must be an IRI"),
    ):
        with pytest.raises(Problem, match=words) as refused:
            member(turtle)
        assert refused.value.status == 409


def test_membership_triples_go_the_way_the_container_says() -> None:
    this, part, that = NamedNode(BOX), NamedNode(f"{EX}part"), NamedNode(NEW)
    assert membership_triples(Membership(BOX, part.value), [NEW]) == [Triple(this, part, that)]
    assert membership_triples(Membership(BOX, part.value, True), [NEW]) == [Triple(that, part, this)]
    assert membership_triples(Membership(BOX, part.value), []) == []
