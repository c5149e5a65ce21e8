"""Plain ROS described as documents."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyoxigraph import Literal, NamedNode, Triple

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
    CallView,
    Members,
    NodeView,
    Receipt,
    activity_document,
    call_document,
    entry_document,
    is_namespace,
    members_of,
    namespace_document,
    node_document,
    node_views,
    service_document,
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


def test_the_entry_point_links_to_every_room_and_names_the_master() -> None:
    document = entry_document(GRAPH, SPACE, "ROS 1")
    assert document.url == SPACE.base
    assert own(document, rdf.type)[0] == ros.Graph
    assert own(document, ldp.contains) == [url(f"{room}/") for room in SECTIONS]
    assert own(document, ros.state) == [ros.Live]
    assert said(document, url("#master"), ros.uri) == [Literal("http://localhost:11311/", datatype=xsd.anyURI)]
    assert said(document, url("topics/"), ros.count) == [Literal("3", datatype=xsd.integer)]


def test_the_entry_point_leads_to_the_machine_that_hosts_it() -> None:
    document = entry_document(GRAPH, SPACE, name="arm")
    machine = url("#robot")
    assert own(document, ros.robot) == [machine]
    assert said(document, machine, rdf.type) == [sosa.Platform, cora.Robot]
    assert said(document, machine, rdfs.label) == [Literal("arm")]
    assert said(document, machine, sosa.hosts) == [NamedNode(SPACE.base)]


def test_a_stale_graph_says_since_when_and_why() -> None:
    document = entry_document(Graph(1, Stale(1_700_000_000_500_000_000, "the master does not answer")), SPACE)
    assert own(document, ros.state) == [ros.Stale]
    assert own(document, ros.staleSince) == [Literal("2023-11-14T22:13:20.5Z", datatype=xsd.dateTime)]
    assert own(document, ros.reason) == [Literal("the master does not answer")]


def test_a_node_says_what_it_takes_part_in() -> None:
    document = node_document(node_views(GRAPH)["/talker"], SPACE)
    assert own(document, ros.publishes) == [url("topics/chatter"), url("topics/chatter/fast")]
    assert own(document, ros.provides) == [url("services/talker/reset")]
    assert own(node_document(node_views(GRAPH)["/listener"], SPACE), ros.subscribes) == [url("topics/chatter")]


def test_a_node_tells_of_its_action_and_not_of_what_ros_2_makes_that_of() -> None:
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


def test_a_node_that_does_not_answer_says_why() -> None:
    document = node_document(NodeView(Node("/a", "http://gone:1/", "gone does not resolve")), SPACE)
    assert own(document, ros.unreachable) == [Literal("gone does not resolve")]


# Topics


def test_a_topic_names_type_and_endpoints_and_its_rate_once_that_was_measured() -> None:
    document = topic_document(GRAPH.topics["/chatter"], SPACE, GRAPH)
    assert own(document, ros.hasMessageType) == [NamedNode("https://w3id.org/rosld/types/geometry_msgs/msg/Point")]
    assert own(document, ros.publishedBy) == [url("nodes/talker")]
    assert own(document, ros.subscribedBy) == [url("nodes/listener")]
    assert own(document, ros.rate) == []
    assert own(document, ros.latest) == []
    measured = topic_document(GRAPH.topics["/chatter"], SPACE, GRAPH, 49.5)
    assert own(measured, ros.rate) == [Literal("49.5", datatype=xsd.double)]


def test_a_topic_that_is_a_namespace_too_links_to_its_container_and_back() -> None:
    document = topic_document(GRAPH.topics["/chatter"], SPACE, GRAPH)
    assert own(document, ros.namespace) == [url("topics/chatter/")]
    members = members_of(GRAPH.topics)[("chatter",)]
    container = namespace_document("topics", ("chatter",), members, SPACE, is_name=True)
    assert own(container, rdfs.seeAlso) == [url("topics/chatter")]
    assert own(topic_document(GRAPH.topics["/lonely"], SPACE, GRAPH), ros.namespace) == []


def test_the_newest_message_is_the_latest_and_each_publishers_is_linked() -> None:
    messages = [lifted("/listener", 1), lifted("/a.b", 2), lifted("/talker", 3)]
    document = topic_document(GRAPH.topics["/chatter"], SPACE, GRAPH, 1.0, messages)
    assert own(document, ros.latest) == [url("topics/chatter#message")]
    assert own(document, ros.latestFrom) == [
        url("topics/chatter#from/listener"),
        url("topics/chatter#from/a%2Eb"),
        url("topics/chatter#message"),
    ]
    assert [m.node for m in document.messages] == ["#from/listener", "#from/a%2Eb", "#message"]
    assert document.messages[-1].message.z == 3.0  # type: ignore[attr-defined]


def test_one_publisher_has_no_latest_from() -> None:
    document = topic_document(GRAPH.topics["/chatter"], SPACE, GRAPH, 1.0, [lifted("/talker", 3)])
    assert own(document, ros.latest) == [url("topics/chatter#message")]
    assert own(document, ros.latestFrom) == []


@given(st.lists(st.sampled_from(["/a", "/a.b", "/a/b", "/a;1", "//", None]), min_size=2, max_size=6))
def test_no_two_messages_of_a_topic_share_a_node(publishers: list[str | None]) -> None:
    messages = [lifted(publisher, number % 2) for number, publisher in enumerate(publishers)]
    document = topic_document(GRAPH.topics["/chatter"], SPACE, GRAPH, 1.0, messages)
    nodes = [message.node for message in document.messages]
    assert len(set(nodes)) == len(publishers)
    assert nodes[-1] == "#message"
    assert not any("." in node for node in nodes)


def test_conflicting_types_are_linked_as_variants_and_there_is_no_type() -> None:
    one, other = TypeRef("a/msg/B", "11"), TypeRef("a/msg/B", "22")
    topic = Topic("/t", (one, other), (Endpoint("/x", one), Endpoint("/y", other)), unreadable="two types")
    document = topic_document(topic, SPACE, GRAPH)
    assert own(document, ros.conflictingType) == [url("types/a/msg/B?hash=11"), url("types/a/msg/B?hash=22")]
    assert own(document, ros.hasMessageType) == []
    assert own(document, ros.unreadable) == [Literal("two types")]
    assert said(document, url("topics/t#publisher/y"), ros.conflictingType) == [url("types/a/msg/B?hash=22")]


def test_an_unreachable_or_latched_publisher_is_an_endpoint_of_its_own() -> None:
    topic = Topic("/t", (POINT,), (Endpoint("/a/b", latched=True), Endpoint("/c", unreachable="no such host")))
    document = topic_document(topic, SPACE, GRAPH)
    assert own(document, ros.hasEndpoint) == [url("topics/t#publisher/a/b"), url("topics/t#publisher/c")]
    assert said(document, url("topics/t#publisher/c"), ros.unreachable) == [Literal("no such host")]


SECONDS = 1_000_000_000
FULL = Qos("reliable", "volatile", "keep_last", 5, SECONDS // 2, 2 * SECONDS, "automatic", SECONDS)


def test_the_quality_of_service_of_an_endpoint_is_told_in_seconds() -> None:
    document = topic_document(Topic("/t", (POINT,), (Endpoint("/a/b", POINT, qos=FULL),)), SPACE, GRAPH)
    endpoint, qos = url("topics/t#publisher/a/b"), url("topics/t#qos/publisher/a/b")
    assert own(document, ros.hasEndpoint) == [endpoint]
    assert said(document, endpoint, ros.hasQos) == [qos]
    assert {(t.predicate, t.object) for t in document.triples if t.subject == qos} == {
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


def test_what_is_unknown_or_for_ever_of_a_quality_of_service_is_left_out() -> None:
    document = topic_document(Topic("/t", (POINT,), (), (Endpoint("/a", POINT, qos=Qos("reliable")),)), SPACE, GRAPH)
    about = {t.predicate for t in document.triples if t.subject == url("topics/t#qos/subscriber/a")}
    assert about == {rdf.type, ros.reliability}


def test_two_publishers_of_one_node_have_a_quality_of_service_each() -> None:
    both = (Endpoint("/a", POINT, qos=Qos("reliable")), Endpoint("/a", POINT, qos=Qos("best_effort")))
    document = topic_document(Topic("/t", (POINT,), (*both, Endpoint("/a/2", qos=FULL))), SPACE, GRAPH)
    first, second, third = own(document, ros.hasEndpoint)
    assert (first, second, third) == tuple(url(f"topics/t#publisher/{one}") for one in ("a", "a;2", "a/2"))
    assert said(document, url("topics/t#qos/publisher/a"), ros.reliability) == [Literal("reliable")]
    assert said(document, url("topics/t#qos/publisher/a;2"), ros.reliability) == [Literal("best_effort")]


def test_a_topic_says_who_does_not_hear_whom_and_why() -> None:
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


def test_of_many_that_do_not_hear_each_other_some_are_told_and_all_are_counted() -> None:
    weak = tuple(Endpoint(f"/p{number}", qos=Qos("best_effort")) for number in range(20))
    strong = tuple(Endpoint(f"/s{number}", qos=Qos("reliable")) for number in range(20))
    document = topic_document(Topic("/t", (POINT,), weak, strong), SPACE, GRAPH)
    assert len(own(document, ros.hasQosMismatch)) == 50
    assert own(document, ros.qosMismatchCount) == [Literal("400", datatype=xsd.integer)]


def test_a_topic_without_qualities_of_service_says_nothing_of_them() -> None:
    document = topic_document(GRAPH.topics["/chatter"], SPACE, GRAPH)
    assert not {ros.hasEndpoint, ros.hasQos, ros.hasQosMismatch} & {t.predicate for t in document.triples}


def test_why_a_message_cannot_be_read_goes_before_what_the_topic_says() -> None:
    topic = Topic("/t", unreadable="old words")
    assert own(topic_document(topic, SPACE, GRAPH, unreadable="new"), ros.unreadable) == [Literal("new")]


# Services and calls


def test_a_service_links_to_type_provider_and_shapes() -> None:
    document = service_document(GRAPH.services["/talker/reset"], SPACE, GRAPH)
    assert own(document, ros.hasServiceType) == [NamedNode("https://w3id.org/rosld/types/std_srvs/srv/Trigger")]
    assert own(document, ros.provider) == [url("nodes/talker")]
    assert own(document, ros.requestShape) == [url("shapes/std_srvs/srv/Trigger_Request")]
    assert own(document, ros.responseShape) == [url("shapes/std_srvs/srv/Trigger_Response")]


def test_a_service_of_unknown_type_says_why_it_cannot_be_called() -> None:
    document = service_document(Service("/s", uncallable="no definition"), SPACE, GRAPH)
    assert own(document, ros.uncallable) == [Literal("no definition")]
    assert own(document, ros.hasServiceType) == []


def trigger() -> ServiceSchema:
    schema = LIBRARY.find(TRIGGER)
    assert isinstance(schema, ServiceSchema)
    return schema


def test_a_call_carries_request_response_state_and_times() -> None:
    service = trigger()
    request = (service.request, service.request.codec.build(service.request.ref.name, {}))
    answer = service.response.codec.build(service.response.ref.name, {"success": False, "message": "no"})
    call = CallView("c1", "/talker/reset", "Failed", 10**18, request, (service.response, answer), 10**18 + 1, "no")
    document = call_document(call, SPACE)
    assert own(document, ros.state) == [ros.Failed]
    assert own(document, ros.isCallOf) == [url("services/talker/reset")]
    assert own(document, ros.request) == [url("calls/c1#request")]
    assert own(document, ros.response) == [url("calls/c1#response")]
    assert [message.node for message in document.messages] == ["#request", "#response"]
    triples = document.all_triples()
    assert Literal("no") in [t.object for t in triples if t.subject == url("calls/c1#response")]


def test_a_running_call_has_no_response_yet() -> None:
    service = trigger()
    request = (service.request, service.request.codec.build(service.request.ref.name, {}))
    document = call_document(CallView("c1", "/s", "Running", 10**18, request), SPACE)
    assert own(document, ros.response) == []
    assert own(document, prov.endedAtTime) == []


# Containers


def test_members_are_found_by_namespace() -> None:
    found = members_of(["/a", "/a/b", "/a/c/d", "/z//y"])
    assert found[()] == Members(("a",), ("a", "z"))
    assert found[("a",)] == Members(("b",), ("c",))
    assert found[("a", "c")] == Members(("d",), ())
    assert found[("z",)] == Members((), ("",))
    assert found[("z", "")] == Members(("y",), ())
    assert members_of([]) == {(): Members()}


@given(st.lists(st.lists(st.sampled_from(["", "a", "b", "."]), min_size=1, max_size=4)))
def test_every_name_is_a_member_of_its_namespace_and_every_namespace_of_its_parent(paths: list[list[str]]) -> None:
    found = members_of("/" + "/".join(path) for path in paths)
    for path in paths:
        for depth in range(1, len(path)):
            assert path[depth - 1] in found[tuple(path[: depth - 1])].namespaces
        assert path[-1] in found[tuple(path[:-1])].leaves
    listed = {(*namespace, leaf) for namespace, members in found.items() for leaf in members.leaves}
    assert listed == {tuple(path) for path in paths}


def test_a_name_is_known_as_a_namespace() -> None:
    assert is_namespace("/chatter", GRAPH.topics)
    assert not is_namespace("/lonely", GRAPH.topics)


def test_a_namespace_contains_names_and_namespaces() -> None:
    document = namespace_document("topics", ("camera",), Members(("image", ""), ("image",)), SPACE)
    assert document.url == "http://127.0.0.1:8080/topics/camera/"
    assert ldp.BasicContainer in own(document, rdf.type)
    assert own(document, ldp.contains) == [
        url("topics/camera/image"),
        url("topics/camera/~"),
        url("topics/camera/image/"),
    ]


def test_a_container_of_types_holds_packages_kinds_and_types() -> None:
    listed = ("a/msg/X", "a/msg/Y", "a/srv/Z", "b/msg/X")
    assert own(type_container_document("types", (), listed, SPACE), ldp.contains) == [url("types/a/"), url("types/b/")]
    inner = type_container_document("types", ("a", "msg"), listed[:2], SPACE)
    assert own(inner, ldp.contains) == [url("types/a/msg/X"), url("types/a/msg/Y")]
    assert said(inner, url("types/a/msg/X"), rdfs.label) == [Literal("a/msg/X")]


# Types


def test_a_message_type_has_its_fields_in_order() -> None:
    schema = LIBRARY.learn_message(
        "p/msg/T", "int8 A=3\nstring B=x y\nfloat64[3] xs\ngeometry_msgs/Point[] ps\nbool b\n"
    )
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
    document = type_document(trigger(), SPACE)
    response = NamedNode("https://w3id.org/rosld/types/std_srvs/srv/Trigger_Response")
    assert Triple(NamedNode("https://w3id.org/rosld/types/std_srvs/srv/Trigger"), ros.responseType, response) in (
        document.triples
    )
    assert said(document, response, ros.hasField) == [
        NamedNode(f"{response.value}#{n}") for n in ("success", "message")
    ]


def test_variants_of_a_type_have_urls_of_their_own_and_know_of_each_other() -> None:
    schema = point()
    other = TypeRef(schema.ref.name, "0" * 32)
    document = type_document(schema, SPACE, (schema.ref, other))
    assert document.url == SPACE.type(schema.ref)
    kind = NamedNode(SPACE.class_of(schema.ref.name))
    assert said(document, kind, ros.variant) == [NamedNode(SPACE.type(other))]
    assert type_document(schema, SPACE, (schema.ref,)).url == SPACE.type(schema.ref.name)


# Names, and receipts


def test_names_that_are_not_utf_8_are_shown_all_the_same() -> None:
    topic = Topic("/t", unreadable="bad \udcff byte")
    assert own(topic_document(topic, SPACE, GRAPH), ros.unreadable) == [Literal("bad ��� byte")]


def receipt(made: str | None) -> Receipt:
    return Receipt(
        1, "r1", "pilot", None, 1_000_000_000, 2_000_000_000, "POST", f"{SPACE.base}services/reset", "text/plain", 2,
        None, "{}", False, ("call /reset",), (f"{SPACE.base}services/reset",), None, 201, made, None,
    )  # fmt: skip


@pytest.mark.parametrize("made", ["calls/7", "goals/a", "holds/3"])
def test_a_call_a_goal_or_a_hold_is_an_activity_that_the_write_informed(made: str) -> None:
    """PROV-O: activities generate entities, and no activity is one."""
    document = activity_document(receipt(f"{SPACE.base}{made}"), SPACE)
    assert own(document, prov.generated) == [url("activity/r1#answer")]
    assert said(document, url(made), prov.wasInformedBy) == [url("activity/r1")]


@pytest.mark.parametrize("made", ["data/notes", "mappings/mine", "parameters/size"])
def test_what_else_a_write_makes_is_generated_by_it(made: str) -> None:
    document = activity_document(receipt(f"{SPACE.base}{made}"), SPACE)
    assert own(document, prov.generated) == [url("activity/r1#answer"), url(made)]
    assert prov.wasInformedBy not in {each.predicate for each in document.triples}
