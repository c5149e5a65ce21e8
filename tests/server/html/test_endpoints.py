"""Endpoints as a table: of a node by topic, of a topic by node; the page does not repeat the linked resources."""

from __future__ import annotations

from rosld.adapters.model import Endpoint, Graph, Node, Qos, Topic, TypeRef
from rosld.ontology.describe_graph import node_document, node_views
from rosld.ontology.describe_topics import topic_document
from rosld.ontology.urls import Space
from rosld.server.html.sections import endpoint_table
from rosld.server.html.site import Site

SPACE, SITE = Space("http://robot/"), Site("http://robot/", "robot")
STRING = TypeRef("std_msgs/msg/String")
RELIABLE = Qos("reliable", "transient_local", "keep_last", 10, lifespan_ns=10_000_000_000, liveliness="automatic")
CHATTER = Topic("/chatter", (STRING,), (Endpoint("/a", STRING, True, None, RELIABLE),), (Endpoint("/b"),))
BROKEN = Topic("/broken", (STRING,), (Endpoint("/a", unreachable="<no such host>"),))
GRAPH = Graph(1, nodes={"/a": Node("/a"), "/b": Node("/b")}, topics={"/broken": BROKEN, "/chatter": CHATTER})


def test_a_node_shows_its_endpoints_by_topic_and_a_topic_by_node() -> None:
    of_node = endpoint_table(node_document(node_views(GRAPH)["/a"], SPACE), SITE)
    assert of_node is not None
    assert (of_node.heading, of_node.columns) == ("Topic", ("Role", "Reliability", "Durability", "History", "More"))
    broken, chatter = of_node.rows
    assert (broken.anchor.url, broken.problem) == ("http://robot/topics/broken", "<no such host>")
    assert chatter.cells == ("publishes", "reliable", "transient local", "keep last 10", "lifespan 10.0 s")
    of_topic = endpoint_table(topic_document(CHATTER, SPACE, GRAPH), SITE)
    assert of_topic is not None
    assert [row.anchor.url for row in of_topic.rows] == ["http://robot/nodes/a"]


def test_columns_that_nobody_fills_are_left_out_and_so_is_a_table_of_nothing() -> None:
    of_topic = endpoint_table(topic_document(BROKEN, SPACE, GRAPH), SITE)
    assert of_topic is not None
    assert of_topic.columns == ("Role",)
    assert endpoint_table(node_document(node_views(GRAPH)["/b"], SPACE), SITE) is None
