"""Queries of resources, in plain JSON and in RDF."""

from __future__ import annotations

from typing import Any

import httpx
from pyoxigraph import NamedNode, RdfFormat, Triple, parse

TYPES = "https://w3id.org/rosld/types/"
ROS = "https://w3id.org/rosld#"
RDF = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
LDP = "http://www.w3.org/ns/ldp#"
XSD = "http://www.w3.org/2001/XMLSchema#"
EX = "http://example.org/"
PREFIXES = f"""
@prefix map: <https://w3id.org/rosld/mapping#> . @prefix sh: <http://www.w3.org/ns/shacl#> .
@prefix ex: <{EX}> . @prefix rdf: <{RDF}> . @prefix unit: <http://qudt.org/vocab/unit/> .
@prefix quantitykind: <http://qudt.org/vocab/quantitykind/> . @prefix qudt: <http://qudt.org/schema/qudt/> .
"""
SYNTAXES = (
    *("text/turtle", "application/ld+json", "application/n-triples", "application/rdf+xml"),
    *("text/n3", "application/n-quads", "application/trig"),
)
JSON = {"Accept": "application/json"}
TURTLE = {"Content-Type": "text/turtle"}
JSON_LD = {"Content-Type": "application/ld+json"}
MERGE = {"Content-Type": "application/merge-patch+json"}
UPDATE = {"Content-Type": "application/sparql-update"}


def value(http: httpx.Client, path: str) -> Any:
    """Return the plain JSON of a resource."""
    answer = http.get(path, headers=JSON)
    assert answer.status_code == 200, answer.text
    return answer.json()


def triples(answer: httpx.Response) -> set[Triple]:
    """Return the triples of a response."""
    assert answer.status_code == 200, answer.text
    syntax = RdfFormat.from_media_type(answer.headers["content-type"].partition(";")[0])
    assert syntax is not None
    return {quad.triple for quad in parse(answer.content, format=syntax, base_iri=str(answer.url))}


def objects(answer: httpx.Response, predicate: str, subject: str | None = None) -> set[str]:
    """Return the objects of a predicate in a response, of its resource or of `subject`."""
    about = NamedNode(subject or str(answer.url))
    return {
        one.object.value for one in triples(answer) if one.subject == about and one.predicate == NamedNode(predicate)
    }


def mapped(http: httpx.Client, document: str, name: str = "mine") -> None:
    answer = http.put(f"/mappings/{name}", content=PREFIXES + document, headers=TURTLE)
    assert answer.status_code in (201, 204), answer.text


def detail(answer: httpx.Response, status: int) -> str:
    """Return the detail of a problem."""
    assert answer.status_code == status, (answer.status_code, answer.text)
    return str(answer.json()["detail"])
