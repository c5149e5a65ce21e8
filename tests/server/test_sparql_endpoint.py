"""The SPARQL endpoint over HTTP: live values, every format and its limitations, refusals, pages."""

from __future__ import annotations

import io
from xml.etree import ElementTree

import httpx
import pyarrow as pa
import pytest
from pyarrow import parquet
from pyoxigraph import RdfFormat, parse

XML, JSON = "application/sparql-results+xml", "application/sparql-results+json"
RDF_XML, TURTLE = "application/rdf+xml", "text/turtle"
RESULTS = "{http://www.w3.org/2005/sparql-results#}"
CONTROL = r"SELECT ('\u0001' AS ?x) {}"
SHORT = "{ GRAPH </data/there> { <urn:a> <urn:p> ?x } }"


def ask(http: httpx.Client, query: str, accept: str) -> httpx.Response:
    return http.get("/sparql", params={"query": query}, headers={"Accept": accept})


def test_characters_that_xml_cannot_carry_are_406_where_only_xml_is_accepted(http: httpx.Client) -> None:
    ordered = "SELECT ?x { VALUES ?y { 1 2 } BIND('%s' AS ?x) } ORDER BY ?y"
    for code in ("0001", "0008", "000B", "001F", "FFFE", "FFFF"):
        for query in ("SELECT ('a%s' AS ?x) {}", ordered):
            answer = ask(http, query % rf"\u{code}", XML)
            assert answer.status_code == 406
            assert f"The results contain the character U+{code}" in answer.json()["detail"]
    answer = ask(http, CONTROL, f"{XML}, {JSON};q=0.5")
    assert answer.headers["content-type"] == JSON
    assert answer.json()["results"]["bindings"] == [{"x": {"type": "literal", "value": "\x01"}}]
    construct = r"CONSTRUCT { <urn:s> <urn:p> '\u0001' } {}"
    assert ask(http, construct, RDF_XML).status_code == 406
    assert ask(http, construct, f"{RDF_XML}, {TURTLE};q=0.1").headers["content-type"] == f"{TURTLE}; charset=utf-8"


def test_carriage_returns_arrive_through_xml(http: httpx.Client) -> None:
    answer = ask(http, r"SELECT ('a\rb\r\n\tc' AS ?x) {}", XML)
    assert b"&#13;" in answer.content
    [literal] = ElementTree.fromstring(answer.content).iter(f"{RESULTS}literal")
    assert literal.text == "a\rb\r\n\tc"


def test_ask_is_a_table_of_one_column_in_csv_and_tsv(http: httpx.Client) -> None:
    for query, value in (("ASK {}", "true"), ("ASK { <urn:no> <urn:no> <urn:no> }", "false")):
        assert ask(http, query, "text/csv").text == f"_askResult\r\n{value}\r\n"
        assert ask(http, query, "text/tab-separated-values").text == f"?_askResult\n{value}\n"
        assert ask(http, query, JSON).json()["boolean"] is (value == "true")


def test_solutions_are_tables_of_arrow_too(http: httpx.Client) -> None:
    query = "SELECT ?n ?x { VALUES (?n ?x) { (1 1.5e0) (2 UNDEF) } }"
    expected = {"n": [1, 2], "x": [1.5, None]}
    for params, headers in (
        ({"format": "parquet"}, {}),
        ({}, {"Accept": "application/vnd.apache.parquet, text/turtle;q=0.5"}),
    ):
        answer = http.get("/sparql", params={"query": query, **params}, headers=headers)
        assert answer.headers["content-type"] == "application/vnd.apache.parquet"
        assert parquet.read_table(io.BytesIO(answer.content)).to_pydict() == expected
    arrow = {"Accept": "application/vnd.apache.arrow.stream"}
    for params, headers in (({}, arrow), ({"format": "arrow"}, {})):
        answer = http.post("/sparql", data={"query": query}, params=params, headers=headers)
        assert pa.ipc.open_stream(answer.content).read_all().to_pydict() == expected
    answer = http.get("/queries/inventory", params={"format": "arrow"})
    assert pa.ipc.open_stream(answer.content).read_all().num_columns > 0, answer.text
    answer = http.get("/sparql", params={"query": "SELECT ?s { FILTER(false) }", "format": "parquet"})
    assert parquet.read_table(io.BytesIO(answer.content)).to_pydict() == {"s": []}
    for form in ("CONSTRUCT { ?s ?p ?o } { ?s ?p ?o }", "SELEKT"):
        answer = http.get("/sparql", params={"query": form, "format": "parquet"})
        assert answer.status_code == (406 if form.startswith("C") else 400), answer.text


def test_a_graph_names_the_prefixes_that_it_uses(http: httpx.Client) -> None:
    for template, prefixes in (
        ("<urn:s> <urn:p> 'ros:x <rdfs:y>'", set()),
        ("<urn:s> a ros:Topic", {"ros"}),
        ("<urn:s> rdfs:label '1'^^xsd:byte ; <urn:p> 'a:b'@en, 5", {"rdfs", "xsd"}),
        ("ros:a:b <https://w3id.org/rosld#c/d> 'dcterms:'", {"ros"}),
    ):
        for media_type in (TURTLE, "application/trig", "text/n3"):
            text = ask(http, f"CONSTRUCT {{ {template} }} {{}}", media_type).text
            assert {line.split()[1][:-1] for line in text.splitlines() if line.startswith("@prefix")} == prefixes


@pytest.mark.slow
def test_a_large_graph_is_whole_whatever_prefixes_come_late(http: httpx.Client) -> None:
    digits = "{ 0 1 2 3 4 5 6 7 8 9 }"
    numbers = "VALUES ?a { 0 1 } " + " ".join(f"VALUES ?{name} {digits}" for name in "bcde")
    query = (
        "CONSTRUCT { ?s ?p ?n } { { SELECT * { "
        + numbers
        + " } } BIND(?a * 10000 + ?b * 1000 + ?c * 100 + ?d * 10 + ?e AS ?n) "
        "BIND(IRI(CONCAT('urn:s', STR(?n))) AS ?s) BIND(IF(?n < 19990, ros:name, rdfs:label) AS ?p) }"
    )
    answer = ask(http, query, TURTLE)
    assert answer.status_code == 200
    found = {quad.predicate.value for quad in parse(answer.content, RdfFormat.TURTLE)}
    assert found == {"https://w3id.org/rosld#name", "http://www.w3.org/2000/01/rdf-schema#label"}
    assert len(list(parse(answer.content, RdfFormat.TURTLE))) == 20_000


@pytest.mark.slow
def test_no_two_updates_make_the_same_blank_node(own_aircraft: httpx.Client) -> None:
    """SPARQL 1.1 Update 3.1.3, 19.6 of SPARQL 1.1 Query: they are new."""
    there = {"content": "<urn:a> <urn:p> 1 .", "headers": {"Content-Type": TURTLE}}
    own_aircraft.put("/data/there", **there).raise_for_status()
    own_aircraft.get("/sparql", params={"query": f"SELECT (UUID() AS ?y) {SHORT}"}).raise_for_status()
    for number, inserted in enumerate(
        (
            "INSERT {{ GRAPH <{0}> {{ [] <urn:p> 1 }} }} WHERE {{}}",
            "INSERT {{ GRAPH <{0}> {{ ?b <urn:p> 1 }} }} WHERE {{ BIND(BNODE() AS ?b) }}",
            "INSERT DATA {{ GRAPH <{0}> {{ [] <urn:p> 1 }} }}",
        )
    ):
        graph = f"/data/random-{number}"
        first = f"INSERT DATA {{ GRAPH <{graph}> {{ <urn:a> <urn:p> 1 }} }}"
        last = f"DELETE {{ GRAPH <{graph}> {{ ?s <urn:none> 1 }} }} WHERE {{ GRAPH <{graph}> {{ ?s <urn:none> 1 }} }}"
        for _ in range(3):
            text = f"{first} ; {inserted.format(graph)} ; {last}"
            own_aircraft.post(
                "/sparql", content=text, headers={"Content-Type": "application/sparql-update"}
            ).raise_for_status()
        assert own_aircraft.get(graph, headers={"Accept": "application/n-triples"}).text.count("_:") == 3, inserted
