"""The graph, derived from the data of the middleware."""

from __future__ import annotations

from msgspec.structs import replace

from rosld.adapters.model import Endpoint, Graph, Live, Parameter, Qos, Stale, TypeRef
from rosld.adapters.ros2.graph import GraphInputs, Observation, compose
from rosld.adapters.ros2.middleware import DiscoveredEndpoint

STRING = TypeRef("std_msgs/msg/String", "RIHS01_aa")
KNOWN = GraphInputs("/_rosld_1", "/rosld")
SEEN = Observation(
    nodes=("/talker", "/_rosld_1", "/talker"),
    topics={"/chatter": (STRING.name,), "/asked": (STRING.name,)},
    services={"/talker/go": ("std_srvs/srv/Trigger",), "/gone": ("std_srvs/srv/Trigger",)},
    publishers={"/chatter": (DiscoveredEndpoint("/talker", STRING, Qos("reliable", "transient_local"), b"1"),)},
    subscribers={
        "/chatter": (DiscoveredEndpoint("/_rosld_1", STRING, Qos("best_effort"), b"2"),),
        "/asked": (DiscoveredEndpoint("/_rosld_1", STRING, Qos("best_effort"), b"3"),),
    },
    providers={"/talker": {"/talker/go": ("std_srvs/srv/Trigger",)}},
)


def test_what_is_there_only_because_we_look_is_not_in_the_graph() -> None:
    graph = compose(Graph(0), SEEN, KNOWN)
    assert list(graph.nodes) == ["/talker"]
    assert list(graph.topics) == ["/chatter"]
    assert graph.topics["/chatter"].subscribers == ()
    assert graph.topics["/chatter"].publishers == (
        Endpoint("/talker", STRING, latched=True, qos=Qos("reliable", "transient_local")),
    )
    assert list(graph.services) == ["/talker/go"]


def test_the_same_look_gives_the_same_graph_and_another_shares_what_did_not_change() -> None:
    graph = compose(Graph(0), SEEN, KNOWN)
    assert graph.revision == 1
    assert compose(graph, replace(SEEN), KNOWN) is graph
    other = compose(graph, SEEN, replace(KNOWN, parameters={"/talker/x": Parameter("/talker/x", "/talker")}))
    assert other.revision == 2
    assert other.topics is graph.topics


def test_a_type_that_cannot_be_used_is_named_with_the_reason() -> None:
    graph = compose(Graph(0), SEEN, replace(KNOWN, problems=lambda name: f"{name} is not installed"))
    assert graph.topics["/chatter"].unreadable == "std_msgs/msg/String is not installed"
    assert graph.topics["/chatter"].types == (STRING,)
    assert graph.services["/talker/go"].uncallable == "std_srvs/srv/Trigger is not installed"


def test_two_types_of_a_topic_are_a_conflict_but_one_without_its_hash_is_none() -> None:
    other = DiscoveredEndpoint("/other", TypeRef("std_msgs/msg/Int8", "RIHS01_bb"), Qos(), b"6")
    bare = DiscoveredEndpoint("/humble", TypeRef(STRING.name), Qos(), b"7")
    both = replace(SEEN, publishers={"/chatter": (*SEEN.publishers["/chatter"], other)})
    assert compose(Graph(0), both, KNOWN).topics["/chatter"].type is None
    same = replace(SEEN, publishers={"/chatter": (*SEEN.publishers["/chatter"], bare)})
    assert compose(Graph(0), same, KNOWN).topics["/chatter"].type == STRING


def test_a_system_that_cannot_be_seen_keeps_its_last_graph() -> None:
    graph = compose(Graph(0), SEEN, KNOWN)
    gone = graph.as_stale("gone")
    assert isinstance(gone.state, Stale)
    assert (gone.state.why, gone.topics, gone.revision) == ("gone", graph.topics, 2)
    assert gone.as_stale("later") is gone
    assert compose(gone, SEEN, KNOWN).state == Live()
