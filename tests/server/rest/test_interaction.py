"""Interaction models and membership (LDP 4.2.1.4, 4.4, 5.2.3.4, 5.4.1, 5.5.1)."""

from __future__ import annotations

import pytest
from pyoxigraph import Triple

from rosld.ontology.body import parse_body
from rosld.ontology.vocab import ldp, rdf
from rosld.server.http.fields import Link
from rosld.server.http.problem import Problem
from rosld.server.rest.interaction import parse_membership, requested_model
from rosld.server.storage.record import Membership, Model

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


def test_models_that_exclude_each_other_are_refused() -> None:
    for names in (
        ("NonRDFSource", "RDFSource"),
        ("NonRDFSource", "BasicContainer"),
        ("NonRDFSource", "Container"),
        ("BasicContainer", "DirectContainer"),
        ("DirectContainer", "IndirectContainer"),
    ):
        with pytest.raises(Problem, match=r"mutually exclusive|has one type") as refused:
            post(TURTLE, *names)
        assert refused.value.status == 400


def test_a_model_that_does_not_fit_the_url_or_the_body_is_refused() -> None:
    for url, media_type, names, words in (
        (LEAF, TURTLE, ("BasicContainer",), r"send the request to http://host/data/leaf/"),
        (BOX, TURTLE, ("RDFSource",), "omit the trailing slash"),
        (BOX, TURTLE, ("Resource",), "omit the trailing slash"),
        (BOX, IMAGE, ("NonRDFSource",), "omit the trailing slash"),
        (BOX, IMAGE, (), "not image/png"),
        (BOX, IMAGE, ("DirectContainer",), "not image/png"),
        (LEAF, IMAGE, ("RDFSource",), "a body of type image/png"),
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
        ("<> ldp:membershipResource <#a>, <#b> .", "has one value"),
        ("<> ldp:hasMemberRelation ex:a, ex:b .", "has one value"),
        ("<> ldp:hasMemberRelation ex:a ; ldp:isMemberOfRelation ex:b .", "not both"),
        ("<> ldp:membershipResource 'a' .", "must be an IRI"),
        ("<> ldp:hasMemberRelation [] .", "must be an IRI"),
        ("<> ldp:hasMemberRelation ldp:contains .", "choose another property"),
        ("<> ldp:isMemberOfRelation a .", "choose another property"),
        ("<> ldp:insertedContentRelation ex:topic .", "Direct Container"),
    ):
        with pytest.raises(Problem, match=words) as refused:
            direct(turtle.replace(" a .", f" <{rdf.type.value}> ."))
        assert refused.value.status == 409
