"""Which queries may run in a thread: those that cannot grow out of hand."""

from __future__ import annotations

import pytest

from rosld.ontology.lift import TYPES
from rosld.server.sparql.analysis import Analyser

BASE = "http://127.0.0.1:8080/"
ANALYSER = Analyser(BASE, TYPES)
POSE = f"{TYPES}turtlesim/msg/Pose#"


@pytest.mark.parametrize(
    "query",
    [
        "SELECT * { ?s ?p ?o }",
        f"SELECT * {{ GRAPH <{BASE}topics/x> {{ ?s ?p ?o }} }}",
        f"SELECT ?x {{ ?t a ros:Topic ; ros:latest ?m . ?m <{POSE}x> ?x }} ORDER BY ?x",
        f"SELECT ?x ?r {{ <{BASE}topics/x> ros:latest ?m . ?m <{POSE}x> ?x BIND(RAND() AS ?r) }}",
        "SELECT ?node ?topic ?type { ?node ros:publishes ?topic . ?topic ros:messageType ?type }",
        "SELECT ?node ?topic ?type { ?topic ros:messageType ?type . ?node ros:publishes ?topic }",
        "SELECT (COUNT(*) AS ?n) { ?t a ros:Topic OPTIONAL { ?t ros:unreadable ?why } }",
        "SELECT ?t { ?t a ros:Topic FILTER NOT EXISTS { ?t ros:subscriber ?node } }",
        "SELECT ?n { { ?t a ros:Topic } UNION { ?t a ros:Service } ?t ros:name ?n }",
        f"DESCRIBE <{BASE}topics/x>",
    ],
)
def test_what_follows_links_from_one_place_is_modest(query: str) -> None:
    assert ANALYSER.analyse(query).modest


@pytest.mark.parametrize(
    "query",
    [
        "SELECT * { ?a ?b ?c . ?d ?e ?f }",
        "SELECT * { ?a a ?c . ?b a ?c }",
        "SELECT * { ?a ros:name ?n . ?b ros:name ?n }",
        "SELECT * { ?a ?p ?b . ?b ?q ?c . ?c ?r ?d }",
        "SELECT * { ?c ldp:contains ?x , ?y , ?z }",
        "SELECT * { ?a rdf:rest* ?b }",
        "SELECT * { ?a ros:publishes+ ?b }",
        "SELECT * { ?a a ros:Topic { SELECT * { ?d ?e ?f } } }",
        "SELECT * { ?a a ros:Topic OPTIONAL { ?d ?e ?f } }",
        "SELECT * { ?a a ros:Topic FILTER NOT EXISTS { ?d a ros:Node } }",
        "SELECT * { ?a a ros:Topic } VALUES ?x { 1 2 3 }",
        "SELECT * { BIND('x' AS ?a) BIND(CONCAT(?a, ?a) AS ?b) BIND(CONCAT(?b, ?b) AS ?c) }",
        "SELECT * { BIND(REPLACE('aaa', 'a', 'aaaaaaaa') AS ?b) }",
        "SELECT * {" + "{} UNION {}" * 5 + "}",
        "SELECT * { <h:a> ?b ?c . <h:d> ?e ?f . <h:g> ?h ?i }",
        "SELECT nonsense",
    ],
)
def test_what_could_multiply_is_not(query: str) -> None:
    assert not ANALYSER.analyse(query).modest
