"""The source on the command line, the address we advertise, and the graph as a pure function."""

from __future__ import annotations

import re

import pytest

from rosld.adapters.base import AdapterOptions
from rosld.adapters.model import Graph, Stale, TypeRef
from rosld.adapters.registry import adapter_for
from rosld.adapters.ros1 import Ros1Adapter
from rosld.adapters.ros1.adapter import master_address, node_name
from rosld.adapters.ros1.graph import SystemState, compose
from rosld.adapters.ros1.publications import addresses
from rosld.adapters.ros1.types import EndpointFacts, Facts


def test_a_source_names_its_master() -> None:
    for source, environment, expected in (
        ("ros1://robot:11411", {}, ("robot", 11411)),
        ("ros1://robot", {}, ("robot", 11311)),
        ("ros1://[::1]:5", {}, ("::1", 5)),
        ("ros1:", {"ROS_MASTER_URI": "http://robot:1234/"}, ("robot", 1234)),
        ("ros1", {}, ("localhost", 11311)),
    ):
        assert master_address(source, environment) == expected
    for source, uri in (("ros1://host:port", ""), ("ros1://host:99999", ""), ("ros1:///x", ""), ("ros1:", "ftp://x")):
        with pytest.raises(ValueError, match="master"):
            master_address(source, {"ROS_MASTER_URI": uri} if uri else {})
    assert isinstance(adapter_for("ros1://127.0.0.1:1", AdapterOptions()), Ros1Adapter)


def test_our_node_name_is_one_that_ros_accepts_and_never_the_same_twice() -> None:
    names = [node_name() for _ in range(3)]
    assert len(set(names)) == 3
    assert all(re.fullmatch(r"/rosld_\w+", name, re.ASCII) for name in names)


def test_what_the_user_says_is_advertised_before_what_ros_says_before_what_is_guessed() -> None:
    environment = {"ROS_HOSTNAME": "robot", "ROS_IP": "10.0.0.5"}
    assert addresses("10.9.9.9", "127.0.0.1", environment) == ["10.9.9.9"]
    assert addresses(None, "127.0.0.1", environment) == ["robot", "10.0.0.5", "127.0.0.1"]
    assert addresses(None, "127.0.0.1", {}) == ["127.0.0.1"]


def observed(**topics: tuple[str, ...]) -> SystemState:
    types = {f"/{name}": "std_msgs/String" for name in topics}
    return SystemState({f"/{name}": nodes for name, nodes in topics.items()}, {}, {}, types)


def no_facts() -> Facts:
    return Facts(lambda: None)


def test_the_same_observation_is_the_same_graph_and_a_change_shares_all_that_did_not_change() -> None:
    first = compose(Graph(0), observed(a=("/n",), b=("/n",)), no_facts(), {})
    assert first.revision == 1
    assert compose(first, observed(a=("/n",), b=("/n",)), no_facts(), {}) is first
    second = compose(first, observed(a=("/n",), b=("/n", "/m")), no_facts(), {})
    assert second.revision == 2
    assert second.topics["/a"] is first.topics["/a"]
    assert second.topics["/b"] is not first.topics["/b"]
    assert second.services is first.services


def test_what_all_publishers_say_of_themselves_is_believed_before_the_masters_word() -> None:
    learnt = no_facts()
    said = TypeRef("std_msgs/msg/Int32", "da5909fbe378aeaf85e547e830cc1bb7")
    learnt.endpoints.put(("/a", "/n"), EndpointFacts(said, True))
    graph = compose(Graph(0), observed(a=("/n",)), learnt, {said: "odd"})
    assert graph.topics["/a"].types == (said,)
    assert graph.topics["/a"].publishers[0].latched
    assert graph.topics["/a"].unreadable == "odd"
    both = compose(graph, observed(a=("/n", "/silent")), learnt, {})
    assert both.topics["/a"].types == (said, TypeRef("std_msgs/msg/String"))


def test_a_stale_graph_keeps_what_is_known_and_its_first_reason() -> None:
    graph = compose(Graph(0), observed(a=("/n",)), no_facts(), {})
    gone = graph.as_stale("why")
    assert isinstance(gone.state, Stale)
    assert gone.state.why == "why"
    assert gone.topics is graph.topics
    assert gone.as_stale("later") is gone
    assert compose(gone, observed(a=("/n",)), no_facts(), {}).revision == gone.revision + 1
