"""Actions of ROS that a mapping offers: their goals are sent where the affordance says, while its conditions hold."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import httpx
import pytest

from rosld.adapters.base import AdapterOptions
from rosld.adapters.registry import adapter_for
from tests.server.robots.made_up import served

PREFIXES = """
@prefix map: <https://w3id.org/rosld/mapping#> . @prefix ex: <http://example.org/> .
@prefix sh: <http://www.w3.org/ns/shacl#> . @prefix rdf: <http://www.w3.org/1999/02/22-rdf-syntax-ns#> .
"""
MAPPING = """
<#aircraft> a map:ComplexResource ; map:path "/aircraft/" ;
  map:property [ map:predicate ex:power ; map:member "power" ] ;
  map:action [ map:relation ex:go ; map:name "go" ; map:service "fly" ; map:availableWhen <#on> ] .
<#on> a sh:NodeShape ; map:about "/aircraft/power" ; sh:property [ sh:path rdf:value ; sh:hasValue "on" ] .
"""
JSON = {"Accept": "application/json"}
TURTLE = {"Accept": "text/turtle"}
GO = "/resources/aircraft/go"


@pytest.fixture(scope="module")
def http() -> Iterator[httpx.Client]:
    """An aircraft whose mapping offers its action while its power is on."""
    with served(adapter_for("aircraft", AdapterOptions())) as client:
        client.delete("/mappings/aircraft").raise_for_status()
        mapping = client.put("/mappings/mine", content=PREFIXES + MAPPING, headers={"Content-Type": "text/turtle"})
        assert mapping.status_code == 201, mapping.text
        yield client


def power(http: httpx.Client, word: str) -> None:
    http.put("/resources/aircraft/power", json=word).raise_for_status()


def test_a_mapped_action_of_ros_takes_goals_while_its_conditions_hold(http: httpx.Client) -> None:
    power(http, "off")
    assert http.get(GO).status_code == 404
    assert http.options(GO).headers["allow"] == "DELETE, OPTIONS, POST"
    assert http.post(GO, json={"distance": 2}).status_code == 409
    assert http.post(GO, json={"distance": "far"}).status_code == 422
    power(http, "on")
    assert http.post(GO, json={"distance": "far"}).status_code == 422
    assert "ldp:contains" not in http.get("/goals/", headers=TURTLE).text
    told = http.get("/resources/aircraft/", headers=TURTLE).text
    assert "<http://example.org/go> <" in told
    assert "td:hasActionAffordance <#actions/go>" in told
    assert "Fly_Goal" in told
    action = http.get(GO, headers=TURTLE)
    assert action.status_code == 200
    assert f"ros:invokes <{http.base_url}actions/aircraft/fly>" in action.text
    assert http.options(GO).headers["allow"] == "DELETE, GET, HEAD, OPTIONS, POST"
    sent = http.post(GO, json={"distance": 2}, headers=JSON)
    assert sent.status_code == 201, sent.text
    goal: dict[str, Any] = http.get(sent.headers["location"], headers=JSON).json()
    assert (goal["action"], goal["goal"]) == ("/aircraft/fly", {"distance": 2.0})
    page = http.get("/resources/aircraft/", headers={"Accept": "text/html"}).text
    assert 'name="distance' in page


def test_descriptions_say_that_goals_are_sent(http: httpx.Client) -> None:
    operation = http.get("/openapi.json").json()["paths"][GO]["post"]
    assert "201" in operation["responses"]
    thing = http.get("/resources/aircraft/", headers={"Accept": "application/td+json"}).json()
    go = thing["actions"]["go"]
    assert go["synchronous"] is False
    assert go["input"]["properties"].keys() == {"distance"}
    assert go["forms"][0]["href"] == f"{http.base_url}resources/aircraft/go"
    rows = http.post(
        "/sparql",
        data={"query": "SELECT ?t { ?r td:hasActionAffordance ?a . ?a td:name 'go' ; td:hasForm/hctl:hasTarget ?t }"},
        headers={"Accept": "text/csv"},
    )
    assert rows.status_code == 200
