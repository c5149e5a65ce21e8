"""Sensors, observations and actuations over HTTP, on a robot without mappings."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from typing import Any

import httpx
import pytest

pytestmark = pytest.mark.slow

TURTLE = {"Accept": "text/turtle"}
WITH_UNITS = """SELECT ?sensor ?value ?unit {
    ?sensor a sosa:Sensor ; sosa:observes quantitykind:Temperature .
    ?o sosa:madeBySensor ?sensor ; sosa:observedProperty ?property ; sosa:hasSimpleResult ?value .
    ?property qudt:hasQuantityKind quantitykind:Temperature ; qudt:hasUnit ?unit
}"""


@pytest.fixture(scope="module")
def rover(start_server: Callable[..., Any]) -> httpx.Client:
    http: httpx.Client = start_server("rover:").http
    return http


def ask(http: httpx.Client, query: str) -> list[list[str]]:
    """Return the rows of a SELECT."""
    answer = http.post("/sparql", data={"query": query}, headers={"Accept": "text/csv"})
    assert answer.status_code == 200, answer.text
    return list(csv.reader(io.StringIO(answer.text)))[1:]


def test_what_measures_temperature_in_which_unit_and_what_was_observed_last(rover: httpx.Client) -> None:
    ((sensor, value, unit),) = ask(rover, WITH_UNITS)
    assert sensor == f"{rover.base_url}topics/battery_state#sensor"
    assert 0 < float(value) < 60
    assert unit == "http://qudt.org/vocab/unit/DEG_C"


def test_a_query_for_observations_right_after_one_without_them_has_them_all(rover: httpx.Client) -> None:
    for _ in range(5):
        assert ask(rover, "SELECT ?t ?m { ?t ros:latest ?m }")
        sensors = {row[0] for row in ask(rover, "SELECT DISTINCT ?s { ?o a sosa:Observation ; sosa:madeBySensor ?s }")}
        assert sensors >= {f"{rover.base_url}topics/{name}#sensor" for name in ("battery_state", "imu", "odom", "scan")}
    everything = ask(rover, "SELECT ?p { <topics/imu#message~orientation> ?p ?o }")
    assert len(everything) == 8


def test_an_update_that_reads_observations_writes(rover: httpx.Client) -> None:
    ask(rover, WITH_UNITS)
    insert = "INSERT { GRAPH <data/hot> { ?o a <urn:Hot> } } WHERE { ?o a sosa:Observation ; sosa:hasSimpleResult ?v }"
    update = {"Content-Type": "application/sparql-update"}
    assert rover.post("/sparql", content=insert, headers=update).status_code < 300
    assert "urn:Hot" in rover.get("/data/hot", headers=TURTLE).text
    assert rover.delete("/data/hot").is_success


def test_a_command_is_an_actuation_with_its_receipt(rover: httpx.Client) -> None:
    answer = rover.put("/topics/cmd_vel", json={"linear": {"x": 0.1}})
    assert answer.status_code == 204
    by = f"?a sosa:madeByActuator <{rover.base_url}topics/cmd_vel#actuator>"
    receipt_of = "sosa:resultTime ?t ; sosa:hasSimpleResult ?command ; prov:wasInformedBy ?receipt"
    ((command, receipt),) = ask(rover, f"SELECT ?command ?receipt {{ {by} ; {receipt_of} }}")
    assert command == '{"linear":{"x":0.1}}'
    assert receipt in answer.headers["Link"]
    x = "<https://w3id.org/rosld/types/geometry_msgs/msg/Vector3#x>"
    last = ask(rover, f"SELECT ?p ?x {{ {by} ; sosa:actsOnProperty ?p ; sosa:hasResult ?r . ?r {x} ?x }}")
    assert dict(last)["https://w3id.org/rosld/types/geometry_msgs/msg/Twist#linear"] == "0.1"
    rover.put("/topics/cmd_vel", json={})


def test_what_was_read_with_observations_can_be_sent_back(rover: httpx.Client) -> None:
    rover.put("/topics/cmd_vel", json={"linear": {"x": 0.05}})
    body = rover.get("/topics/cmd_vel", headers=TURTLE).text
    assert "sosa:Actuation" in body
    answer = rover.put("/topics/cmd_vel", content=body, headers={"Content-Type": "text/turtle"})
    assert answer.status_code == 204, answer.text
    rover.put("/topics/cmd_vel", json={})
