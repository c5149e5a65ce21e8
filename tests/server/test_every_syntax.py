"""What the server says of itself can be had in every RDF syntax, and read without fetching anything."""

from __future__ import annotations

import httpx
import pytest
from pyoxigraph import BlankNode, RdfFormat, Triple, parse

from rosld.ontology.serialize import Syntax

SYNTAXES = {syntax.extension: syntax.media_type for syntax in Syntax}
OWN = [
    "shapes/mapping", "shapes/query", "shapes/std_msgs/msg/String", "queries/", "queries/fastest-topics", "ontology",
    "graphs", "sparql", "", "status", "stop",
]  # fmt: skip
COMPACT = [".well-known/solid", "channels/WebSocketChannel2023", "channels/StreamingHTTPChannel2023"]
"""What has JSON-LD of its own, for clients without RDF, which says less."""


def triples(http: httpx.Client, path: str, format: str) -> set[Triple]:
    """The triples of a representation without blank nodes."""
    answer = http.get(path, params={"format": format})
    assert answer.status_code == 200, (path, format, answer.text[:300])
    media_type = answer.headers["content-type"].partition(";")[0]
    assert media_type == SYNTAXES[format]
    syntax = RdfFormat.from_media_type(media_type)
    assert syntax is not None
    found = {quad.triple for quad in parse(answer.content, format=syntax, base_iri=str(answer.url))}
    return {each for each in found if not any(isinstance(term, BlankNode) for term in (each.subject, each.object))}


@pytest.mark.parametrize("path", [*OWN, *COMPACT])
def test_every_syntax_says_the_same(http: httpx.Client, path: str) -> None:
    turtle = triples(http, path, "ttl")
    assert turtle
    for format in SYNTAXES.keys() - ({"jsonld"} if path in COMPACT else set()):
        assert {each.predicate for each in triples(http, path, format)} == {each.predicate for each in turtle}, format


def test_the_whole_dataset_is_there_in_rdf_xml(http: httpx.Client) -> None:
    answer = http.get("graphs?default", headers={"Accept": "application/rdf+xml"})
    assert answer.status_code == 200, answer.text[:300]
    assert sum(1 for _ in parse(answer.content, RdfFormat.RDF_XML)) > 1000


def test_what_a_client_says_with_other_letters_than_ascii_is_there_in_rdf_xml(http: httpx.Client) -> None:
    turtle = "<> <http://h/vokabular#größe> 5 ; <http://h/vokabular#名前> 'x' ; <http://h/vokabular#é> 'y' ."
    assert http.put("data/letters", content=turtle, headers={"Content-Type": "text/turtle"}).status_code == 201
    answer = http.get("data/letters", headers={"Accept": "application/rdf+xml"})
    assert answer.status_code == 200, answer.text
    said = {quad.predicate.value.partition("#")[2] for quad in parse(answer.content, RdfFormat.RDF_XML)}
    assert {"größe", "名前", "é"} <= said
    assert http.delete("data/letters").status_code == 204


@pytest.mark.parametrize("path", COMPACT)
def test_compact_json_ld_of_notifications_needs_no_context_of_another_host(http: httpx.Client, path: str) -> None:
    answer = http.get(path, headers={"Accept": "application/ld+json"})
    assert answer.headers["content-type"] == "application/ld+json"
    assert "id" in answer.json(), "clients without RDF read it by its names"
    found = {quad.triple for quad in parse(answer.content, RdfFormat.JSON_LD, base_iri=str(answer.url))}
    assert len(found) >= 6
    assert found <= triples(http, path, "nt")


@pytest.mark.parametrize("path", [*OWN, *COMPACT, "openapi.json", "style.css", ".well-known/wot", "topics/", "data/"])
@pytest.mark.parametrize("method", ["GET", "HEAD", "OPTIONS"])
def test_no_header_is_empty(http: httpx.Client, path: str, method: str) -> None:
    answer = http.request(method, path)
    assert answer.status_code < 300, answer.text
    assert [name for name, value in answer.headers.multi_items() if not value] == []
