"""The queries shipped with rosld, each run over HTTP on a small robot."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import pytest
from pyoxigraph import NamedNode, QueryResultsFormat, QuerySolutions, RdfFormat, Triple, parse, parse_query_results

from rosld.adapters.model import (
    Encoding,
    Endpoint,
    Kind,
    Lifecycle,
    LifecycleState,
    Node,
    Operation,
    Ref,
    Refused,
    Sample,
    Service,
    Topic,
    Transition,
    TypeRef,
)
from rosld.ontology.vocab import PREFIXES
from tests.server.robots.asking import ROS, TYPES
from tests.server.robots.made_up import MadeUp, served
from tests.server.sparql.recorded import record
from tests.waiting import once_started

TWIST, SCAN, STRING = "geometry_msgs/msg/Twist", "sensor_msgs/msg/LaserScan", "std_msgs/msg/String"
TRIGGER = "std_srvs/srv/Trigger"
VARIANTS = (TypeRef(STRING, "a" * 32), TypeRef(TWIST, "b" * 32))
TOPICS = (
    Topic("/scan", (TypeRef(SCAN),), (Endpoint("/talker"),), (Endpoint("/listener"),)),
    Topic("/cmd_vel", (TypeRef(TWIST),), (Endpoint("/talker"),)),
    Topic("/map", (TypeRef(STRING),), (), (Endpoint("/listener"),)),
    Topic("/idle", (TypeRef(STRING),), (Endpoint("/mute", unreachable="refused"),), (Endpoint("/listener"),)),
    Topic("/odd", VARIANTS, (Endpoint("/talker", VARIANTS[0]),), (Endpoint("/listener", VARIANTS[1]),)),
)
SERVICES = (
    Service("/reset", TypeRef(TRIGGER), ("/talker",)),
    Service("/lost", None, ("/mute",), "its node does not answer"),
)
CAMERA = Lifecycle(
    "/camera/change_state",
    LifecycleState("inactive", 2),
    (Transition("cleanup", 2, LifecycleState("cleaningup", 11)), Transition("activate", 3, LifecycleState("x", 99))),
)
NODES = (
    *(Node(name, None, "no answer" if name == "/mute" else None) for name in ("/talker", "/listener", "/mute")),
    Node("/camera", lifecycle=CAMERA),
    Node("/lidar", lifecycle=Lifecycle("/lidar/change_state", unknown="it does not answer")),
)


class Walker(MadeUp):
    """A robot whose graph has everything the queries select. Messages are received `later_ns` after their stamp."""

    later_ns = 0

    def __init__(self) -> None:
        super().__init__()
        self.topic("/scan", SCAN, {"ranges": [3.0, "INF", 0.25]})
        self.topic("/cmd_vel", TWIST, {"linear": {"x": 0.5}})
        self.topics(["/map", "/idle", "/odd"], STRING)
        self.answers = iter([True, False])
        self.offer("/reset", TRIGGER, self._reset)
        for name, value in {"/robot/wheels": 4, "/robot/name": "rosie", "/robotic": True}.items():
            self.parameter(name, value)

    def _reset(self, _: dict[str, Any]) -> Mapping[str, Any]:
        if next(self.answers):
            return {"success": True}
        raise Refused("it is jammed")

    def _put(self, name: str, publisher: str, data: bytes) -> None:
        topic = self._topics[name]
        topic.sequence += 1
        received = time.time_ns() + self.later_ns
        topic.slot.put(Sample(data, Encoding.ROS1, topic.type, "/talker", received, topic.sequence))

    def _announce(self, graph: Any) -> None:
        named = {kind: {one.name: one for one in each} for kind, each in GRAPH.items()}
        super()._announce(replace(graph, **named))

    def allows(self, ref: Ref) -> frozenset[Operation]:
        return frozenset({Operation.CHANGE_STATE}) if ref == Ref(Kind.NODE, "/camera") else super().allows(ref)


GRAPH: Mapping[str, Any] = {"topics": TOPICS, "services": SERVICES, "nodes": NODES}


@pytest.fixture(scope="module")
def http() -> Iterator[httpx.Client]:
    """That robot, after two calls and two movements."""
    robot = Walker()
    with served(robot, subscribe=("*",), max_publish_rate=1000, allow_publish=("/cmd_vel",)) as client:
        for _ in range(2):
            client.post("/services/reset", json={})
        for speed in (1, 2):
            client.put("/topics/cmd_vel", json={"linear": {"x": speed}})
        client.put("/topics/cmd_vel", json={"no": "field"})
        once_started(lambda: client.get("/sparql", params={"query": "ASK {}"}))
        for robot.later_ns in (10**9, 2 * 10**9):
            robot.publishes("/cmd_vel", {"linear": {"x": 0.25}})
            robot.publishes("/cmd_vel", {"linear": {"x": 0.5}})
            robot.publishes("/scan", {"ranges": [3.0, "INF", 0.25]})
            client.get("/topics/cmd_vel")
            client.get("/topics/scan")
        yield client


def ask(http: httpx.Client, name: str, **given: str) -> list[tuple[object, ...]]:
    """Return the rows of a stored query with these parameters; IRIs of the robot as paths, other terms as texts."""
    answer = http.get(f"/queries/{name}", params=given, headers={"Accept": "application/sparql-results+json"})
    assert answer.status_code == 200, answer.text
    found = parse_query_results(answer.content, QueryResultsFormat.JSON)
    assert isinstance(found, QuerySolutions)
    return [tuple(shown(term, str(http.base_url)) for term in row) for row in found]


def shown(term: Any, base: str) -> object:
    if isinstance(term, NamedNode):
        for start, written in ((TYPES, ""), (ROS, "ros:"), (base, "/")):
            if term.value.startswith(start):
                return written + term.value[len(start) :]
    return None if term is None else term.value


PUBLISHES = (TWIST, "/topics/cmd_vel", "/nodes/talker")
RESET = ("/services/reset", "/reset", TRIGGER, "/nodes/talker", None)
LOST = ("/services/lost", "/lost", None, "/nodes/mute", "its node does not answer")
NAMED = [("/robot/name", "rosie"), ("/robot/wheels", "4")]
ANSWERS: list[tuple[str, dict[str, str], list[tuple[object, ...]]]] = [
    ("unseen-topics", {}, [("/topics/idle", "/idle", "/nodes/mute"), ("/topics/odd", "/odd", "/nodes/talker")]),
    ("who-publishes", {"type": "Twist"}, [PUBLISHES]),
    ("who-publishes", {"type": TWIST}, [PUBLISHES]),
    ("who-publishes", {"type": "wist"}, []),
    ("unheard-topics", {}, [("/topics/cmd_vel", "/cmd_vel", "/nodes/talker")]),
    ("waiting-topics", {}, [("/topics/map", "/map", "/nodes/listener")]),
    ("conversations", {}, [
        ("/nodes/mute", "/topics/idle", "/nodes/listener"),
        ("/nodes/talker", "/topics/odd", "/nodes/listener"),
        ("/nodes/talker", "/topics/scan", "/nodes/listener"),
    ]),
    ("node", {"node": "/nodes/talker"}, [
        ("provides", "/services/reset", TRIGGER),
        ("publishes", "/topics/cmd_vel", TWIST),
        ("publishes", "/topics/odd", None),
        ("publishes", "/topics/scan", SCAN),
    ]),
    ("conflicting-types", {}, [
        ("/topics/odd", f"/types/{TWIST}?hash={'b' * 32}", "/nodes/listener"),
        ("/topics/odd", f"/types/{STRING}?hash={'a' * 32}", "/nodes/talker"),
    ]),
    ("unreachable", {}, [("/nodes/mute", None, "no answer"), ("/nodes/mute", "/topics/idle", "refused")]),
    ("services", {}, [LOST, RESET]),
    ("services", {"type": "Trigger"}, [RESET]),
    ("parameters", {"prefix": "/robot/"}, NAMED),
    ("parameters", {}, [*NAMED, ("/robotic", "true")]),
]  # fmt: skip
"""Stored queries, their parameters, and their rows."""


@pytest.mark.slow
def test_queries_about_the_graph_have_these_rows(http: httpx.Client) -> None:
    for name, given, expected in ANSWERS:
        assert ask(http, name, **given) == expected, (name, given)
    assert len(ask(http, "who-publishes")) == 3


def test_the_inventory_counts_each_thing_once_and_what_there_is_none_of_too(http: httpx.Client) -> None:
    counted = dict(ask(http, "inventory"))  # type: ignore[arg-type]
    expected = {"ros:Bag": "0", "ros:Node": "5", "ros:Parameter": "5", "ros:Service": "2", "ros:Topic": "5"}
    assert expected.items() <= counted.items()


def test_a_topic_is_silent_after_as_many_seconds_as_asked(http: httpx.Client) -> None:
    assert ask(http, "silent-topics", seconds="1e9") == []
    assert {row[:2] for row in ask(http, "silent-topics", seconds="-10")} == {
        ("/topics/cmd_vel", "/cmd_vel"),
        ("/topics/scan", "/scan"),
    }


def test_the_fastest_topics_come_first(http: httpx.Client) -> None:
    (fast, fast_rate), (slow, slow_rate) = [row[1:] for row in ask(http, "fastest-topics")]
    assert (fast, slow) == ("/cmd_vel", "/scan")
    assert float(str(fast_rate)) > float(str(slow_rate)) > 0
    assert [row[1] for row in ask(http, "fastest-topics", least=str(fast_rate))] == ["/cmd_vel"]


def test_managed_nodes_are_shown_with_state_and_transitions(http: httpx.Client) -> None:
    camera = ("/nodes/camera", "/camera", "inactive")
    rows = ask(http, "lifecycles")
    assert [(*row[:3], sorted(str(row[3] or "").split()), row[4]) for row in rows] == [
        (*camera, ["activate", "cleanup"], None),
        ("/nodes/lidar", "/lidar", None, [], "it does not answer"),
    ]
    assert [row[:3] for row in ask(http, "lifecycles", state="inactive")] == [camera]
    assert ask(http, "lifecycles", state="active") == []


def test_what_can_be_done_is_told_with_the_request_that_does_it(http: httpx.Client) -> None:
    camera = "/nodes/camera"
    node = f"{http.base_url}nodes/camera"
    expected = [(camera, label, "POST", node, f"{node}?offer") for label in ("activate", "cleanup")]
    assert set(expected) <= set(ask(http, "what-can-be-done"))
    assert ask(http, "what-can-be-done", below="/nodes/camera") == expected
    assert ask(http, "what-can-be-done", below="/elsewhere") == []


def test_calls_come_newest_first(http: httpx.Client) -> None:
    assert [(row[1], row[2], row[5]) for row in ask(http, "calls")] == [
        ("/services/reset", "ros:Refused", "it is jammed"),
        ("/services/reset", "ros:Succeeded", None),
    ]


def test_what_was_moved_comes_newest_first_and_refusals_moved_nothing(http: httpx.Client) -> None:
    topic = "/topics/cmd_vel"
    found = ask(http, "who-moved-what", about="cmd_vel")
    assert {row[1:3] for row in found} == {("anybody", topic)}
    assert {str(row[3]) for row in found} >= {"publish a geometry_msgs/msg/Twist on /cmd_vel"}
    moments = [str(row[0]) for row in found]
    assert moments == sorted(moments, reverse=True)
    assert len(set(moments)) == 2
    assert ask(http, "who-moved-what", about="/other") == []


def test_fields_come_in_the_order_of_the_definition(http: httpx.Client) -> None:
    vector = "geometry_msgs/msg/Vector3"
    assert ask(http, "message-fields", type="Twist") == [
        (TWIST, "0", "linear", vector, vector),
        (TWIST, "1", "angular", vector, vector),
    ]
    assert len(ask(http, "message-fields", type="LaserScan")) == 10


def test_the_newest_message_is_shown_by_the_paths_of_its_fields(http: httpx.Client) -> None:
    values = dict(ask(http, "latest-values", topic="/topics/cmd_vel"))  # type: ignore[arg-type]
    assert values.pop("linear.x") == "0.5"
    assert set(values) == {"linear.y", "linear.z", "angular.x", "angular.y", "angular.z"}
    scan = dict(ask(http, "latest-values", topic="/topics/scan"))  # type: ignore[arg-type]
    assert scan["ranges"] == '[3.0,"INF",0.25]'
    assert "header.stamp.sec" in scan
    assert ask(http, "latest-values", topic="/topics/idle") == []


def test_the_nearest_obstacle_is_the_least_of_the_ranges(http: httpx.Client) -> None:
    assert [row[:2] for row in ask(http, "nearest-obstacle")] == [("/topics/scan", "0.25")]


@pytest.mark.slow
def test_recordings_are_shown_with_their_topics(start_server: Callable[..., Any], tmp_path: Path) -> None:
    http = start_server(str(record(tmp_path / "run"))).http
    once_started(lambda: http.get("/sparql", params={"query": "ASK {}"}))
    found = {row[1]: row[:4] for row in ask(http, "recordings")}
    assert len(found) == 8
    assert found["/odom"] == ("/bags/run/", "/odom", "nav_msgs/msg/Odometry", "3")
    assert [row[:4] for row in ask(http, "recordings", topic="/odom")] == [found["/odom"]]
    assert ask(http, "recordings", topic="/scan") == []
    messages = ask(http, "past-messages", topic="/topics/odom", seconds=str(10**9))
    assert len(messages) == 3
    assert ask(http, "past-rates", seconds=str(10**9))
    assert ask(http, "past-faults", minutes=str(10**8)) == []


def test_the_computation_graph_is_built_once_a_triple(http: httpx.Client) -> None:
    answer = http.get("/queries/graph", headers={"Accept": "application/n-triples"})
    triples = [quad.triple for quad in parse(answer.content, RdfFormat.N_TRIPLES)]
    assert len(triples) == len(set(triples)) == 10
    ros, talker = PREFIXES["ros"], NamedNode(f"{http.base_url}nodes/talker")
    for does, thing in (("publishes", "topics/scan"), ("provides", "services/reset")):
        assert Triple(talker, NamedNode(f"{ros}{does}"), NamedNode(f"{http.base_url}{thing}")) in triples


def test_every_shipped_query_is_asked_here(http: httpx.Client) -> None:
    text = Path(__file__).read_text("utf-8")
    listed = http.get("/queries/", headers={"Accept": "application/n-triples"}).text
    names = {line.split("/queries/")[-1].split(">")[0] for line in listed.splitlines() if "ldp#contains" in line}
    assert len(names) > 20
    assert [name for name in names if f'"{name}"' not in text and f"/queries/{name}" not in text] == []
