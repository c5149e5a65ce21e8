"""However a query is spelled it answers the same, or says which graphs it did not look at."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import pytest

ALL = "SELECT * { ?s ?p ?o }"
TURTLE = {"Content-Type": "text/turtle"}


@pytest.fixture(scope="module")
def http(start_server: Callable[..., Any]) -> Iterator[httpx.Client]:
    """An aircraft, none of whose topics is subscribed to until a query has it so."""
    served = start_server("aircraft")
    yield served.http
    assert served.stop() == 0


def ask(http: httpx.Client, query: str) -> tuple[list[list[str]], str]:
    """The rows of a SELECT in an order of their own, and what it says that it did not look at."""
    answer = http.get("/sparql", params={"query": query}, headers={"Accept": "text/csv"})
    assert answer.status_code == 200, answer.text
    rows = list(csv.reader(io.StringIO(answer.text)))[1:]
    return sorted(rows), answer.headers.get("unread-graphs", "")


def unread(http: httpx.Client, query: str) -> set[str]:
    """The containers that a query says it did not look into."""
    field = ask(http, query)[1]
    members = [member.strip().partition(";count=") for member in field.split(",") if member]
    assert all(count.isdecimal() and int(count) > 0 for _, _, count in members)
    return {container for container, _, _ in members}


def test_a_query_about_the_computation_graph_has_looked_at_all_there_is(http: httpx.Client) -> None:
    for query in (
        "SELECT * { ?t a ros:Topic }",
        "SELECT * { ?n ros:publishes ?t }",
        "SELECT * { ?n a ros:Node ; ?p ?o }",
    ):
        assert ask(http, query)[1] == ""


def test_a_query_says_that_it_did_not_call_the_getters_of_the_whole_robot(http: httpx.Client) -> None:
    assert "resources" in unread(http, ALL)
    assert "resources" in unread(http, "SELECT * { ?r ?p 'off' }")
    assert "resources" in unread(http, "SELECT * { GRAPH ?g { ?r dcterms:isPartOf ?c } }")
    assert unread(http, "SELECT * { ?r a ros:Property ; ros:name ?n }") == set()
    assert unread(http, "SELECT * { GRAPH <resources/aircraft/power> { ?r ?p ?v } }") == set()


def test_a_query_says_that_it_did_not_subscribe_to_topics(start_server: Callable[..., Any]) -> None:
    served = start_server("aircraft")
    http = served.http
    assert "topics;count=2" in ask(http, ALL)[1]
    assert unread(http, "SELECT * { ?t a ros:Topic ; ros:rate ?r }") == {"topics"}
    assert unread(http, "SELECT * { <topics/aircraft/engine/speed> ros:rate ?r }") == set()
    assert "topics;count=1" in ask(http, ALL)[1]
    http.put("/topics/cockpit/display", json={"data": "x"})
    assert "topics" not in unread(http, ALL)
    assert served.stop() == 0


def test_the_page_says_so_too(http: httpx.Client) -> None:
    page = http.get("/sparql", params={"query": ALL}, headers={"Accept": "text/html"}).text
    assert "Not looked at, as the query does not name them:" in page
    assert "below /resources/" in page
    query = {"query": "SELECT * { ?t a ros:Topic }"}
    assert "Not looked at" not in http.get("/sparql", params=query, headers={"Accept": "text/html"}).text


def test_the_page_knows_words_for_whatever_the_header_names(http: httpx.Client) -> None:
    for query in (
        ALL,
        "SELECT * { ?call ros:outcome ?o }",
        "SELECT * { ?r ?p 'off' }",
        "SELECT * { ?c ldp:contains ?r }",
    ):
        left = ask(http, query)[1]
        page = http.get("/sparql", params={"query": query}, headers={"Accept": "text/html"})
        assert page.status_code == 200, (query, left)
        assert ("Not looked at" in page.text) == bool(left), (query, left)


def test_a_page_elsewhere_may_read_it(start_server: Callable[..., Any]) -> None:
    served = start_server("aircraft", "--cors-origin", "http://elsewhere.example")
    headers = {"Origin": "http://elsewhere.example"}
    answer = served.http.get("/sparql", params={"query": ALL}, headers=headers)
    assert "Unread-Graphs" in answer.headers["access-control-expose-headers"]
    assert "resources" in answer.headers["unread-graphs"]
    assert served.stop() == 0


SPEED, POWER = "<topics/aircraft/engine/speed>", "<resources/aircraft/power>"
FLOAT = "<https://w3id.org/rosld/types/std_msgs/msg/Float64>"
DATA = "<https://w3id.org/rosld/types/std_msgs/msg/Float64#data>"
OF_PROPERTIES = [
    "SELECT ?r { ?r a ros:Property }",
    "SELECT ?r { VALUES ?c { ros:Property } ?r a ?c }",
    "SELECT ?r { BIND(ros:Property AS ?c) ?r a ?c }",
    "SELECT ?r { ?r a ?c FILTER(?c = ros:Property) }",
    "SELECT ?r { ?r a ?c FILTER(?c IN (ros:Property)) }",
    "SELECT ?r { { SELECT ?r ?c { ?r a ?c } } FILTER(sameTerm(?c, ros:Property)) }",
    "SELECT ?r { GRAPH ?g { ?r a ros:Property } }",
]
OF_A_RESOURCE = [
    f"SELECT ?v {{ {POWER} rdf:value ?v }}",
    f"SELECT ?v {{ VALUES ?r {{ {POWER} }} ?r rdf:value ?v }}",
    f"SELECT ?v {{ ?r rdf:value ?v FILTER(?r = {POWER}) }}",
    f"SELECT ?v {{ ?v ^rdf:value {POWER} }}",
    f"SELECT ?v {{ GRAPH {POWER} {{ ?r rdf:value ?v }} }}",
    f"SELECT ?v {{ GRAPH ?r {{ ?r rdf:value ?v }} FILTER(?r = {POWER}) }}",
    f"SELECT ?v FROM {POWER} {{ ?r rdf:value ?v }}",
    f"SELECT ?v {{ ?r ?p ?v FILTER(?r = {POWER} && ?p = rdf:value) }}",
]
OF_A_TOPIC = [
    f"SELECT ?v {{ {SPEED} ros:latest/{DATA} ?v }}",
    f"SELECT ?v {{ VALUES ?t {{ {SPEED} }} ?t ros:latest/{DATA} ?v }}",
    f"SELECT ?v {{ ?t ros:latest ?m . ?m ?p ?v FILTER(?t = {SPEED} && STRENDS(STR(?p), '#data')) }}",
    f"SELECT ?v {{ ?m {DATA} ?v . ?t ros:latest ?m }}",
    f"SELECT ?v {{ GRAPH ?g {{ ?m {DATA} ?v }} FILTER(?g = {SPEED}) }}",
    f"SELECT ?v {{ ?t ros:hasMessageType ?k ; ros:latest ?m . ?m ?p ?v FILTER(?k = {FLOAT} && ?p = {DATA}) }}",
    f"SELECT ?v {{ OPTIONAL {{ {SPEED} ros:latest ?m OPTIONAL {{ ?m {DATA} ?v }} }} }}",
    f"SELECT ?v {{ {SPEED} (ros:latest|ros:latestFrom)/{DATA} ?v }}",
]


@pytest.mark.parametrize("spellings", [OF_PROPERTIES, OF_A_RESOURCE])
def test_equivalent_spellings_give_equal_answers(http: httpx.Client, spellings: list[str]) -> None:
    answers = [ask(http, query)[0] for query in spellings]
    assert answers[0]
    assert answers == [answers[0]] * len(answers)


@pytest.mark.parametrize("query", OF_A_TOPIC)
def test_equivalent_spellings_subscribe_to_what_they_name(start_server: Callable[..., Any], query: str) -> None:
    served = start_server("aircraft")  # where nobody has asked for anything before
    found = ask(served.http, query)[0]
    assert found
    assert found == ask(served.http, OF_A_TOPIC[0])[0]
    assert served.stop() == 0


def test_what_clients_say_of_live_resources_hides_none_of_them(start_server: Callable[..., Any]) -> None:
    served = start_server("aircraft")
    http = served.http
    claim = f"<{http.base_url}topics/aircraft/engine/speed> a <http://example.org/Sensor> ; <http://e.org/v> 1 ."
    queries = [
        f"SELECT ?v {{ ?t ros:latest ?m . ?m {DATA} ?v }}",
        f"SELECT ?v {{ {SPEED} ros:latest ?m . ?m {DATA} ?v }}",
        "SELECT ?t { ?t a ros:Topic ; ros:name '/aircraft/engine/speed' OPTIONAL { ?t ros:rate ?r } }",
    ]
    before = [ask(http, query)[0] for query in queries]
    assert all(before)
    assert http.put("/data/claims/1", content=claim, headers=TURTLE).is_success
    other = f"<{http.base_url}topics/cockpit/display> <https://w3id.org/rosld#hasMessageType> {FLOAT} ."
    assert http.put("/data/claims/2", content=other, headers=TURTLE).is_success
    assert [ask(http, query)[0] for query in queries] == before
    assert len(ask(http, f"SELECT * {{ ?t ros:hasMessageType {FLOAT} OPTIONAL {{ ?t ros:rate ?r }} }}")[0]) == 2
    assert served.stop() == 0
