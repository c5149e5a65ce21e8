"""Listings: name, type, rate and latest value of each member, in RDF and in JSON, as far as they are known."""

from __future__ import annotations

import json
from typing import Any

import httpx
import pytest
from pyoxigraph import Literal, NamedNode, Triple

from rosld.adapters.model import Action, TypeRef
from rosld.ontology.vocab import ldp, rdf, ros
from tests.server.robots.asking import JSON, LDP, TYPES, objects, triples
from tests.server.robots.made_up import MadeUp, Serving
from tests.server.robots.many import COUNT, furnish
from tests.waiting import until

pytestmark = pytest.mark.slow

RDF = {"Accept": "text/turtle"}
RESULTS = {"Accept": "application/sparql-results+json"}


@pytest.fixture
def http(robot: MadeUp, serving: Serving) -> httpx.Client:
    robot.topic("/speed", "std_msgs/msg/Float64", {"data": 1.5})
    robot.topic("/camera/image", "sensor_msgs/msg/Image", {"height": 2, "data": "AAAA"})
    robot.offer("/dock", "std_srvs/srv/Trigger", lambda _: {"success": True})
    robot.strange(Action("/fly", TypeRef("made_up/action/Fly")))
    return serving()


def said(http: httpx.Client, path: str, member: str) -> dict[str, str]:
    """Return the statements of a listing about a member, by the names of the properties."""
    subject = NamedNode(f"{http.base_url}{member}")
    return {
        each.predicate.value.rpartition("#")[2]: getattr(each.object, "value", "")
        for each in triples(http.get(path, headers=RDF))
        if each.subject == subject
    }


def count(http: httpx.Client, pattern: str) -> int:
    query = f"PREFIX ros: <{ros.iri}> SELECT (COUNT(*) AS ?n) WHERE {{ {pattern} }}"
    answer = http.post("/sparql", data={"query": query}, headers=RESULTS)
    assert answer.status_code == 200, answer.text
    return int(answer.json()["results"]["bindings"][0]["n"]["value"])


def test_names_and_types_of_members_are_told(http: httpx.Client) -> None:
    speed = {"type": f"{ros.iri}Topic", "name": "/speed", "label": "/speed"}
    speed["hasMessageType"] = f"{TYPES}std_msgs/msg/Float64"
    assert said(http, "/topics/", "topics/speed") == speed
    assert said(http, "/topics/", "topics/camera/") == {"name": "/camera", "label": "Topics in /camera"}
    assert said(http, "/services/", "services/dock")["hasServiceType"] == f"{TYPES}std_srvs/srv/Trigger"
    assert said(http, "/actions/", "actions/fly")["hasActionType"] == f"{TYPES}made_up/action/Fly"
    assert said(http, "/nodes/", "nodes/robot") == {"type": f"{ros.iri}Node", "name": "/robot", "label": "/robot"}


def test_values_and_rates_are_told_of_what_is_subscribed_to(robot: MadeUp, http: httpx.Client) -> None:
    http.get("/topics/speed")
    http.get("/topics/camera/image")
    assert json.loads(said(http, "/topics/", "topics/speed")["briefValue"]) == {"data": 1.5}
    image = json.loads(said(http, "/topics/camera/", "topics/camera/image")["briefValue"])
    assert (image["height"], image["..."]) == (2, "more")
    assert "rate" not in said(http, "/topics/", "topics/speed")  # it is not measured yet

    def rate() -> float | None:
        robot.publishes("/speed", {"data": 4.0})
        return float(said(http, "/topics/", "topics/speed").get("rate", "0"))

    assert until(rate, "a rate that was measured")
    assert json.loads(said(http, "/topics/", "topics/speed")["briefValue"]) == {"data": 4.0}


def test_what_is_recorded_has_values_in_lists_and_rates_in_queries_and_no_rate_is_told_that_was_not_measured(
    robot: MadeUp, serving: Serving
) -> None:
    robot.topic("/speed", "std_msgs/msg/Float64", {"data": 1.5})
    robot.topic("/silent", "std_msgs/msg/Float64")
    http = serving(history=("/speed",))
    query = f"PREFIX ros: <{ros.iri}> SELECT ?t ?rate {{ ?t a ros:Topic ; ros:rate ?rate }}"
    assert http.post("/sparql", data={"query": query}, headers=RESULTS).json()["results"]["bindings"] == []

    def told() -> dict[str, str]:
        robot.publishes("/speed", {"data": 2.5})
        found = said(http, "/topics/", "topics/speed")
        return found if "rate" in found else {}

    assert json.loads(until(told, "the rate of a topic that is recorded")["briefValue"]) == {"data": 2.5}
    [row] = http.post("/sparql", data={"query": query}, headers=RESULTS).json()["results"]["bindings"]
    assert row["t"]["value"].endswith("/topics/speed")
    assert float(row["rate"]["value"]) > 0
    [fastest] = http.get("/queries/fastest-topics", headers=RESULTS).json()["results"]["bindings"]
    assert fastest["name"]["value"] == "/speed"

    def latest() -> list[object]:
        asked = {"query": f"SELECT ?m {{ ?t <{ros.latest.value}> ?m }}"}
        return list(http.post("/sparql", data=asked, headers=RESULTS).json()["results"]["bindings"])

    assert latest()


def test_json_says_the_same_with_another_entity_tag_when_a_value_comes(robot: MadeUp, http: httpx.Client) -> None:
    http.get("/topics/speed")
    answer = http.get("/topics/", headers=JSON)
    listing: dict[str, Any] = answer.json()
    members = {each["@id"]: each for each in listing["ldp:contains"]}
    assert members.keys() == {f"{http.base_url}topics/speed", f"{http.base_url}topics/camera/"}
    speed = members[f"{http.base_url}topics/speed"]
    assert (speed["name"], speed["hasMessageType"]) == ("/speed", f"{TYPES}std_msgs/msg/Float64")
    assert json.loads(speed["briefValue"]) == {"data": 1.5}
    contained = objects(http.get("/topics/", headers=RDF), f"{LDP}contains")
    assert contained == members.keys()
    known = {**RDF, "If-None-Match": http.get("/topics/", headers=RDF).headers["etag"]}
    assert http.get("/topics/", headers=known).status_code == 304
    robot.publishes("/speed", {"data": 2.5})
    answer = http.get("/topics/", headers=known)
    assert answer.status_code == 200
    assert "2.5" in answer.text


def test_a_long_listing_subscribes_to_nothing_has_pages_and_is_in_the_dataset_once(
    robot: MadeUp, serving: Serving
) -> None:
    furnish(robot)
    http = serving(faults="quiet")
    for format in ("ttl", "json", "html"):
        assert http.get("/topics/", params={"format": format}).status_code == 200
    assert robot.subscribed() == set()
    page = http.get("/topics/", headers={**RDF, "Prefer": 'return=representation; max-member-count="50"'})
    assert page.status_code == 303
    found = triples(http.get(page.headers["location"], headers=RDF))
    contained = {each.object for each in found if each.predicate == ldp.contains}
    named = {each.subject for each in found if each.predicate == ros.name}
    assert (len(contained), named) == (50, contained)
    typed = "?topic ros:hasMessageType ?type"
    assert count(http, typed) == COUNT
    members = objects(http.get("/topics/", headers=RDF), f"{LDP}contains")
    topics = [url for url in members if not url.endswith("/")]
    assert count(http, f"GRAPH <{http.base_url}topics/> {{ {typed} }}") == len(topics)


def test_what_is_brief_is_json(robot: MadeUp, serving: Serving) -> None:
    furnish(robot)
    robot.publishes("/imu", {})
    robot.publishes("/scan", {"ranges": [1.0] * 720})
    http = serving(subscribe=("/*",))
    values = [
        each.object
        for each in triples(http.get("/topics/", headers=RDF))
        if isinstance(each, Triple) and each.predicate == ros.briefValue
    ]
    assert len(values) == 2
    for value in values:
        assert isinstance(value, Literal)
        assert value.datatype == rdf.JSON
        assert len(value.value) <= 250
        assert isinstance(json.loads(value.value), dict)
