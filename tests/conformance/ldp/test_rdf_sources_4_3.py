"""LDP 4.3: RDF sources."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest
from pyoxigraph import DefaultGraph, Literal, NamedNode, RdfFormat, Triple, parse

from rosld.ontology.vocab import dcterms, ldp, rdf, xsd
from tests.conformance.ldp.conftest import models, triples

if TYPE_CHECKING:
    from tests.conformance.ldp.conftest import Place

P = NamedNode("http://ex.org/p")


@pytest.mark.parametrize("media_type", ["application/n-quads", "application/trig"])
def test_4_3_1_1_a_representation_is_one_graph_the_default_one(media_type: str, containers: list[Place]) -> None:
    for container in containers:
        answer = container.get(Accept=media_type)
        quads = list(parse(answer.content, RdfFormat.from_media_type(media_type), base_iri=container.url))
        assert quads, container.url
        assert {quad.graph_name for quad in quads} == {DefaultGraph()}, container.url
        assert {quad.subject for quad in quads} & {NamedNode(container.url)}, container.url


@pytest.mark.parametrize("media_type", ["application/n-quads", "application/trig"])
def test_4_3_1_1_a_body_may_be_of_the_default_graph_or_of_its_own_name(media_type: str, place: Place) -> None:
    for number, name in enumerate(("", "urn:x-arq:DefaultGraphNode", place.at("a"))):
        triple = f'<{place.at("a")}> <http://ex.org/p> "{number}"'
        graph = name and f"<{name}>"
        body = f"{triple} {graph} ." if media_type == "application/n-quads" else f"{graph} {{ {triple} }}"
        assert place.send("PUT", "a", body, media_type).status_code in (201, 204)
        assert place.objects("a", P) == {Literal(str(number))}


def test_4_3_1_6_times_are_said_in_dublin_core(place: Place) -> None:
    """The server adds statements in RDF, LDP and Dublin Core only to those of a client."""
    place.put("a", "<> <http://ex.org/p> 1 .")
    (created,) = place.objects("a", dcterms.created)
    place.put("a", "<> <http://ex.org/p> 2 .")
    (modified,) = place.objects("a", dcterms.modified)
    assert place.objects("a", dcterms.created) == {created}
    assert isinstance(created, Literal)
    assert isinstance(modified, Literal)
    assert created.datatype == xsd.dateTime
    assert created.value < modified.value
    assert {each.predicate for each in place.graph("a")} == {P, rdf.type, dcterms.created, dcterms.modified}


def test_4_3_1_10_nothing_needs_inference(place: Place, kinds: dict[str, str], robots: list[Place]) -> None:
    """Every superclass is stated: a client that knows only ldp:Container or ldp:Resource sees one."""
    for model, url in (*kinds.items(), *(("BasicContainer", robot.url) for robot in robots)):
        if model != "NonRDFSource":
            said = place.objects(url, rdf.type)
            assert {ldp.Resource.value, ldp.RDFSource.value} <= said
            assert (ldp.Container.value in said) == model.endswith("Container")
            assert f"{ldp.iri}{model}" in said
            assert {"Resource", "RDFSource", model} <= models(place.get(url))


def test_4_3_1_11_everything_that_is_got_can_be_put_back(place: Place) -> None:
    """Spellings, datatypes, languages (in lower case) and triples about other things are preserved."""
    said = (
        '<> <http://ex.org/p> "01"^^<http://www.w3.org/2001/XMLSchema#integer> , 1.50 , 1e0 , "x"@en-GB , true , [] ;'
        ' a <http://ex.org/Thing> . <http://ex.org/other> <http://ex.org/p> ( 1 "two" ) .'
    )
    place.put("a", said)
    spelt = {str(each) for each in place.objects("a", P) if isinstance(each, Literal)}
    integer, decimal, double = (f"<{xsd.iri}{name}>" for name in ("integer", "decimal", "double"))
    assert spelt == {
        f'"01"^^{integer}',
        f'"1.50"^^{decimal}',
        f'"1e0"^^{double}',
        '"x"@en-gb',
        f'"true"^^<{xsd.iri}boolean>',
    }
    before = place.graph("a")
    place.put("a", place.get("a", Accept="text/turtle").text)
    assert len(place.graph("a")) == len(before)
    assert "http://ex.org/Thing" in place.objects("a", rdf.type)


def test_4_3_2_2_turtle_is_answered_where_it_or_nothing_is_asked_for(containers: list[Place]) -> None:
    for container in containers:
        for accept in (None, "*/*", "text/turtle, application/ld+json;q=0.5", "text/turtle;q=0.9, text/plain"):
            request = container.http.build_request("GET", container.url)
            del request.headers["accept"]
            if accept is not None:
                request.headers["accept"] = accept
            assert container.http.send(request).headers["content-type"].startswith("text/turtle"), container.url


def test_4_3_2_3_json_ld_says_the_same(containers: list[Place]) -> None:
    for container in containers:
        answer = container.get(Accept="application/ld+json")
        assert answer.headers["content-type"] == "application/ld+json", container.url
        assert isinstance(json.loads(answer.content), dict | list), container.url
        assert _grounded(triples(answer)) == _grounded(container.graph()), container.url


def test_4_3_2_3_json_ld_is_taken(place: Place) -> None:
    body = '{"@id": "", "http://ex.org/p": [{"@value": "1", "@type": "http://www.w3.org/2001/XMLSchema#integer"}]}'
    answer = place.send("PUT", "a", body, "application/ld+json")
    assert answer.status_code == 201
    assert {str(each) for each in place.objects("a", P)} == {f'"1"^^<{xsd.iri}integer>'}


def _grounded(graph: set[Triple]) -> set[Triple]:
    """Return triples without blank nodes, whose labels differ in every response."""
    return {each for each in graph if "_:" not in str(each)}
