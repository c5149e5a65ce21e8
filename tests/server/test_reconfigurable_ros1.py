"""Parameters of ROS 1 over HTTP: those of dynamic_reconfigure take effect, all others state that they may not."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import pyshacl
import pytest
import rdflib
from rdflib.namespace import DCTERMS, RDFS, SH

from tests.adapters.ros1.system import require, running
from tests.waiting import until

pytestmark = pytest.mark.slow

ROS = rdflib.Namespace("https://w3id.org/rosld#")
JSON = {"Accept": "application/json"}
TURTLE = {"Accept": "text/turtle"}
HTML = {"Accept": "text/html"}
MERGE = {"Content-Type": "application/merge-patch+json"}
AT_START = "Stored by the parameter server: nodes may read it only when they start."


@pytest.fixture(scope="module")
def http(tmp_path_factory: pytest.TempPathFactory, start_server: Callable[..., Any]) -> Iterator[httpx.Client]:
    """A client of rosld on a system with an arm that has servers of dynamic_reconfigure."""
    require("a server of dynamic_reconfigure", "dynamic_reconfigure.server")
    with running(tmp_path_factory.mktemp("ros")) as system:
        system.node("reconfigurable_node.py")
        client: httpx.Client = start_server(system.source).http
        for name in ("speed", "gripper/force"):
            until(lambda name=name: "?shape" in client.get(f"/parameters/arm/{name}").headers.get("link", ""), name)
        yield client


def state(http: httpx.Client) -> dict[str, Any]:
    """Return the arm's own report of its configuration."""
    found: dict[str, Any] = json.loads(http.get("/topics/arm/state", headers=JSON).json()["data"])
    return found


def described(http: httpx.Client, name: str) -> tuple[rdflib.Graph, rdflib.URIRef]:
    """Return the document of a parameter, and the parameter."""
    answer = http.get(f"/parameters/arm/{name}", headers=TURTLE)
    return rdflib.Graph().parse(data=answer.text, format="turtle"), rdflib.URIRef(str(answer.url))


def test_a_parameter_says_what_its_node_declares_and_which_nodes_may_not_heed(http: httpx.Client) -> None:
    found, speed = described(http, "speed")
    assert str(found.value(speed, DCTERMS.description)) == "How fast it moves, in rad/s."
    assert str(found.value(speed, ROS.parameterType)) == "double"
    assert found.value(speed, RDFS.comment) is None
    (value,) = found.objects(found.value(predicate=SH.targetNode, object=speed), SH.property)
    bounds = (found.value(value, SH.minInclusive), found.value(value, SH.maxInclusive))
    assert [each.toPython() for each in bounds] == [0.0, 2.0]
    assert "PUT" in http.options(str(speed)).headers["allow"]
    assert "DELETE" not in http.options(str(speed)).headers["allow"]
    assert str(speed) in http.get("/nodes/arm", headers=TURTLE).text
    found, frame = described(http, "frame")
    assert str(found.value(frame, RDFS.comment)) == AT_START
    assert AT_START in http.get("/parameters/arm/frame", headers=HTML).text
    assert AT_START not in http.get("/parameters/arm/speed", headers=HTML).text
    assert http.put("/parameters/arm/frame", json="tool").status_code == 204


def test_an_enumeration_is_a_shape_and_a_choice(http: httpx.Client) -> None:
    found, mode = described(http, "mode")
    (property,) = found.objects(found.value(predicate=SH.targetNode, object=mode), SH.property)
    words = {"Slow = 0: For people nearby", "Fast = 1", "Broken = 3: Never"}
    assert {str(each) for each in found.objects(property, RDFS.comment)} == words
    for value, good in ((0, True), (2, False), (3, True), ("Slow", False)):
        found.set((mode, ROS.value, rdflib.Literal(value)))
        assert pyshacl.validate(found, shacl_graph=found)[0] is good
    page = http.get("/parameters/arm/mode", headers=HTML).text
    assert page.count("<option") == 3
    refused = http.put("/parameters/arm/mode", json=3)
    assert refused.status_code == 422
    assert "this mode is broken" in refused.json()["robotSaid"]
    assert http.get("/parameters/arm/mode", headers=JSON).json() == 0


def test_the_answer_is_what_the_node_made_of_a_value(http: httpx.Client) -> None:
    answer = http.put("/parameters/arm/speed", json=0.6, headers=JSON)
    assert (answer.status_code, answer.json()) == (200, 0.5)
    assert answer.headers["content-location"] == str(answer.url)
    assert "etag" not in answer.headers
    assert http.get("/parameters/arm/speed", headers=JSON).json() == 0.5
    assert http.put("/parameters/arm/speed", json=1, headers=JSON).status_code == 204
    assert http.put("/parameters/arm/speed", json=0.6, headers={**JSON, "Prefer": "return=minimal"}).status_code == 204
    answer = http.put("/resources/arm/speed", json=1.4, headers=JSON)
    assert (answer.status_code, answer.json()) == (200, 1.5)


def test_what_is_set_takes_effect_together_and_what_does_not_fit_is_not_sent(http: httpx.Client) -> None:
    patch = {"joints": 7, "tool": "gripper", "enabled": False}
    assert http.patch("/parameters/arm/", json=patch, headers=MERGE).status_code == 204
    until(lambda: patch.items() <= state(http).items(), "all three")
    answer = http.patch("/parameters/arm/", json={"speed": 0.6, "joints": 6}, headers={**MERGE, **JSON})
    assert answer.status_code == 200
    assert {"speed": 0.5, "joints": 6}.items() <= answer.json().items()
    for place in ("parameters", "resources"):
        refused = http.put(f"/{place}/arm/speed", json=2.5)
        assert (refused.status_code, "must be at most 2.0, not 2.5" in refused.json()["detail"]) == (422, True)
    assert http.get("/parameters/arm/speed", headers=JSON).json() == 0.5
