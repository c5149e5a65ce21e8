"""The paper's Table 1: a row is a concept of HTTP, of RDF and of ROS. Each is shown to be one and the same here."""

from __future__ import annotations

from typing import Any

import pytest
from pyoxigraph import BlankNode, CanonicalizationAlgorithm, Dataset, Literal, NamedNode, Quad, Triple

from rosld.ontology.vocab import ldp, rdf, ros, xsd

SPEED, DISPLAY, POWER = "/topics/aircraft/engine/speed", "/topics/cockpit/display", "/resources/aircraft/power"
FLOAT64 = "https://w3id.org/rosld/types/std_msgs/msg/Float64"
HASHES = {
    ros.md5: "fdb28210bfa9d7c91146260178d9a584",
    ros.typeHash: "RIHS01_705ba9c3d1a09df43737eb67095534de36fd426c0587779bda2bc51fe790182a",
}
"""What ROS 1 (`rosmsg md5`) and ROS 2 (`ros2 topic info --verbose`) have for it."""
SYNTAXES = (
    "text/turtle",
    "application/ld+json",
    "application/n-triples",
    "application/rdf+xml",
    "text/n3",
    "application/n-quads",
    "application/trig",
)


def canonical(triples: set[Triple]) -> set[Quad]:
    """The triples with canonical blank nodes."""
    dataset = Dataset(Quad(one.subject, one.predicate, one.object) for one in triples)
    dataset.canonicalize(CanonicalizationAlgorithm.UNSTABLE)
    return set(dataset)


def test_node_the_host_tells_what_a_ros_node_publishes_subscribes_to_and_provides(flight: Any) -> None:
    for name in flight.robot.names()["nodes"]:
        flight.until(lambda name=name: f"/nodes{name}" in flight.said("/nodes/", ldp.contains), name)
        assert flight.said(f"/nodes{name}", ros.name) == {name}
    assert SPEED in flight.said("/nodes/aircraft", ros.publishes)
    assert "/services/aircraft/start" in flight.said("/nodes/aircraft", ros.provides)
    assert DISPLAY in flight.said("/nodes/cockpit", ros.subscribes)


def test_distributed_application_the_entry_is_the_network_of_nodes_and_leads_to_all_of_them(flight: Any) -> None:
    assert ros.Graph.value in flight.said("/", rdf.type)
    rooms = flight.said("/", ldp.contains)
    assert rooms >= {"/nodes/", "/topics/", "/services/", "/parameters/", "/resources/"}
    assert flight.said("/nodes/", ldp.contains) >= {f"/nodes{name}" for name in flight.robot.names()["nodes"]}


def test_resource_every_service_parameter_and_topic_is_one(flight: Any) -> None:
    names = flight.robot.names()
    for kind in ("topics", "services"):
        for name in names[kind]:
            assert flight.said(f"/{kind}{name}", ros.name) == {name}
    for name in ("/aircraft/seats", "/aircraft/engine/cylinders", "/cockpit/night"):
        assert flight.said(f"/parameters{name}", ros.name) == {name}
        assert flight.json(f"/parameters{name}") == flight.robot.parameter(name)


def test_resource_a_topic_and_the_subscribers_of_it_share_one_url(flight: Any) -> None:
    assert flight.said(DISPLAY, ros.subscribedBy) >= {"/nodes/cockpit"}
    assert flight.allowed(DISPLAY) >= {"GET", "PUT"}


@pytest.mark.parametrize("syntax", SYNTAXES)
def test_representation_one_state_has_the_same_triples_in_every_syntax_of_rdf(flight: Any, syntax: str) -> None:
    flight.off()
    answer = flight.get(POWER, syntax)
    assert answer.headers["content-type"].partition(";")[0] == syntax
    assert canonical(flight.triples(answer)) == canonical(flight.triples(POWER))


def test_representation_json_is_the_message_as_ros_shows_it(flight: Any) -> None:
    flight.flying()
    assert flight.json(SPEED) == {"data": flight.robot.hear("/aircraft/engine/speed")}


def test_representation_json_of_parameters_is_the_tree_that_xml_rpc_carries(flight: Any) -> None:
    tree = {
        "registration": "RO-SLD",
        "seats": 2,
        "engine": {"cylinders": 6, "limits": {"oil_pressure": 4.5, "temperature": 230.0}},
    }
    read = flight.json("/parameters/aircraft/")
    assert read == flight.robot.parameter("/aircraft")
    assert {name: value for name, value in read.items() if name not in flight.robot.given} == tree


def test_representation_people_get_a_page(flight: Any) -> None:
    page = flight.get(POWER, "text/html")
    assert page.headers["content-type"].startswith("text/html")
    assert "power" in page.text


def test_data_model_the_message_format_is_a_class_with_a_property_a_field(flight: Any) -> None:
    document = "/types/std_msgs/msg/Float64"
    assert flight.said(document, flight.robot.hashed, of=FLOAT64) == {HASHES[flight.robot.hashed]}
    assert flight.said(document, ros.hasField, of=FLOAT64) == {f"{FLOAT64}#data"}
    (definition,) = flight.said(document, ros.definition, of=FLOAT64)
    assert [line for line in definition.splitlines() if line and not line.startswith("#")] == ["float64 data"]
    values = [one.object for one in flight.triples(SPEED) if one.predicate == NamedNode(f"{FLOAT64}#data")]
    assert [one.datatype for one in values] == [xsd.double]


def test_data_model_the_types_of_xml_rpc_are_datatypes(flight: Any) -> None:
    expected = {
        "/aircraft/registration": xsd.string,
        "/aircraft/seats": xsd.integer,
        "/aircraft/engine/limits/oil_pressure": xsd.double,
        "/cockpit/night": xsd.boolean,
        "/cockpit/checklist": rdf.JSON,
    }
    for name, datatype in expected.items():
        (value,) = (one.object for one in flight.triples(f"/parameters{name}") if one.predicate == ros.value)
        assert isinstance(value, Literal)
        assert value.datatype == datatype


def test_identifier_a_name_makes_a_url_and_its_namespaces_are_the_containers_above(flight: Any) -> None:
    for kind, name in [(kind, name) for kind, names in flight.robot.names().items() for name in names]:
        url = f"/{kind}{name}"
        assert flight.said(url, ros.name) == {name}
        while url != f"/{kind}/":
            above = url.rstrip("/").rpartition("/")[0] + "/"
            assert url in flight.said(above, ldp.contains)
            url = above


def test_identifier_nothing_that_is_told_of_is_without_a_url(flight: Any) -> None:
    for path in ("/", "/nodes/aircraft", SPEED, "/services/aircraft/start", "/parameters/aircraft/seats"):
        assert not [one for one in flight.triples(path) if isinstance(one.subject, BlankNode)]


def test_transport_what_http_carries_came_from_the_robot_and_goes_to_it(flight: Any) -> None:
    flight.flying()
    assert flight.json(SPEED)["data"] == flight.robot.hear("/aircraft/engine/speed")
    flight.publish(DISPLAY, {"data": "over HTTP"})
    flight.robot.heard_in_the_cockpit("over HTTP")


def test_transport_udpros_is_not_spoken(flight: Any) -> None:
    flight.publish(DISPLAY, {"data": "by TCPROS"})
    flight.robot.heard_in_the_cockpit("by TCPROS")
    assert flight.robot.protocols("/cockpit/display") == flight.robot.spoken


def test_interaction_the_verbs_of_a_resource_are_what_ros_can_do_with_it(flight: Any) -> None:
    assert flight.allowed(SPEED) == {"GET"}
    # DELETE takes back what rosld advertised; POST publishes again and again
    assert flight.allowed(DISPLAY) - {"DELETE"} == {"GET", "PUT", "PATCH", "POST"}
    assert flight.allowed("/services/aircraft/start") == {"GET", "POST"}
    # DELETE is not for what a node of ROS 2 declares
    assert flight.allowed("/parameters/aircraft/seats") - {"DELETE"} == {"GET", "PUT", "PATCH"}
    assert flight.allowed("/nodes/aircraft") == {"GET"}
