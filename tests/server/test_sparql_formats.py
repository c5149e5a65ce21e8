"""The formats of results, as clients read them: what each can carry, and what is answered where it cannot."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from xml.etree import ElementTree

import httpx
import pytest
from pyoxigraph import RdfFormat, parse

XML, JSON = "application/sparql-results+xml", "application/sparql-results+json"
RDF_XML, TURTLE = "application/rdf+xml", "text/turtle"
RESULTS = "{http://www.w3.org/2005/sparql-results#}"
CONTROL = r"SELECT ('\u0001' AS ?x) {}"


def ask(http: httpx.Client, query: str, accept: str) -> httpx.Response:
    return http.get("/sparql", params={"query": query}, headers={"Accept": accept})


@pytest.mark.parametrize("code", ["0001", "0008", "000B", "001F", "FFFE", "FFFF"])
@pytest.mark.parametrize(
    "query", ["SELECT ('a%s' AS ?x) {}", "SELECT ?x { VALUES ?y { 1 2 } BIND('%s' AS ?x) } ORDER BY ?y"]
)
def test_what_xml_cannot_carry_is_not_acceptable_to_who_takes_only_xml(
    http: httpx.Client, code: str, query: str
) -> None:
    answer = ask(http, query % rf"\u{code}", XML)
    assert answer.status_code == 406
    assert f"XML cannot carry the character U+{code}" in answer.json()["detail"]


def test_it_is_answered_in_what_else_a_client_takes(http: httpx.Client) -> None:
    answer = ask(http, CONTROL, f"{XML}, {JSON};q=0.5")
    assert answer.headers["content-type"] == JSON
    assert answer.json()["results"]["bindings"] == [{"x": {"type": "literal", "value": "\x01"}}]
    construct = r"CONSTRUCT { <urn:s> <urn:p> '\u0001' } {}"
    assert ask(http, construct, RDF_XML).status_code == 406
    assert ask(http, construct, f"{RDF_XML}, {TURTLE};q=0.1").headers["content-type"] == f"{TURTLE}; charset=utf-8"


def test_everything_of_a_server_is_answered_to_who_likes_xml_best(start_server: Callable[..., Any]) -> None:
    http: httpx.Client = start_server("aircraft").http  # nobody else writes there
    answer = ask(http, "SELECT * { ?s ?p ?o }", f"{XML}, {JSON};q=0.8")
    assert answer.headers["content-type"] == XML
    assert len([*ElementTree.fromstring(answer.content).iter(f"{RESULTS}result")]) > 500
    assert http.put("/data/control", content=b"<> <urn:p> '\\u0001' .", headers={"Content-Type": TURTLE}).is_success
    try:
        answer = ask(http, "SELECT * { ?s ?p ?o }", f"{XML}, {JSON};q=0.8")
        assert answer.headers["content-type"] == JSON
        assert len(answer.json()["results"]["bindings"]) > 500
    finally:
        http.delete("/data/control")


def test_carriage_returns_arrive_through_xml(http: httpx.Client) -> None:
    answer = ask(http, r"SELECT ('a\rb\r\n\tc' AS ?x) {}", XML)
    assert b"&#13;" in answer.content
    [literal] = ElementTree.fromstring(answer.content).iter(f"{RESULTS}literal")
    assert literal.text == "a\rb\r\n\tc"


@pytest.mark.parametrize(("query", "value"), [("ASK {}", "true"), ("ASK { <urn:no> <urn:no> <urn:no> }", "false")])
def test_ask_is_a_table_of_one_column_in_csv_and_tsv(http: httpx.Client, query: str, value: str) -> None:
    assert ask(http, query, "text/csv").text == f"_askResult\r\n{value}\r\n"
    assert ask(http, query, "text/tab-separated-values").text == f"?_askResult\n{value}\n"
    assert ask(http, query, JSON).json()["boolean"] is (value == "true")


@pytest.mark.parametrize(
    ("template", "prefixes"),
    [
        ("<urn:s> <urn:p> 'ros:x <rdfs:y>'", set()),
        ("<urn:s> a ros:Topic", {"ros"}),
        ("<urn:s> rdfs:label '1'^^xsd:byte ; <urn:p> 'a:b'@en, 5", {"rdfs", "xsd"}),
        ("ros:a:b ros:c/d 'dcterms:'", {"ros"}),
    ],
)
@pytest.mark.parametrize("media_type", [TURTLE, "application/trig", "text/n3"])
def test_a_graph_names_the_prefixes_that_it_uses(
    http: httpx.Client, media_type: str, template: str, prefixes: set[str]
) -> None:
    query = template.replace("ros:c/d", "<https://w3id.org/rosld#c/d>")
    text = ask(http, f"CONSTRUCT {{ {query} }} {{}}", media_type).text
    assert {line.split()[1][:-1] for line in text.splitlines() if line.startswith("@prefix")} == prefixes


def test_a_large_graph_is_whole_whatever_prefixes_come_late(http: httpx.Client) -> None:
    digits = "VALUES ?a { 0 1 2 3 4 5 6 7 8 9 }"
    numbers = " ".join(digits.replace("?a", f"?{name}") for name in "abcde")
    query = (
        "CONSTRUCT { ?s ?p ?n } { { SELECT * { "
        + numbers
        + " } } BIND(?a * 10000 + ?b * 1000 + ?c * 100 + ?d * 10 + ?e AS ?n) "
        "BIND(IRI(CONCAT('urn:s', STR(?n))) AS ?s) BIND(IF(?n < 99990, ros:name, rdfs:label) AS ?p) }"
    )
    answer = ask(http, query, TURTLE)
    assert answer.status_code == 200
    found = {quad.predicate.value for quad in parse(answer.content, RdfFormat.TURTLE)}
    assert found == {"https://w3id.org/rosld#name", "http://www.w3.org/2000/01/rdf-schema#label"}
    assert len(list(parse(answer.content, RdfFormat.TURTLE))) == 100_000
