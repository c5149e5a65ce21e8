"""What is said not to take long takes little: over a dataset made to be large wherever somebody looks."""

from __future__ import annotations

import time
from functools import lru_cache

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rosld.server.dataset import MemoryStore
from rosld.server.sparql.analysis import Analyser
from rosld.server.sparql.process.work import QueryWork

TYPES = "https://w3id.org/rosld/types/"
ROS = "https://w3id.org/rosld#"
ANALYSER = Analyser("http://robot/", TYPES)
LONGEST = 0.1
"""Seconds of the processor; one look at everything takes several times as long."""


@lru_cache
def dataset() -> MemoryStore:
    """A container with 20,000 members, things with 20,000 and with 150 values, 300 topics, long chains."""
    store = MemoryStore()
    many = range(20_000)
    store.replace(
        {
            "http://robot/many": "".join(
                f"<http://robot/many> <http://p/member> <http://robot/member/{n}> .\n"
                f"<http://robot/member/{n}> <{ROS}name> <http://robot/many> .\n"
                f"<http://robot/many> <{ROS}value> {n % 1000} .\n".replace(f" {n % 1000} .", f' "{n}" .')
                for n in many
            ),
            "http://robot/topics": "".join(
                f"<http://robot/topics/t{n}> <http://www.w3.org/1999/02/22-rdf-syntax-ns#type> <{ROS}Topic> .\n"
                f'<http://robot/topics/t{n}> <{ROS}name> "t{n}" .\n'
                f"<http://robot/topics/t{n}> <{ROS}latest> <http://robot/topics/t{n}#message> .\n"
                f'<http://robot/topics/t{n}#message> <{ROS}value> "{n}" .\n'
                for n in range(300)
            ),
            "http://robot/some": "".join(f'<http://robot/some> <{ROS}value> "{n}" .\n' for n in range(150)),
            "http://robot/few": "".join(f'<http://robot/few> <{ROS}value> "{n}" .\n' for n in range(12)),
            "http://robot/chain": "".join(
                f"<http://robot/chain/{n}> <http://p/next> <http://robot/chain/{n + 1}> .\n"
                f"<http://robot/chain/{n}> <http://p/member> <http://robot/many> .\n"
                f"<http://robot/chain/{n}> <http://www.w3.org/1999/02/22-rdf-syntax-ns#type> <http://p/Link> .\n"
                for n in many
            ),
        }
    )
    return store


def is_quick(query: str, store: MemoryStore | None = None) -> bool:
    """Whether it is said not to take long."""
    found = ANALYSER.analyse(query)
    asked = QueryWork(
        found.text, ANALYSER.base, found.prefixes, found.default_graphs, found.named_graphs, found.plan, None
    )
    return not asked.may_take_long(store or dataset())


def seconds(query: str) -> float:
    """What an answer takes of the processor."""
    analysis = ANALYSER.analyse(query)
    begun = time.thread_time()
    results = dataset().query(analysis.text, base=ANALYSER.base, prefixes=analysis.prefixes)
    if not isinstance(results, bool) and hasattr(results, "__iter__"):
        for _ in results:
            pass
    return time.thread_time() - begun


SUBJECTS = st.sampled_from(
    ["<many>", "<topics/t7>", "<topics/t7#message>", "<chain/5>", "<member/3>", "<nowhere>", "?a", "?b", "?c", "?d"]
)
PREDICATES = st.sampled_from(
    ["ros:value", "ros:name", "ros:latest", "<http://p/member>", "<http://p/next>", "a", "?p", "^ros:name",
     "ros:latest/ros:value", "<http://p/next>/<http://p/next>"]
)  # fmt: skip
OBJECTS = st.sampled_from(
    ["<many>", "<topics/t7#message>", "<http://p/Link>", "ros:Topic", '"17"', "?a", "?b", "?c", "?d", "?e", "[]"]
)
PATTERNS = st.builds("{} {} {}".format, SUBJECTS, PREDICATES, OBJECTS)
AROUND = st.sampled_from(
    ["{}", "{}", "GRAPH ?g {{ {} }}", "GRAPH <many> {{ {} }}", "GRAPH <some> {{ {} }}", "GRAPH <few> {{ {} }}",
     "GRAPH <few> {{ {} FILTER(?a != ?b || STRLEN(STR(?c)) > 3) }}", "{} FILTER(?a != ?b)", "{} BIND(STR(?a) AS ?x)",
     "BIND(1 AS ?x) {}", "{} FILTER(STRLEN(STR(?e)) > 3)", "{} FILTER(?c = <topics/t7>)",
     "FILTER(?a = <many> || ?b > 3) {}", "{} FILTER(sameTerm(?a, ?b)) FILTER(?d NOT IN (1, 'x', <many>))"]
)  # fmt: skip
QUERIES = st.builds(
    lambda head, around, patterns, tail: head + "{ " + around.format(" . ".join(patterns)) + " } " + tail,
    st.sampled_from(
        ["SELECT * ", "SELECT (COUNT(*) AS ?n) ", "SELECT DISTINCT ?a ", "ASK ", "CONSTRUCT { ?a ?p ?b } WHERE ",
         "SELECT (MAX(?b) AS ?most) (SAMPLE(?c) AS ?one) "]
    ),
    AROUND,
    st.lists(PATTERNS, min_size=1, max_size=5),
    st.sampled_from(["", "", "LIMIT 5", "ORDER BY ?a ?b", "ORDER BY DESC(STR(?b)) LIMIT 1"]),
)  # fmt: skip


@settings(max_examples=400)
@given(query=QUERIES)
def test_what_is_said_not_to_take_long_takes_little(query: str) -> None:
    if is_quick(query):
        took = min(seconds(query) for _ in range(2))
        assert took < LONGEST, f"{took:.3f} s"


@pytest.mark.parametrize(
    "query",
    [
        "SELECT ?m { <topics/t7> ros:latest ?m }",
        "SELECT ?x { <topics/t7> ros:latest ?m . ?m ros:value ?x }",
        "SELECT ?x ?r { <topics/t7> ros:latest ?m . ?m ros:value ?x BIND(RAND() AS ?r) }",
        "SELECT ?p ?o { GRAPH <topics> { <topics/t7#message> ?p ?o } }",
        "ASK { <topics/t7> a ros:Topic }",
        "SELECT * { GRAPH <some> { ?s ?p ?o } }",
        "SELECT * { GRAPH <few> { ?s ?p ?o . ?s ?q ?r FILTER(?o != ?r) } } ORDER BY ?o",
        "SELECT (ros:age(<topics/t7>) AS ?age) ?x { <topics/t7#message> ros:value ?x }",
        "SELECT ?x { <some> ros:value ?x FILTER(?x > 17 && CONTAINS(STR(?x), '3')) } ORDER BY DESC(?x) LIMIT 3",
        "SELECT ?x { <topics/t7> ros:latest ?m . ?m ros:value ?x FILTER(?x NOT IN (1, 2, 3)) }",
        "SELECT ?p (MAX(?x) AS ?most) { <some> ?p ?x } GROUP BY ?p HAVING (COUNT(*) > 3)",
        f"SELECT * {{ <topics/t7> ros:latest ?m FILTER(1 {'+ 1 ' * 200} = ?m) }}",
    ],
)
def test_what_follows_few_links_from_constants_does_not_take_long(query: str) -> None:
    assert is_quick(query)


@pytest.mark.parametrize(
    "query",
    [
        "SELECT * { <many> ros:value ?a }",
        "SELECT * { <many> ros:value ?a . <many> ros:value ?b . <many> ros:value ?c . ?c ros:latest ?d }",
        "SELECT (COUNT(*) AS ?n) { <many> <http://p/member> ?a , ?b }",
        "SELECT * { <chain/5> <http://p/member> ?a . ?a ros:value ?b }",
        "SELECT * { ?a ros:latest ?m . ?m ros:value ?x }",
        "SELECT * { ?a <http://p/next> <chain/7> . ?a a ?t . ?b a ?t }",
    ],
)
def test_what_meets_many_values_may_take_long_whatever_its_form(query: str) -> None:
    assert not is_quick(query)


@pytest.mark.parametrize(
    "query",
    [
        "SELECT * { <topics/t7> ros:latest* ?m }",
        "SELECT * { <topics/t7> (ros:latest|ros:name) ?m }",
        "SELECT * { <topics/t7> ros:latest ?m OPTIONAL { ?a ?b ?c } }",
        "SELECT * { <topics/t7> ros:latest ?m MINUS { ?a ?b ?c } }",
        "SELECT * { { <topics/t7> ros:latest ?m } UNION { ?a ?b ?c } }",
        "SELECT * { <topics/t7> ros:latest ?m FILTER EXISTS { ?a ?b ?c } }",
        "SELECT * { <topics/t7> ros:latest ?m { SELECT * { ?a ?b ?c } } }",
        "SELECT * { <topics/t7> ros:latest ?m } VALUES ?x { 1 2 3 }",
        "SELECT * { <topics/t7> ros:latest ?m FILTER(REGEX(STR(?m), '((a{30}){30}){30}')) }",
        "SELECT (CONCAT(?n, ?n) AS ?x) { <topics/t7> ros:name ?n }",
        "SELECT (GROUP_CONCAT(?n) AS ?x) { <topics/t7> ros:name ?n }",
        "SELECT * { ?m ros:value ?x BIND(1 AS ?y) <topics/t7> ros:latest ?m }",
        "SELECT * { GRAPH <some> { ?s ?p ?o . ?t ?q ?r } }",
        "SELECT * { GRAPH <few> { ?s ?p ?o . ?t ?q ?r . ?u ?v ?w . ?x ?y ?z } }",
        "SELECT * { GRAPH <few> { ?s ?p ?o } ?s ?q ?r }",
        "SELECT * { GRAPH <many> { ?s ?p ?o } }",
        f"SELECT * {{ <some> ros:value ?v FILTER(1 {'+ 1 ' * 200} = ?v) }}",
        f"SELECT * {{ <some> ros:value ?v FILTER(?v IN ({', '.join(map(str, range(200)))})) }}",
        f"SELECT * {{ <some> ros:value ?v }} ORDER BY {'STR(?v) ' * 50}",
        "DESCRIBE <topics/t7>",
        "SELECT * " + "".join(f"FROM <topics/t{n}> " for n in range(20)) + "{ <topics/t7> ros:latest ?m }",
    ],
)
def test_of_what_is_not_simple_it_is_always_said(query: str) -> None:
    assert not is_quick(query)


def test_few_solutions_with_long_values_may_take_long() -> None:
    store = MemoryStore()
    store.replace({"http://robot/long": f'<http://robot/long> <{ROS}value> "{"x" * 2_000_000}" .\n'})
    assert not is_quick("SELECT (STR(?x) AS ?y) { <long> ros:value ?x }", store)
