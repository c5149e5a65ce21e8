"""Deprecated terms in queries: found however they are written, and told of with what has taken their place."""

from __future__ import annotations

import httpx
import pytest

from rosld.ontology.modules import successors
from rosld.server.http.link import parse
from rosld.server.sparql.deprecated_terms import find_deprecated_terms

ROS, MAP = "https://w3id.org/rosld#", "https://w3id.org/rosld/mapping#"
PREFIX = f"PREFIX ros: <{ROS}> "


@pytest.mark.parametrize(
    ("text", "found"),
    [
        (PREFIX + "SELECT * { ?topic ros:publisher ?node }", [f"{ROS}publisher"]),
        (f"prefix r: <{ROS}> SELECT * {{ ?graph r:master/r:name ?name }}", [f"{ROS}master"]),
        (f"SELECT * {{ ?topic <{ROS}publisher> ?node }}", [f"{ROS}publisher"]),
        (f"PREFIX map: <{MAP}> SELECT * {{ ?a map:unit ?b }}", [f"{MAP}unit"]),
        ("SELECT * { ?topic ros:publisher ?node }", [f"{ROS}publisher"]),
        ("PREFIX ros: <http://example.org/> SELECT * { ?topic ros:publisher ?node }", []),
        (PREFIX + "SELECT * { ?topic ros:publishedBy ?node ; ros:publishers ?x }", []),
        ("PREFIX ex: <http://example.org/> SELECT * { ?topic ex:publisher ?node }", []),
    ],
)
def test_deprecated_terms_of_a_query_are_found(text: str, found: list[str]) -> None:
    assert list(find_deprecated_terms(text)) == found


def test_every_deprecated_term_has_a_successor_that_is_told() -> None:
    for iri, instead in successors().items():
        (sentence,) = find_deprecated_terms(f"SELECT * {{ ?a <{iri}> ?b }}").values()
        assert "is deprecated" in sentence
        assert instead


def test_an_answer_links_to_what_is_said_of_a_deprecated_term(http: httpx.Client) -> None:
    query = PREFIX + "SELECT * { ?topic ros:publisher ?node }"
    answer = http.get("/sparql", params={"query": query}, headers={"Accept": "application/json"})
    assert answer.json()["results"]["bindings"] == []
    (link,) = [each for each in parse(", ".join(answer.headers.get_list("link"))) if each.rel == "deprecation"]
    assert link.target == f"{http.base_url}ontology/deprecated#publisher"
    assert link.title is not None
    assert "ros:publishedBy" in link.title
    page = http.get("/sparql", params={"query": query}, headers={"Accept": "text/html"}).text
    assert "ros:publisher is deprecated: " in page


def test_an_error_links_to_it_too(http: httpx.Client) -> None:
    answer = http.get("/sparql", params={"query": PREFIX + "SELECT { ?topic ros:publisher ?node }"})
    assert answer.status_code == 400
    assert 'rel="deprecation"' in answer.headers["link"]


def test_an_answer_without_such_terms_has_no_such_link(http: httpx.Client) -> None:
    answer = http.get("/sparql", params={"query": PREFIX + "SELECT * { ?topic ros:publishedBy ?node }"})
    assert "deprecation" not in answer.headers.get("link", "")
