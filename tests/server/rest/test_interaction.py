"""Interaction models and membership (LDP 4.2.1.4, 4.4, 5.2.3.4, 5.4.1, 5.5.1)."""

from __future__ import annotations

import pytest
from pyoxigraph import Triple

from rosld.ontology.body import parse_body
from rosld.ontology.vocab import ldp, rdf
from rosld.server.http.link import Link, parse
from rosld.server.http.problem import Problem
from rosld.server.rest.interaction import (
    parse_membership,
    requested_model,
)
from rosld.server.storage import Membership, Model

ROOT = "http://host/data/"
LEAF, BOX = f"{ROOT}leaf", f"{ROOT}box/"
EX = "http://example.org/"
TURTLE, IMAGE = "text/turtle", "image/png"


def types(*names: str) -> list[Link]:
    return [Link(f"{ldp.iri}{name}", "type") for name in names]


def put(url: str, media_type: str | None, *names: str) -> Model:
    return requested_model(types(*names), url, media_type, container_hint=url.endswith("/"))


def post(media_type: str | None, *names: str) -> Model:
    return requested_model(types(*names), ROOT, media_type, container_hint=False)


def test_the_media_type_and_the_slash_decide_the_model_unless_the_links_say_more() -> None:
    for media_type in (TURTLE, "application/ld+json", "application/n-triples", "application/rdf+xml"):
        assert put(LEAF, media_type) is post(media_type) is put(LEAF, media_type, "Resource") is Model.RDF_SOURCE
    for media_type in (IMAGE, "application/json", "text/html", "application/octet-stream"):
        assert put(LEAF, media_type) is post(media_type) is Model.NON_RDF_SOURCE
        assert put(LEAF, media_type, "Resource", "NonRDFSource") is Model.NON_RDF_SOURCE
    assert put(LEAF, TURTLE, "NonRDFSource") is post(TURTLE, "NonRDFSource") is Model.NON_RDF_SOURCE
    assert put(BOX, TURTLE) is put(BOX, None) is post(TURTLE, "Container") is Model.BASIC_CONTAINER


def test_only_types_of_ldp_in_links_of_the_resource_itself_count() -> None:
    links = parse(
        f'<{EX}Robot>; rel="type", <{ldp.iri}BasicContainer>; rel="up", '
        f'<{ldp.iri}BasicContainer>; rel="type"; anchor="{EX}other"'
    )
    assert requested_model(links, LEAF, TURTLE, container_hint=False) is Model.RDF_SOURCE
    links = parse(f'<{ldp.iri}DirectContainer>; rel="describes TYPE"; anchor="{ROOT}"')
    assert requested_model(links, ROOT, TURTLE, container_hint=False) is Model.DIRECT_CONTAINER


def test_an_unknown_model_is_refused_by_name() -> None:
    for name in ("Page", "BasicCOntainer", "", "Sequence"):
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
