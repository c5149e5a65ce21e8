"""The graph, derived from the data of the middleware."""

from __future__ import annotations

from msgspec.structs import replace

from rosld.adapters.model import Endpoint, Graph, Parameter, Qos, TypeRef
from rosld.adapters.ros2.graph import GraphInputs, Observation, compose
from rosld.adapters.ros2.middleware import DiscoveredEndpoint

STRING = TypeRef("std_msgs/msg/String", "RIHS01_aa")
KNOWN = GraphInputs("/_rosld_1", "/rosld")
TALKER = DiscoveredEndpoint("/talker", STRING, Qos("reliable", "transient_local"), b"1")
SEEN = Observation(
    nodes=("/talker",),
    topics={"/chatter": (STRING.name,)},
    services={},
    publishers={"/chatter": (TALKER,)},
    subscribers={},
    providers={},
)


def test_what_is_there_only_because_we_look_is_not_in_the_graph() -> None:
    ours = DiscoveredEndpoint("/_rosld_1", STRING, Qos("best_effort"), b"2")
    seen = replace(
        SEEN,
        nodes=("/talker", "/_rosld_1", "/talker"),
        topics={"/chatter": (STRING.name,), "/asked": (STRING.name,)},
        services={"/talker/go": ("std_srvs/srv/Trigger",), "/gone": ("std_srvs/srv/Trigger",)},
        subscribers={"/chatter": (ours,), "/asked": (ours,)},
        providers={"/talker": {"/talker/go": ("std_srvs/srv/Trigger",)}},
    )
    graph = compose(Graph(0), seen, KNOWN)
    assert list(graph.nodes) == ["/talker"]
    assert list(graph.topics) == ["/chatter"]
    assert graph.topics["/chatter"].subscribers == ()
    (talker,) = graph.topics["/chatter"].publishers
    assert talker == Endpoint("/talker", STRING, latched=True, qos=Qos("reliable", "transient_local"))
    assert list(graph.services) == ["/talker/go"]


def test_the_same_look_gives_the_same_graph_and_another_shares_what_did_not_change() -> None:
    graph = compose(Graph(0), SEEN, KNOWN)
    assert graph.revision == 1
    assert compose(graph, replace(SEEN), KNOWN) is graph
    other = compose(graph, SEEN, replace(KNOWN, parameters={"/talker/x": Parameter("/talker/x", "/talker")}))
    assert other.revision == 2
    assert other.topics is graph.topics


def test_two_types_of_a_topic_are_a_conflict_but_one_without_its_hash_is_none() -> None:
    other = DiscoveredEndpoint("/other", TypeRef("std_msgs/msg/Int8", "RIHS01_bb"), Qos(), b"6")
    bare = DiscoveredEndpoint("/humble", TypeRef(STRING.name), Qos(), b"7")
    for endpoint, type in ((other, None), (bare, STRING)):
        seen = replace(SEEN, publishers={"/chatter": (TALKER, endpoint)})
        assert compose(Graph(0), seen, KNOWN).topics["/chatter"].type == type
