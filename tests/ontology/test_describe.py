"""Plain ROS described as documents: what the tests over HTTP do not show."""

from __future__ import annotations

import pytest
from pyoxigraph import Literal, NamedNode

from rosld.adapters.model import (
    Action,
    Endpoint,
    Graph,
    Master,
    MessageSchema,
    Node,
    Qos,
    Service,
    ServiceSchema,
    Stale,
    Topic,
    TypeRef,
)
from rosld.adapters.model.library import TypeLibrary
from rosld.ontology.describe import (
    SECTIONS,
    Members,
    Receipt,
    activity_document,
    entry_document,
    members_of,
    namespace_document,
    node_document,
    node_views,
    topic_document,
    type_container_document,
    type_document,
)
from rosld.ontology.document import Document, Envelope, LiftedMessage
from rosld.ontology.lift import lifter
from rosld.ontology.urls import Space
from rosld.ontology.vocab import cora, foaf, ldp, prov, rdf, rdfs, ros, schema_org, sosa, xsd

SPACE = Space("http://127.0.0.1:8080/")
LIBRARY = TypeLibrary(ros_version=1)
POINT = TypeRef("geometry_msgs/msg/Point")
TRIGGER = TypeRef("std_srvs/srv/Trigger")

GRAPH = Graph(
    revision=7,
    master=Master("http://localhost:11311/", "run-1"),
    nodes={name: Node(name) for name in ("/talker", "/listener")},
    topics={
        "/chatter": Topic("/chatter", (POINT,), (Endpoint("/talker"),), (Endpoint("/listener"),)),
        "/chatter/fast": Topic("/chatter/fast", (POINT,), (Endpoint("/talker"),)),
        "/lonely": Topic("/lonely"),
    },
    services={"/talker/reset": Service("/talker/reset", TRIGGER, ("/talker",))},
)


def url(path: str) -> NamedNode:
    return NamedNode(SPACE.base + path)


def said(document: Document, subject: NamedNode, predicate: NamedNode) -> list[object]:
    return [t.object for t in document.triples if t.subject == subject and t.predicate == predicate]


def own(document: Document, predicate: NamedNode) -> list[object]:
    return said(document, NamedNode(document.url), predicate)


def point() -> MessageSchema:
    schema = LIBRARY.find(POINT)
    assert isinstance(schema, MessageSchema)
    return schema


def lifted(publisher: str | None, sequence: int) -> LiftedMessage:
    message = point().codec.build(POINT.name, {"x": 1.0, "y": 2.0, "z": float(sequence)})
    envelope = Envelope(1_700_000_000_000_000_000 + sequence, sequence, publisher and SPACE.node(publisher))
    return LiftedMessage("#message", lifter(point()), message, envelope)


# The entry point and nodes


def test_the_entry_point_links_to_every_section_the_master_and_the_machine() -> None:
    document, machine = entry_document(GRAPH, SPACE, "ROS 1", name="arm"), url("#robot")
    assert own(document, ldp.contains) == [url(f"{section}/") for section in SECTIONS]
    assert own(document, ros.state) == [ros.Live]
    assert said(document, url("#master"), ros.uri) == [Literal("http://localhost:11311/", datatype=xsd.anyURI)]
    assert said(document, url("topics/"), ros.count) == [Literal("3", datatype=xsd.integer)]
    assert own(document, ros.robot) == [machine]
    assert said(document, machine, rdf.type) == [sosa.Platform, cora.Robot]
    assert said(document, machine, rdfs.label) == [Literal("arm")]
    assert said(document, machine, sosa.hosts) == [NamedNode(SPACE.base)]


def test_a_stale_graph_has_the_time_and_the_reason() -> None:
    document = entry_document(Graph(1, Stale(1_700_000_000_500_000_000, "the master does not answer")), SPACE)
    assert own(document, ros.state) == [ros.Stale]
    assert own(document, ros.staleSince) == [Literal("2023-11-14T22:13:20.5Z", datatype=xsd.dateTime)]
    assert own(document, ros.reason) == [Literal("the master does not answer")]


def test_a_node_lists_its_action_without_the_topics_and_services_that_ros_2_makes_it_of() -> None:
    inner = Topic("/fly/_action/status", publishers=(Endpoint("/pilot"),))
    service = Service("/fly/_action/send_goal", providers=("/pilot",))
    action = Action("/fly", servers=("/pilot",))
    graph = Graph(
        1,
        nodes={"/pilot": Node("/pilot")},
        topics={inner.name: inner},
        services={service.name: service},
        actions={action.name: action},
    )
    document = node_document(node_views(graph)["/pilot"], SPACE)
    assert own(document, ros.publishes) == []
    assert own(document, ros.provides) == [url("actions/fly")]


# Topics


def test_a_topic_that_is_also_a_namespace_links_to_its_container_and_back() -> None:
    document = topic_document(GRAPH.topics["/chatter"], SPACE, GRAPH)
    assert own(document, ros.namespace) == [url("topics/chatter/")]
    members = members_of(GRAPH.topics)[("chatter",)]
    container = namespace_document("topics", ("chatter",), members, SPACE, is_name=True)
    assert own(container, rdfs.seeAlso) == [url("topics/chatter")]
    lonely = topic_document(GRAPH.topics["/lonely"], SPACE, GRAPH)
    absent = {ros.namespace, ros.rate, ros.latest, ros.hasEndpoint, ros.hasQos, ros.hasQosMismatch}
    assert not absent & {each.predicate for each in lonely.triples}


def test_the_newest_message_is_the_latest_and_that_of_each_publisher_is_linked() -> None:
    messages = [lifted("/listener", 1), lifted("/a.b", 2), lifted("/talker", 3)]
    document = topic_document(GRAPH.topics["/chatter"], SPACE, GRAPH, 1.0, messages)
    nodes = ["#from/listener", "#from/a%2Eb", "#message"]
    assert own(document, ros.latest) == [url("topics/chatter#message")]
    assert own(document, ros.latestFrom) == [url(f"topics/chatter{node}") for node in nodes]
    assert [message.node for message in document.messages] == nodes
    assert document.messages[-1].message.z == 3.0  # type: ignore[attr-defined]
    alone = topic_document(GRAPH.topics["/chatter"], SPACE, GRAPH, 1.0, messages[-1:])
    assert own(alone, ros.latest) == [url("topics/chatter#message")]
    assert own(alone, ros.latestFrom) == []


def test_no_two_messages_of_a_topic_share_a_node() -> None:
    publishers = ["/a", "/a", "/a.b", "/a/b", "/a;1", "/a;2", "//", None, None, "/a"]
    messages = [lifted(publisher, number % 2) for number, publisher in enumerate(publishers)]
    document = topic_document(GRAPH.topics["/chatter"], SPACE, GRAPH, 1.0, messages)
    nodes = [message.node for message in document.messages]
    assert len(set(nodes)) == len(publishers)
    assert nodes[-1] == "#message"
    assert not any("." in node for node in nodes)


def test_conflicting_types_are_linked_as_variants_and_there_is_no_type() -> None:
    one, other = TypeRef("a/msg/B", "11"), TypeRef("a/msg/B", "22")
    topic = Topic("/t", (one, other), (Endpoint("/x", one), Endpoint("/y", other)), unreadable="\udcff: two types")
    document = topic_document(topic, SPACE, GRAPH)
    assert own(document, ros.conflictingType) == [url("types/a/msg/B?hash=11"), url("types/a/msg/B?hash=22")]
    assert own(document, ros.hasMessageType) == []
    assert own(document, ros.unreadable) == [Literal("���: two types")]
    assert said(document, url("topics/t#publisher/y"), ros.conflictingType) == [url("types/a/msg/B?hash=22")]
    assert own(topic_document(topic, SPACE, GRAPH, unreadable="new"), ros.unreadable) == [Literal("new")]


def test_an_unreachable_or_latched_publisher_is_an_endpoint() -> None:
    topic = Topic("/t", (POINT,), (Endpoint("/a/b", latched=True), Endpoint("/c", unreachable="no such host")))
    document = topic_document(topic, SPACE, GRAPH)
    assert own(document, ros.hasEndpoint) == [url("topics/t#publisher/a/b"), url("topics/t#publisher/c")]
    assert said(document, url("topics/t#publisher/c"), ros.unreachable) == [Literal("no such host")]


SECONDS = 1_000_000_000
FULL = Qos("reliable", "volatile", "keep_last", 5, SECONDS // 2, 2 * SECONDS, "automatic", SECONDS)


def test_each_endpoint_has_its_quality_of_service_in_seconds_without_what_is_unknown() -> None:
    both = (Endpoint("/a", POINT, qos=Qos("reliable")), Endpoint("/a", POINT, qos=Qos("best_effort")))
    document = topic_document(Topic("/t", (POINT,), (*both, Endpoint("/a/2", qos=FULL))), SPACE, GRAPH)
    ends = [f"publisher/{end}" for end in ("a", "a;2", "a/2")]
    assert own(document, ros.hasEndpoint) == [url(f"topics/t#{end}") for end in ends]
    first, second, third = (url(f"topics/t#qos/{end}") for end in ends)
    assert said(document, url(f"topics/t#{ends[2]}"), ros.hasQos) == [third]
    assert {t.predicate for t in document.triples if t.subject == first} == {rdf.type, ros.reliability}
    assert said(document, second, ros.reliability) == [Literal("best_effort")]
    assert {(t.predicate, t.object) for t in document.triples if t.subject == third} == {
        (rdf.type, ros.Qos),
        (ros.reliability, Literal("reliable")),
        (ros.durability, Literal("volatile")),
        (ros.history, Literal("keep_last")),
        (ros.depth, Literal("5", datatype=xsd.integer)),
        (ros.deadline, Literal("0.5", datatype=xsd.double)),
        (ros.lifespan, Literal("2.0", datatype=xsd.double)),
        (ros.liveliness, Literal("automatic")),
        (ros.lease, Literal("1.0", datatype=xsd.double)),
    }


def test_a_topic_names_publishers_and_subscribers_whose_qualities_of_service_do_not_match() -> None:
    weak, strong = Endpoint("/weak", qos=Qos("best_effort")), Endpoint("/strong", qos=Qos("reliable"))
    document = topic_document(Topic("/t", (POINT,), (weak, weak, strong), (strong, weak)), SPACE, GRAPH)
    [mismatch] = own(document, ros.hasQosMismatch)
    assert own(document, ros.qosMismatchCount) == [Literal("2", datatype=xsd.integer)]
    assert {(t.predicate, t.object) for t in document.triples if t.subject == mismatch} == {
        (rdf.type, ros.QosMismatch),
        (ros.offeringNode, url("nodes/weak")),
        (ros.requestingNode, url("nodes/strong")),
        (ros.policy, Literal("reliability")),
        (ros.offered, Literal("best_effort")),
        (ros.requested, Literal("reliable")),
    }
    many, others = ([Endpoint(f"{each.node}{n}", qos=each.qos) for n in range(20)] for each in (weak, strong))
    document = topic_document(Topic("/t", (POINT,), tuple(many), tuple(others)), SPACE, GRAPH)
    assert len(own(document, ros.hasQosMismatch)) == 50
    assert own(document, ros.qosMismatchCount) == [Literal("400", datatype=xsd.integer)]


# Containers


def test_members_are_grouped_by_namespace_and_listed() -> None:
    found = members_of(["/a", "/a/b", "/a/c/d", "/z//y"])
    assert found[()] == Members(("a",), ("a", "z"))
    assert found[("a",)] == Members(("b",), ("c",))
    assert found[("a", "c")] == Members(("d",), ())
    assert found[("z",)] == Members((), ("",))
    assert found[("z", "")] == Members(("y",), ())
    assert members_of([]) == {(): Members()}
    document = namespace_document("topics", ("camera",), Members(("image", ""), ("image",)), SPACE)
    assert ldp.BasicContainer in own(document, rdf.type)
    members = [url(f"topics/camera/{name}") for name in ("image", "~", "image/")]
    assert own(document, ldp.contains) == members
    listed = ("a/msg/X", "a/msg/Y", "a/srv/Z", "b/msg/X")
    assert own(type_container_document("types", (), listed, SPACE), ldp.contains) == [url("types/a/"), url("types/b/")]
    inner = type_container_document("types", ("a", "msg"), listed[:2], SPACE)
    assert own(inner, ldp.contains) == [url("types/a/msg/X"), url("types/a/msg/Y")]


# Types


def test_a_message_type_has_its_fields_in_order() -> None:
    definition = "int8 A=3\nstring B=x y\nfloat64[3] xs\ngeometry_msgs/Point[] ps\nbool b\n"
    schema = LIBRARY.learn_message("p/msg/T", definition)
    document = type_document(schema, SPACE)
    kind = NamedNode("https://w3id.org/rosld/types/p/msg/T")
    assert own(document, foaf.primaryTopic) == [kind]
    assert ros.MessageType in said(document, kind, rdf.type)
    assert said(document, kind, ros.md5) == [Literal(schema.ref.hash or "")]
    assert said(document, kind, ros.hasField) == [NamedNode(f"{kind.value}#{name}") for name in ("xs", "ps", "b")]
    xs, ps = NamedNode(f"{kind.value}#xs"), NamedNode(f"{kind.value}#ps")
    assert said(document, xs, ros.fieldType) == [Literal("float64[3]")]
    assert said(document, xs, ros.arrayLength) == [Literal("3", datatype=xsd.integer)]
    assert said(document, xs, schema_org.rangeIncludes) == [rdf.JSON, ros.Elided]
    assert said(document, ps, ros.nestedType) == [NamedNode("https://w3id.org/rosld/types/geometry_msgs/msg/Point")]
    assert said(document, ps, schema_org.rangeIncludes) == [rdf.List, ros.Elided]
    assert said(document, NamedNode(f"{kind.value}#A"), ros.value) == [Literal("3", datatype=xsd.byte)]
    assert said(document, NamedNode(f"{kind.value}#B"), ros.value) == [Literal("x y")]
    assert said(document, kind, ros.definition) == [Literal(schema.definition)]


def test_a_service_type_describes_both_halves() -> None:
    schema = LIBRARY.find(TRIGGER)
    assert isinstance(schema, ServiceSchema)
    document, kind = type_document(schema, SPACE), "https://w3id.org/rosld/types/std_srvs/srv/Trigger"
    response = NamedNode(f"{kind}_Response")
    assert said(document, NamedNode(kind), ros.responseType) == [response]
    fields = [NamedNode(f"{response.value}#{name}") for name in ("success", "message")]
    assert said(document, response, ros.hasField) == fields


def test_variants_of_a_type_have_their_own_urls_and_link_to_each_other() -> None:
    schema = point()
    other = TypeRef(schema.ref.name, "0" * 32)
    document = type_document(schema, SPACE, (schema.ref, other))
    assert document.url == SPACE.type(schema.ref)
    kind = NamedNode(SPACE.class_of(schema.ref.name))
    assert said(document, kind, ros.variant) == [NamedNode(SPACE.type(other))]
    assert type_document(schema, SPACE, (schema.ref,)).url == SPACE.type(schema.ref.name)


# Receipts


@pytest.mark.parametrize(("made", "is_activity"), [("calls/7", True), ("goals/a", True), ("holds/3", True),
                                                   ("data/notes", False), ("parameters/size", False)])  # fmt: skip
def test_a_write_informs_the_activities_and_generates_the_entities_that_it_makes(made: str, is_activity: bool) -> None:
    """PROV-O: activities generate entities, and no activity is one."""
    receipt = Receipt(
        1, "r1", "pilot", None, 1_000_000_000, 2_000_000_000, "POST", f"{SPACE.base}services/reset", "text/plain", 2,
        None, "{}", False, ("call /reset",), (f"{SPACE.base}services/reset",), None, 201, SPACE.base + made, None,
    )  # fmt: skip
    document = activity_document(receipt, SPACE)
    assert own(document, prov.generated) == [url("activity/r1#answer"), *([] if is_activity else [url(made)])]
    assert said(document, url(made), prov.wasInformedBy) == ([url("activity/r1")] if is_activity else [])
