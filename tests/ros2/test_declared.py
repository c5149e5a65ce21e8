"""What real nodes declare of their parameters, over HTTP: read as RDF and SHACL, held before anything is sent."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pyshacl
import pytest
import rdflib
from rdflib.namespace import SH

from tests.ros2.system import running
from tests.server.conftest import servers
from tests.waiting import until

TESTS = Path(__file__).parents[1]
ROBOT = TESTS / "adapters" / "ros2" / "nodes" / "robot.py"
LAMP = "/parameters/lamp/"
LEVEL = f"{LAMP}level"
ROS = rdflib.Namespace("https://w3id.org/rosld#")
JSON = {"accept": "application/json"}
MERGE = {"content-type": "application/merge-patch+json"}

pytestmark = pytest.mark.ros2


@pytest.fixture(scope="module")
def http() -> Iterator[httpx.Client]:
    """A client of the robot, its lamp as it is at first."""
    with running("kilted") as system, servers() as start:
        system.node(str(ROBOT))
        client: httpx.Client = start(system.source, python=system.python, environment=system.environment).http
        for path in (LEVEL, "/parameters/listener/seats"):
            until(lambda path=path: "?shape" in client.get(path).headers.get("link", ""), path)
        yield client


def values(http: httpx.Client) -> dict[str, Any]:
    found: dict[str, Any] = http.get(LAMP, headers=JSON).json()
    return {name: found[name] for name in ("level", "gain", "serial")}


def graph(http: httpx.Client, path: str) -> rdflib.Graph:
    return rdflib.Graph().parse(data=http.get(path, headers={"accept": "text/turtle"}).text, format="turtle")


def test_a_parameter_says_what_its_node_declares_and_its_shape_judges_it(http: httpx.Client) -> None:
    found = graph(http, LEVEL)
    (subject,) = found.subjects(ROS.value)
    assert str(found.value(subject, rdflib.DCTERMS.description)) == "How bright it is."
    assert len(list(found.subjects(SH.targetNode, subject))) == 1
    assert f'<{subject}?shape>; rel="http://www.w3.org/ns/ldp#constrainedBy"' in http.get(LEVEL).headers["link"]
    for value, good in ((0, True), (20, True), (25, False), (7, False), (0.5, False)):
        found.set((subject, ROS.value, rdflib.Literal(value)))
        assert pyshacl.validate(found, shacl_graph=found)[0] is good, value
    gain = graph(http, f"{LAMP}gain")
    assert [each.toPython() for each in gain.objects(None, ROS.step)] == [0.1]  # type: ignore[union-attr, attr-defined]


def test_every_parameter_conforms_to_its_own_shape(http: httpx.Client) -> None:
    for node in ("lamp", "listener", "free"):
        for name in http.get(f"/parameters/{node}/", headers=JSON).json():
            found = graph(http, f"/parameters/{node}/{name}")
            conforms, _, words = pyshacl.validate(found, shacl_graph=found)
            assert conforms, words


@pytest.mark.parametrize(
    ("path", "methods"),
    [
        ("level", {"PUT", "PATCH"}),
        ("serial", set()),
        ("any", {"PUT", "PATCH", "DELETE"}),
    ],
)
def test_allow_is_what_the_node_declares(http: httpx.Client, path: str, methods: set[str]) -> None:
    assert set(http.get(LAMP + path).headers["allow"].split(", ")) == {"GET", "HEAD", "OPTIONS"} | methods


def test_a_value_is_put_within_its_range_and_nothing_is_sent_beyond_it(http: httpx.Client) -> None:
    assert http.put(LEVEL, json=15).status_code == 204
    assert http.put(f"{LAMP}gain", json=1).status_code == 204  # a double, though JSON says it as an integer
    before = values(http)
    assert before == {"level": 15, "gain": 1.0, "serial": "A7"}
    for path, value, words in (
        ("level", 25, "/lamp/level: must be at most 20, not 25"),
        ("level", 12, "/lamp/level: must be on a step (0 and steps of 5 from there, up to 20), which 12 is not"),
        ("level", "high", '/lamp/level: is declared as integer, which "high" is not'),
        ("gain", -0.1, "/lamp/gain: must be at least 0.0, not -0.1"),
    ):
        refused = http.put(LAMP + path, json=value)
        assert (refused.status_code, refused.json()["detail"]) == (422, words)
    assert http.put(f"{LAMP}serial", json="B8").status_code == 405
    assert values(http) == before


def test_a_patch_of_the_node_sets_all_or_none(http: httpx.Client) -> None:
    assert http.patch(LAMP, json={"level": 5, "gain": 0.3}, headers=MERGE).status_code == 204
    before = values(http)
    assert before == {"level": 5, "gain": 0.3, "serial": "A7"}
    for patch, status, name in (
        ({"level": 10, "gain": 2.0}, 422, "/lamp/gain"),
        ({"level": 10, "serial": "B8"}, 409, "/lamp/serial"),
        ({"level": 10, "gain": None}, 409, "/lamp/gain"),
    ):
        refused = http.patch(LAMP, json=patch, headers=MERGE)
        assert refused.status_code == status
        assert name in refused.json()["detail"]
    assert values(http) == before


def test_what_the_node_alone_can_judge_it_judges(http: httpx.Client) -> None:
    refused = http.patch("/parameters/listener/", json={"seats": 9, "name": "Grace"}, headers=MERGE)
    assert refused.status_code == 422
    assert "there are four seats at most" in refused.json()["robotSaid"]
    assert http.get("/parameters/listener/name", headers=JSON).json() == "Ada"


def test_the_thing_description_has_the_bounds(http: httpx.Client) -> None:
    told = http.get("/resources/lamp/?format=td").json()["properties"]
    assert {"type": "integer", "minimum": 0, "maximum": 20, "multipleOf": 5}.items() <= told["level"].items()
    assert told["level"]["description"] == "How bright it is."
    assert told["serial"]["readOnly"] is True
