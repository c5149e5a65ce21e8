"""However a query is spelled it answers the same, or says which graphs it did not look at."""

from __future__ import annotations

import csv
import io

import httpx
import pytest

from rosld.adapters.base import AdapterOptions
from rosld.adapters.registry import adapter_for
from tests.server.robots.made_up import served

pytestmark = pytest.mark.slow

ALL = "SELECT * { ?s ?p ?o }"
TURTLE = {"Content-Type": "text/turtle"}


@pytest.fixture
def http(own_aircraft: httpx.Client) -> httpx.Client:
    """An aircraft, none of whose topics is subscribed to until a query needs them."""
    return own_aircraft


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


def test_a_query_says_which_containers_it_did_not_read(http: httpx.Client) -> None:
    assert "topics;count=2" in ask(http, ALL)[1]
    assert unread(http, "SELECT * { ?t a ros:Topic ; ros:rate ?r }") == {"topics"}
    assert unread(http, "SELECT * { <topics/aircraft/engine/speed> ros:rate ?r }") == set()
    assert "topics;count=1" in ask(http, ALL)[1]
    http.put("/topics/cockpit/display", json={"data": "x"})
    assert "topics" not in unread(http, ALL)
    for query in (
        "SELECT * { ?t a ros:Topic }",
        "SELECT * { ?n ros:publishes ?t }",
        "SELECT * { ?n a ros:Node ; ?p ?o }",
        "SELECT * { ?r a ros:Property ; ros:name ?n }",
        "SELECT * { GRAPH <resources/aircraft/power> { ?r ?p ?v } }",
    ):
        assert unread(http, query) == set(), query
    for query in (ALL, "SELECT * { ?r ?p 'off' }", "SELECT * { GRAPH ?g { ?r dcterms:isPartOf ?c } }"):
        assert "resources" in unread(http, query), query


def test_the_page_says_so_too(http: httpx.Client) -> None:
    for query, words in (
        (ALL, "Not looked at, as the query does not name them:"),
        ("SELECT * { ?r ?p 'off' }", "below /resources/"),
        ("SELECT * { ?c ldp:contains ?r }", "Not looked at"),
    ):
        assert words in http.get("/sparql", params={"query": query}, headers={"Accept": "text/html"}).text
    named = {"query": "SELECT * { ?t a ros:Topic }"}
    assert "Not looked at" not in http.get("/sparql", params=named, headers={"Accept": "text/html"}).text


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
    f"SELECT ?v {{ ?t ros:latest ?m . ?m ?p ?v FILTER(?t = {SPEED} && STRENDS(STR(?p), '#data')) }}",
    f"SELECT ?v {{ GRAPH ?g {{ ?m {DATA} ?v }} FILTER(?g = {SPEED}) }}",
    f"SELECT ?v {{ ?t ros:hasMessageType ?k ; ros:latest ?m . ?m ?p ?v FILTER(?k = {FLOAT} && ?p = {DATA}) }}",
    f"SELECT ?v {{ OPTIONAL {{ {SPEED} ros:latest ?m OPTIONAL {{ ?m {DATA} ?v }} }} }}",
    f"SELECT ?v {{ {SPEED} (ros:latest|ros:latestFrom)/{DATA} ?v }}",
]


def test_equivalent_spellings_give_equal_answers(http: httpx.Client) -> None:
    for spellings in (OF_PROPERTIES, OF_A_RESOURCE):
        answers = [ask(http, query)[0] for query in spellings]
        assert answers[0]
        assert answers == [answers[0]] * len(answers)


def test_equivalent_spellings_subscribe_to_what_they_name() -> None:
    for query in OF_A_TOPIC:
        with served(adapter_for("aircraft", AdapterOptions())) as http:  # where nobody has asked for anything before
            found = ask(http, query)[0]
            assert found, query
            assert found == ask(http, OF_A_TOPIC[0])[0], query


def test_data_of_clients_about_live_resources_hides_none_of_them(http: httpx.Client) -> None:
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
