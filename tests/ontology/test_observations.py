"""Observations and actuations: what a message means in the terms of SOSA."""

from __future__ import annotations

from collections.abc import Mapping

import pytest
from pyoxigraph import Literal, NamedNode, Triple

from rosld.adapters.model import Endpoint, Graph, MessageSchema, Topic, TypeRef
from rosld.adapters.model.library import TypeLibrary
from rosld.ontology.describe_topics import topic_document
from rosld.ontology.document import Document, Envelope, LiftedMessage
from rosld.ontology.lift import lifter
from rosld.ontology.lower import lowerer
from rosld.ontology.modules import module_triples
from rosld.ontology.observations import Observer, Role, role_of
from rosld.ontology.serialize import serialize
from rosld.ontology.syntax import Syntax
from rosld.ontology.urls import Space
from rosld.ontology.vocab import dqv, qudt, rdf, ros, sosa
from tests.ontology.test_serialize import canonical, rdflib_read, read

SPACE = Space("http://h/")
LIBRARY = TypeLibrary(ros_version=2)
DRIVER, BASE = Endpoint("/driver"), Endpoint("/base")
HEADER = {"stamp": {"sec": 5}, "frame_id": "/arm/link 1"}


def document(type: str, value: Mapping[str, object], *, received_ns: int = 1_700_000_000_000_000_000) -> Document:
    """The document of a topic of this type with one message, which a driver publishes (or a base receives)."""
    schema = LIBRARY.find(TypeRef(type))
    assert isinstance(schema, MessageSchema)
    is_command = "Twist" in type
    topic = Topic("/t", (schema.ref,), () if is_command else (DRIVER,), (BASE,) if is_command else ())
    graph = Graph(0, topics={"/t": topic})
    role = role_of(topic, graph, schema)
    assert role is (Role.ACTUATOR if is_command else Role.SENSOR)
    observer = Observer(schema, role, SPACE.types, SPACE.topic("/t") + role.value, SPACE.base)
    message = lowerer(schema).from_json(dict(value), defaults=True)
    lifted = LiftedMessage("#message", lifter(schema), message, Envelope(received_ns, 1), observer=observer)
    return topic_document(topic, SPACE, graph, messages=[lifted], schema=schema)


def objects(found: Document, subject: str, predicate: NamedNode) -> list[str]:
    own = NamedNode(found.url + subject)
    return [
        each.object.value
        for each in found.all_triples()
        if each.subject == own and each.predicate == predicate and isinstance(each.object, NamedNode | Literal)
    ]


def observed(found: Document) -> set[str]:
    """The names of the observed (or commanded) fields of the message."""
    kinds = (sosa.Observation, sosa.Actuation)
    nodes = [each.subject for each in found.all_triples() if each.predicate == rdf.type and each.object in kinds]
    return {str(node).rpartition("~")[2].rstrip(">") for node in nodes}


def test_a_battery_observes_what_it_measured_with_its_time_unit_sensor_and_feature() -> None:
    found = document("sensor_msgs/msg/BatteryState", {"header": HEADER, "voltage": 12.5, "temperature": "NaN"})
    assert observed(found) == {"voltage", "current", "percentage"}, "NaN means not measured"
    node = "#message~voltage"
    assert objects(found, node, sosa.observedProperty) == [SPACE.property_of("sensor_msgs/msg/BatteryState", "voltage")]
    assert objects(found, node, sosa.hasSimpleResult) == ["12.5"]
    assert objects(found, node, sosa.resultTime) == ["2023-11-14T22:13:20Z"]
    assert objects(found, node, sosa.phenomenonTime) == [f"{found.url}#message~time"]
    assert objects(found, node, sosa.hasFeatureOfInterest) == ["http://h/#robot"]
    assert objects(found, node, sosa.madeBySensor) == [f"{found.url}#sensor"]
    assert objects(found, "#message.voltage", qudt.hasUnit) == ["http://qudt.org/vocab/unit/V"]
    assert objects(found, "#sensor", ros.frame) == ["http://h/frames#arm/link%201"]
    kinds = objects(found, "#sensor", sosa.observes)
    assert "http://qudt.org/vocab/quantitykind/Voltage" in kinds
    assert objects(found, "", ros.sensor) == [f"{found.url}#sensor"]


def test_a_covariance_is_the_quality_of_a_result_and_minus_one_means_that_there_is_none() -> None:
    value = {"orientation_covariance": [-1, *[0] * 8], "angular_velocity_covariance": [0.5, *[0] * 8]}
    found = document("sensor_msgs/msg/Imu", value)
    assert observed(found) == {"angular_velocity", "linear_acceleration"}
    assert objects(found, "#message~angular_velocity", sosa.hasResult) == [f"{found.url}#message.angular_velocity"]
    (quality,) = objects(found, "#message~angular_velocity", sosa.resultQuality)
    assert objects(found, quality.removeprefix(found.url), dqv.value) == ["[0.5,0.0,0.0,0.0,0.0,0.0,0.0,0.0,0.0]"]
    assert objects(found, "#message~linear_acceleration", sosa.resultQuality) == [], "zero means unknown"
    assert objects(found, "#message~linear_acceleration", sosa.phenomenonTime) == [], "no stamp was set"


@pytest.mark.parametrize(
    ("type", "value", "fields"),
    [
        ("sensor_msgs/msg/LaserScan", {"header": HEADER, "ranges": [1.0, 2.0]}, {"ranges"}),
        ("sensor_msgs/msg/NavSatFix", {"latitude": 49.0, "altitude": "NaN"}, {"latitude", "longitude"}),
        ("sensor_msgs/msg/Range", {"range": "INF", "variance": 0.25}, {"range"}),
        ("nav_msgs/msg/Odometry", {"pose": {"covariance": [0.1] * 36}}, {"pose", "twist"}),
        ("geometry_msgs/msg/Twist", {"linear": {"x": 1.0}}, {"linear", "angular"}),
        ("geometry_msgs/msg/TwistStamped", {"header": HEADER}, {"twist"}),
    ],
)
def test_all_syntaxes_have_the_same_observations(type: str, value: Mapping[str, object], fields: set[str]) -> None:
    found = document(type, value)
    assert observed(found) == fields
    expected = canonical(found.all_triples())
    for syntax in (Syntax.N_TRIPLES, Syntax.TURTLE, Syntax.JSON_LD, Syntax.RDF_XML):
        text = serialize(found, syntax)
        assert canonical(read(text, syntax)) == canonical(rdflib_read(text, syntax)) == expected, syntax


def test_only_what_nodes_of_the_robot_publish_is_observed_and_only_what_they_receive_commands() -> None:
    battery, flag, twist = (
        (TypeRef(f"{name}"),)
        for name in ("sensor_msgs/msg/BatteryState", "std_msgs/msg/Bool", "geometry_msgs/msg/Twist")
    )
    own = Endpoint("/rosld")
    roles = [
        (Topic("/t", battery, (DRIVER,)), Role.SENSOR),
        (Topic("/t", battery, (own,), (BASE,)), None),
        (Topic("/t", battery), Role.SENSOR),  # in a recording
        (Topic("/t", flag, (DRIVER,)), None),
        (Topic("/t", flag, (own,), (BASE,)), Role.ACTUATOR),
        (Topic("/t", flag, (DRIVER,), (BASE,)), None),
        (Topic("/t", twist, (DRIVER,), (BASE,)), Role.ACTUATOR),
        (Topic("/t", twist, (DRIVER,)), None),
    ]
    for topic, role in roles:
        assert role_of(topic, Graph(0, topics={"/t": topic}), None) is role, topic


def test_a_type_that_no_table_has_is_observed_where_the_names_of_its_fields_tell_units() -> None:
    schema = LIBRARY.learn_message("acme_msgs/msg/Motor", "float32 motor_temp_celsius\nfloat32 gain\nbool ok")
    topic = Topic("/t", (schema.ref,), (DRIVER,))
    assert role_of(topic, Graph(0, topics={"/t": topic}), schema) is Role.SENSOR


def test_every_field_of_the_table_is_a_field_of_its_type() -> None:
    for triple in module_triples("sensors"):
        if triple.predicate in (ros.observes, ros.commands) and "ackermann" not in str(triple.subject):
            _is_field(triple)


def _is_field(triple: Triple) -> None:
    assert isinstance(triple.subject, NamedNode)
    assert isinstance(triple.object, NamedNode)
    name = triple.subject.value.removeprefix(SPACE.types)
    if name.startswith("control_msgs"):
        return
    schema = LIBRARY.find(TypeRef(name))
    assert isinstance(schema, MessageSchema)
    owner, _, field = triple.object.value.removeprefix(SPACE.types).partition("#")
    assert owner == name
    assert field in {each.name for each in schema.type.fields}
