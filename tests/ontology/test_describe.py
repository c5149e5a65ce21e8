"""Documents of plain ROS resources: details that the tests over HTTP do not cover."""

from __future__ import annotations

import pytest
from pyoxigraph import Literal, NamedNode

from rosld.adapters.model import (
    Endpoint,
    Graph,
    Master,
    MessageSchema,
    Node,
    Qos,
    Service,
    Topic,
    TypeRef,
)
from rosld.adapters.model.library import TypeLibrary
from rosld.ontology.describe_activities import Receipt, activity_document
from rosld.ontology.describe_graph import namespace_document, type_container_document
from rosld.ontology.describe_topics import topic_document
from rosld.ontology.describe_types import type_document
from rosld.ontology.document import Document, Envelope, LiftedMessage
from rosld.ontology.lift import lifter
from rosld.ontology.names import Members, members_of
from rosld.ontology.urls import Space
from rosld.ontology.vocab import foaf, ldp, prov, rdf, rdfs, ros, schema_org, xsd

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


# Topics


def test_no_two_messages_of_a_topic_share_a_node() -> None:
    publishers = ["/a", "/a", "/a.b", "/a/b", "/a;1", "/a;2", "//", None, None, "/a"]
    messages = [lifted(publisher, number % 2) for number, publisher in enumerate(publishers)]
    document = topic_document(GRAPH.topics["/chatter"], SPACE, GRAPH, 1.0, messages)
    nodes = [message.node for message in document.messages]
    assert len(set(nodes)) == len(publishers)
    assert nodes[-1] == "#message"
    assert not any("." in node for node in nodes)


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
    definition = "# A thing,\n#\n# and on.\n\nint8 A=3\nstring B=x y\nfloat64[3] xs\ngeometry_msgs/Point[] ps\nbool b\n"
    schema = LIBRARY.learn_message("p/msg/T", definition)
    document = type_document(schema, SPACE)
    kind = NamedNode("https://w3id.org/rosld/types/p/msg/T")
    assert own(document, foaf.primaryTopic) == [kind]
    assert ros.MessageType in said(document, kind, rdf.type)
    assert said(document, kind, rdfs.comment) == [Literal("A thing, and on.")]
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
    """PROV-O: activities generate entities, and no activity is an entity."""
    receipt = Receipt(
        1, "r1", "pilot", None, 1_000_000_000, 2_000_000_000, "POST", f"{SPACE.base}services/reset", "text/plain", 2,
        None, "{}", False, ("call /reset",), (f"{SPACE.base}services/reset",), None, 201, SPACE.base + made, None,
    )  # fmt: skip
    document = activity_document(receipt, SPACE)
    assert own(document, prov.generated) == [url("activity/r1#answer"), *([] if is_activity else [url(made)])]
    assert said(document, url(made), prov.wasInformedBy) == ([url("activity/r1")] if is_activity else [])
