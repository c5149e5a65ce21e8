"""A query has the same complete result in any form, or it is refused."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from xml.etree import ElementTree

import httpx
import pytest

from rosld.adapters.base import AdapterOptions
from rosld.adapters.registry import adapter_for
from tests.server.robots.asking import TYPES
from tests.server.robots.made_up import MadeUp, served
from tests.waiting import until

pytestmark = pytest.mark.slow

ALL = "SELECT * { ?s ?p ?o }"
TURTLE = {"Content-Type": "text/turtle"}
STRING = "std_msgs/msg/String"


@pytest.fixture(scope="module")
def http() -> Iterator[httpx.Client]:
    with served(adapter_for("aircraft", AdapterOptions())) as client:
        yield client


def ask(http: httpx.Client, query: str) -> list[list[str]]:
    """Return the sorted rows of a SELECT."""
    answer = http.get("/sparql", params={"query": query}, headers={"Accept": "text/csv"})
    assert answer.status_code == 200, answer.text
    return sorted(list(csv.reader(io.StringIO(answer.text)))[1:])


def test_a_query_that_would_be_incomplete_is_refused_unless_it_takes_a_part() -> None:
    robot = MadeUp()
    for name in ("/one", "/two"):
        robot.topic(name, STRING, {"data": name})
    with served(robot, subscription_budget=1) as http:
        refused = http.get("/sparql", params={"query": ALL})
        assert refused.status_code == 503
        assert refused.json()["reason"] == "incomplete"
        for words in (f"<{http.base_url}topics/one>", "the setting subscription_budget is 1", "?partial=true"):
            assert words in refused.json()["detail"]
        partial = http.get("/sparql", params={"query": ALL, "partial": "true"}, headers={"Accept": "text/csv"})
        assert partial.status_code == 200
        assert f'"{http.base_url}topics/two"' in partial.headers["unread-graphs"]
        unread = [each.strip('"') for each in partial.headers["unread-graphs"].split(", ")]
        for query in (ALL, f"ASK {ALL[9:]}"):
            asked = {"query": query, "partial": "true"}
            assert http.get("/sparql", params=asked).json()["head"]["link"] == unread
            xml = ElementTree.fromstring(http.get("/sparql", params={**asked, "format": "xml"}).content)
            assert [each.get("href") for each in xml[0] if each.tag.endswith("}link")] == unread
        page = http.get("/sparql", params={"query": ALL, "partial": "true"}, headers={"Accept": "text/html"})
        assert "The answer is partial." in page.text
        assert 'name="partial" value="true" checked' in page.text
        assert 'name="partial" value="true">' in http.get("/sparql", headers={"Accept": "text/html"}).text
        assert http.post("/sparql", data={"query": ALL, "partial": "true"}).status_code == 200
        assert http.get("/sparql", params={"query": ALL, "partial": "perhaps"}).status_code == 400
        assert ask(http, f"SELECT ?v {{ GRAPH <topics/two> {{ ?m <{TYPES}{STRING}#data> ?v }} }}") == [["/two"]]


def test_what_takes_no_reading_of_the_robot_is_there_for_every_query(http: httpx.Client) -> None:
    parts = "SELECT (COUNT(DISTINCT ?r) AS ?n) { ?r dcterms:isPartOf ?x }"
    assert ask(http, parts) == ask(http, parts.replace(" }", " . ?r a ?any }"))
    offers = "SELECT DISTINCT ?r { ?r td:hasPropertyAffordance ?a }"
    assert set(map(tuple, ask(http, "SELECT ?r { ?r a ros:Property }"))) <= set(map(tuple, ask(http, offers)))
    typed = "SELECT ?r { <resources/cockpit/> ldp:contains ?r FILTER NOT EXISTS { ?r a ?type } }"
    assert ask(http, typed) == []
    assert len(ask(http, "SELECT ?r { GRAPH <topics/> { ?r ros:name ?n } }")) > 1


def test_names_of_graphs_are_found_without_a_triple_pattern(http: httpx.Client) -> None:
    url = f"{http.base_url}data/named"
    assert ask(http, "SELECT ?g { GRAPH ?g {} }")
    assert http.put("/data/named", content="<> <urn:p> 1 .", headers=TURTLE).status_code == 201
    assert [url] in ask(http, "SELECT ?g { GRAPH ?g {} }")
    assert http.delete("/data/named").status_code == 204
    assert [url] not in ask(http, "SELECT ?g { GRAPH ?g {} }")


SPEED, POWER = "<topics/aircraft/engine/speed>", "<resources/aircraft/power>"
FLOAT, DATA = f"<{TYPES}std_msgs/msg/Float64>", f"<{TYPES}std_msgs/msg/Float64#data>"
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
        answers = [ask(http, query) for query in spellings]
        assert answers[0]
        assert answers == [answers[0]] * len(answers)


def test_equivalent_spellings_subscribe_to_what_they_name() -> None:
    for query in OF_A_TOPIC:
        with served(adapter_for("aircraft", AdapterOptions())) as http:  # where no request has been sent before
            found = ask(http, query)
            assert found, query
            assert found == ask(http, OF_A_TOPIC[0]), query


def test_data_of_clients_about_live_resources_hides_none_of_them(http: httpx.Client) -> None:
    claim = f"<{http.base_url}topics/aircraft/engine/speed> a <http://example.org/Sensor> ; <http://e.org/v> 1 ."
    queries = [
        f"SELECT ?v {{ ?t ros:latest ?m . ?m {DATA} ?v }}",
        f"SELECT ?v {{ {SPEED} ros:latest ?m . ?m {DATA} ?v }}",
        "SELECT DISTINCT ?t { ?t a ros:Topic ; ros:name '/aircraft/engine/speed' OPTIONAL { ?t ros:rate ?r } }",
    ]
    before = [ask(http, query) for query in queries]
    assert all(before)
    assert http.put("/data/claims/1", content=claim, headers=TURTLE).is_success
    other = f"<{http.base_url}topics/cockpit/display> <https://w3id.org/rosld#hasMessageType> {FLOAT} ."
    assert http.put("/data/claims/2", content=other, headers=TURTLE).is_success
    assert [ask(http, query) for query in queries] == before
    assert len(ask(http, f"SELECT DISTINCT ?t {{ ?t ros:hasMessageType {FLOAT} OPTIONAL {{ ?t ros:rate ?r }} }}")) == 2


def test_a_topic_has_one_rate_at_a_time_although_its_listing_says_it_too(http: httpx.Client) -> None:
    until(lambda: ask(http, f"SELECT ?r {{ {SPEED} ros:latest ?m ; ros:rate ?r }}"), "a rate")
    for attempt in range(30):
        graphs = ask(http, f"SELECT ?g ?r {{ GRAPH ?g {{ ?t ros:rate ?r }} }} # {attempt}")
        rates = ask(http, f"SELECT ?t ?r {{ ?t a ros:Topic ; ros:rate ?r }} # {attempt}")
        assert (len(graphs), len({row[1] for row in graphs}), len(rates)) == (2, 1, 1)
