"""The body at /body: links, joints and sensors of robot descriptions, from topics and parameters, also in SPARQL."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import httpx
import pytest
from pyshacl import validate
from rdflib import RDF, RDFS, Graph, Literal, Namespace, URIRef

from tests.ontology.test_urdf import ARM
from tests.server.auth.conftest import rule, token, tokens
from tests.waiting import until

JSON = {"Accept": "application/json"}
RESULTS = {"Accept": "application/sparql-results+json"}
STRING, JOINT_STATE = "std_msgs/msg/String", "sensor_msgs/msg/JointState"
ROS = Namespace("https://w3id.org/rosld#")
QUDT, UNIT = Namespace("http://qudt.org/schema/qudt/"), Namespace("http://qudt.org/vocab/unit/")
SOSA, CORA = Namespace("http://www.w3.org/ns/sosa/"), Namespace("http://purl.org/ieee1872-owl/cora-bare#")
POSITIONS = """
SELECT ?name ?position WHERE {
  ?topic ros:describesBody ?body ; ros:latest ?state .
  ?state <https://w3id.org/rosld/types/sensor_msgs/msg/JointState#name> ?names ;
    <https://w3id.org/rosld/types/sensor_msgs/msg/JointState#position> ?positions .
  ?body ros:hasJoint ?joint .
  ?joint ros:name ?name ; ros:jointType ?type .
  BIND(ros:at(?positions, ros:indexOf(?names, ?name)) AS ?position)
  FILTER(BOUND(?position))
} ORDER BY ?name"""


def body(http: httpx.Client) -> Graph:
    return Graph().parse(data=http.get("body").raise_for_status().text, format="turtle")


def query(http: httpx.Client, text: str, **headers: str) -> list[dict[str, str]]:
    answer = http.get("sparql", params={"query": text}, headers={**RESULTS, **headers}).raise_for_status()
    return [{name: each["value"] for name, each in row.items()} for row in answer.json()["results"]["bindings"]]


@pytest.mark.slow
def test_a_description_on_a_topic_is_a_body(robot: Any, serving: Any) -> None:
    robot.topic("/robot_description", STRING, {"data": ARM})
    http = serving()
    base, found = http.base_url, body(http)
    document, machine = URIRef(f"{base}body"), URIRef(f"{base}#robot")
    shoulder, hand = URIRef(f"{base}body#joint/shoulder"), URIRef(f"{base}body#link/hand")
    assert (document, ROS.describedBy, URIRef(f"{base}topics/robot_description")) in found
    assert {str(found.value(each, RDFS.label)) for each in found.objects(document, ROS.hasLink)} == {
        "base", "upper", "lower", "hand"
    }  # fmt: skip
    assert found.value(shoulder, ROS.jointType) == Literal("revolute")
    assert found.value(shoulder, ROS.childLink) == URIRef(f"{base}body#link/upper")
    assert str(found.value(shoulder, ROS.axis)) == "[0.0,0.0,1.0]"
    upper = found.value(shoulder, ROS.upperLimit)
    assert (found.value(upper, QUDT.numericValue), found.value(upper, QUDT.hasUnit)) == (Literal(2.0), UNIT.RAD)
    slide = found.value(URIRef(f"{base}body#joint/slide"), ROS.effortLimit)
    assert found.value(slide, QUDT.hasUnit) == UNIT.N
    assert found.value(URIRef(f"{base}body#joint/slide"), ROS.mimics) == shoulder
    assert found.value(hand, ROS.frame) == URIRef(f"{base}frames#hand")
    assert (hand, CORA.robotPart, machine) in found
    eye = URIRef(f"{base}body#sensor/eye")
    assert {(eye, RDF.type, SOSA.Sensor), (eye, SOSA.isHostedBy, machine), (eye, ROS.mountedOn, hand)} <= set(found)
    shapes = Graph().parse(data=http.get("shapes/documents").text, format="turtle")
    conforms, _, words = validate(found, shacl_graph=shapes)
    assert conforms, words
    entry = Graph().parse(data=http.get("").text, format="turtle")
    assert entry.value(machine, ROS.hasBody) == document
    page = http.get("body", headers={"Accept": "text/html"}).raise_for_status().text
    assert "shoulder" in page
    assert 'href="/body"' in http.get("", headers={"Accept": "text/html"}).text.replace(str(base), "/")


def test_names_in_a_joint_state_lead_to_joints(robot: Any, serving: Any) -> None:
    robot.topic("/robot_description", STRING, {"data": ARM})
    robot.topic("/joint_states", JOINT_STATE, {"name": ["slide", "other", "shoulder"], "position": [0.2, 9, 1.5]})
    http = serving()
    assert query(http, POSITIONS) == [
        {"name": "shoulder", "position": "1.5"}, {"name": "slide", "position": "0.2"}
    ]  # fmt: skip
    limits = "SELECT ?joint { ?joint ros:upperLimit/qudt:numericValue ?limit FILTER(?limit > 1) }"
    assert query(http, limits) == [{"joint": f"{http.base_url}body#joint/shoulder"}]
    graph = f"SELECT (COUNT(*) AS ?n) {{ GRAPH <{http.base_url}body> {{ ?s ?p ?o }} }}"
    assert query(http, graph) == [{"n": str(len(body(http)))}]
    robot.publishes("/robot_description", {"data": ARM.replace("shoulder", "elbow")})
    assert until(lambda: query(http, limits) == [{"joint": f"{http.base_url}body#joint/elbow"}], "the new joint")


def test_a_parameter_is_read_where_there_is_no_topic_and_robots_are_told_apart(robot: Any, serving: Any) -> None:
    http = serving()
    missing = http.get("body")
    assert (missing.status_code, "robot_description" in missing.text) == (404, True)
    assert query(http, "SELECT ?x { ?x a ros:Body }") == []
    robot.topic("/left/robot_description", STRING, heard=True, published=False)
    for name in ("left", "right"):
        robot.parameter(f"/{name}/robot_description", ARM.replace('name="arm"', f'name="{name}"'))
    found = body(http)
    assert {str(each).partition("#")[2] for each in found.subjects(ROS.jointType)} == {
        f"{side}/joint/{joint}" for side in ("left", "right") for joint in ("shoulder", "slide", "wrist")
    }
    assert {str(each) for each in found.objects(None, ROS.describedBy)} == {
        f"{http.base_url}parameters/{side}/robot_description" for side in ("left", "right")
    }
    assert len(query(http, "SELECT ?x { ?x a ros:Joint }")) == 6


@pytest.mark.parametrize(
    ("text", "term", "words"),
    [
        ('<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]><robot name="&x;"/>', ROS.unreadable, "document type"),
        ("<robot><link/></robot>", ROS.descriptionProblem, "A link has no name."),
        ("", ROS.unreadable, "not well-formed"),
        (7, ROS.unreadable, "not a string"),
    ],
)
def test_what_is_wrong_is_said(robot: Any, serving: Any, text: Any, term: URIRef, words: str) -> None:
    robot.parameter("/robot_description", text)
    http = serving()
    found = body(http)
    [said] = found.objects(URIRef(f"{http.base_url}body"), term)
    assert str(said).startswith("/robot_description: ")
    assert words in str(said)
    assert http.get("body", headers={"Accept": "text/html"}).status_code == 200


@pytest.mark.slow
def test_joints_that_mimic_each_other_do_not_harm_the_page(robot: Any, serving: Any) -> None:
    joints = "".join(
        f'<joint name="j{n}" type="continuous"><parent link="a{n}"/><child link="a{n + 1}"/>'
        f'<mimic joint="j{(n + 1) % 100}"/></joint><link name="a{n}"/>'
        for n in range(100)
    )
    robot.topic("/robot_description", STRING, {"data": f'<robot>{joints}<link name="a100"/></robot>'})
    http = serving()
    assert len(set(body(http).subjects(ROS.jointType))) == 100
    assert len(http.get("body", headers={"Accept": "text/html"}).raise_for_status().content) < 600_000


@pytest.mark.slow
def test_whoever_may_not_read_the_description_sees_no_body(robot: Any, serving: Any, tmp_path: Path) -> None:
    robot.topic("/robot_description", STRING, {"data": ARM})
    rules = tmp_path / "rules.toml"
    rules.write_text(
        rule("admin reader", "read", "/**") + rule("reader", "read", "/topics/robot_description", deny=True)
        + tokens("admin", "reader")
    )  # fmt: skip
    http = serving(auth=rules)
    admin, reader = ({"Authorization": f"Bearer {token(name)}"} for name in ("admin", "reader"))
    assert http.get("body", headers=admin).status_code == 200
    hidden = http.get("body", headers=reader)
    assert (hidden.status_code, "robot_description" in hidden.text) == (404, False)
    joints = "SELECT ?name { ?x a ros:Joint ; ros:name ?name }"
    assert len(query(http, joints, **admin)) == 3
    assert query(http, joints, **reader) == []
    assert query(http, "SELECT ?b { ?robot ros:hasBody ?b . ?b ros:hasLink ?link }", **reader) == []
    assert "/body" not in http.get("", headers={**reader, "Accept": "text/html"}).text.replace("</body", "")
