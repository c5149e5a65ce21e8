"""The paper's Table 1: each row relates concepts of HTTP, RDF and ROS, which the tests show to be the same."""

from __future__ import annotations

from pyoxigraph import BlankNode, CanonicalizationAlgorithm, Dataset, Literal, NamedNode, Quad, Triple

from rosld.ontology.vocab import ldp, rdf, ros, xsd
from tests.paper.conftest import SERVICES, Flight
from tests.server.robots.asking import SYNTAXES

SPEED, DISPLAY, POWER = "/topics/aircraft/engine/speed", "/topics/cockpit/display", "/resources/aircraft/power"
FLOAT64 = "https://w3id.org/rosld/types/std_msgs/msg/Float64"
NAMES = [
    *(f"/nodes/{name}" for name in ("aircraft", "cockpit")),
    SPEED,
    DISPLAY,
    *(f"/services{name}" for name in SERVICES),
    *(f"/parameters/{name}" for name in ("aircraft/seats", "aircraft/engine/cylinders", "cockpit/night")),
]


def canonical(triples: set[Triple]) -> set[Quad]:
    """Return the triples with canonical blank nodes."""
    dataset = Dataset(Quad(one.subject, one.predicate, one.object) for one in triples)
    dataset.canonicalize(CanonicalizationAlgorithm.UNSTABLE)
    return set(dataset)


def test_node_the_host_tells_what_a_ros_node_publishes_subscribes_to_and_provides(flight: Flight) -> None:
    assert flight.said("/nodes/", ldp.contains) >= {"/nodes/aircraft", "/nodes/cockpit"}
    assert SPEED in flight.said("/nodes/aircraft", ros.publishes)
    assert "/services/aircraft/start" in flight.said("/nodes/aircraft", ros.provides)
    assert DISPLAY in flight.said("/nodes/cockpit", ros.subscribes)


def test_distributed_application_the_entry_is_the_network_of_nodes_and_leads_to_all_of_them(flight: Flight) -> None:
    assert ros.Graph.value in flight.said("/", rdf.type)
    rooms = flight.said("/", ldp.contains)
    assert rooms >= {"/nodes/", "/topics/", "/services/", "/parameters/", "/resources/"}


def test_representation_one_state_has_the_same_triples_in_every_syntax_of_rdf(flight: Flight) -> None:
    flight.off()
    expected = canonical(flight.triples(POWER))
    for syntax in SYNTAXES:
        answer = flight.get(POWER, syntax)
        assert answer.headers["content-type"].partition(";")[0] == syntax
        assert canonical(flight.triples(answer)) == expected, syntax


def test_representation_json_is_the_message_or_the_tree_of_parameters_and_people_get_a_page(flight: Flight) -> None:
    flight.off()
    assert "power" in flight.get(POWER, "text/html").text
    assert flight.json(SPEED) == {"data": 0.0}
    assert flight.json("/parameters/aircraft/") == {
        "registration": "RO-SLD",
        "seats": 2,
        "engine": {"cylinders": 6, "limits": {"oil_pressure": 4.5, "temperature": 230.0}},
    }


def test_data_model_the_message_format_is_a_class_with_a_property_a_field(flight: Flight) -> None:
    document = "/types/std_msgs/msg/Float64"
    assert flight.said(document, ros.md5, of=FLOAT64) == {"fdb28210bfa9d7c91146260178d9a584"}  # `rosmsg md5`
    assert flight.said(document, ros.hasField, of=FLOAT64) == {f"{FLOAT64}#data"}
    (definition,) = flight.said(document, ros.definition, of=FLOAT64)
    assert [line for line in definition.splitlines() if line and not line.startswith("#")] == ["float64 data"]
    values = [one.object for one in flight.triples(SPEED) if one.predicate == NamedNode(f"{FLOAT64}#data")]
    assert [one.datatype for one in values] == [xsd.double]


def test_data_model_the_types_of_xml_rpc_are_datatypes(flight: Flight) -> None:
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


def test_identifier_a_name_makes_a_url_and_its_namespaces_are_the_containers_above(flight: Flight) -> None:
    for url in NAMES:
        _, kind, name = url.split("/", 2)
        assert flight.said(url, ros.name) == {f"/{name}"}
        while url != f"/{kind}/":
            above = url.rstrip("/").rpartition("/")[0] + "/"
            assert url in flight.said(above, ldp.contains)
            url = above


def test_identifier_nothing_that_is_told_of_is_without_a_url(flight: Flight) -> None:
    for path in ("/", "/nodes/aircraft", SPEED, "/services/aircraft/start", "/parameters/aircraft/seats"):
        assert not [one for one in flight.triples(path) if isinstance(one.subject, BlankNode)]


def test_interaction_the_verbs_of_a_resource_are_what_ros_can_do_with_it(flight: Flight) -> None:
    assert flight.allowed(SPEED) == {"GET"}
    # DELETE takes back what rosld advertised; POST publishes again and again
    assert flight.allowed(DISPLAY) - {"DELETE"} == {"GET", "PUT", "PATCH", "POST"}
    assert flight.allowed("/services/aircraft/start") == {"GET", "POST"}
    assert flight.allowed("/parameters/aircraft/seats") == {"GET", "PUT", "PATCH", "DELETE"}
    assert flight.allowed("/nodes/aircraft") == {"GET"}
