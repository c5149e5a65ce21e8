"""JSON-LD as rdflib reads it: every document has the same triples in JSON-LD and in N-Triples, digit by digit."""

from __future__ import annotations

from typing import Any

import pytest
from rdflib import Graph, Literal
from rdflib.compare import to_isomorphic
from rdflib.term import Node

XSD = "http://www.w3.org/2001/XMLSchema#"
NUMBERS = {
    "double": (
        "0.1",
        "1.0E100",
        "-0.0",
        "12345678901234567890.0",
        "0.30000000000000004",
        "INF",
        "-INF",
        "NaN",
        "5e-324",
    ),
    "float": ("3.4028235E38", "-0.0", "NaN"),
    "integer": ("18446744073709551615", "-0", "007"),
    "decimal": ("2.50", "0.30000000000000004"),
    "boolean": ("true", "0"),
    "unsignedByte": ("255",),
}


def told(document: bytes, syntax: str, base: str) -> set[tuple[Node, ...]]:
    """Return the triples of a document with unnormalized literals."""
    graph = to_isomorphic(Graph().parse(data=document, format=syntax, publicID=base))
    return {tuple(map(spelt, triple)) for triple in graph}


def spelt(term: Node) -> Any:
    return (str(term), str(term.datatype), term.language) if isinstance(term, Literal) else term


@pytest.fixture(autouse=True)
def as_written(monkeypatch: pytest.MonkeyPatch) -> None:
    """Preserve lexical forms: rdflib normalizes some."""
    monkeypatch.setattr("rdflib.NORMALIZE_LITERALS", False)


def test_numbers_of_every_type_are_the_same_as_in_ntriples(server: Any, folder: str) -> None:
    url = f"{folder}numbers"
    text = "".join(f'<> <urn:p> "{value}"^^<{XSD}{kind}> .\n' for kind, values in NUMBERS.items() for value in values)
    assert server.http.put(url, content=text, headers={"Content-Type": "text/turtle"}).status_code == 201
    answers = {accept: server.http.get(url, headers={"Accept": accept}).content for accept in TYPES}
    query = {"query": f"CONSTRUCT {{ ?s ?p ?o }} {{ GRAPH <{url}> {{ ?s ?p ?o }} }}"}
    found = told(answers["application/n-triples"], "nt", url)
    assert {(value, XSD + kind, None) for kind, values in NUMBERS.items() for value in values} <= {
        o for _, _, o in found
    }
    assert told(answers["application/ld+json"], "json-ld", url) == found
    constructed = server.http.get("sparql", params=query, headers={"Accept": "application/ld+json"}).content
    assert told(constructed, "json-ld", url) == found


TYPES = ("application/n-triples", "application/ld+json")


@pytest.mark.parametrize("path", ["", "types/std_msgs/msg/Float64", "resources/cockpit/", "parameters/", "sparql"])
def test_pages_say_the_same_in_both(server: Any, path: str) -> None:
    ntriples, jsonld = (server.http.get(path, headers={"Accept": accept}).content for accept in TYPES)
    url = server.url + path
    assert told(ntriples, "nt", url) == told(jsonld, "json-ld", url)
