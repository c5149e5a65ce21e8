"""The queries that come with rosld, each asked of a small robot described by rosld itself."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from pyoxigraph import Literal, NamedNode, QuerySolutions, QueryTriples, RdfFormat, Store, Triple

from rosld.adapters.model import (
    Encoding,
    Endpoint,
    Graph,
    Lifecycle,
    LifecycleState,
    Message,
    MessageSchema,
    Node,
    Parameter,
    ParameterValue,
    Service,
    Topic,
    Transition,
    TypeRef,
)
from rosld.adapters.model.library import TypeLibrary
from rosld.ontology import describe
from rosld.ontology.document import Document, Envelope, LiftedMessage
from rosld.ontology.lift import lifter
from rosld.ontology.serialize import Syntax, serialize
from rosld.ontology.urls import Space
from rosld.ontology.vocab import PREFIXES
from rosld.server.sparql.analysis import Analyser
from rosld.server.sparql.intervals import Interval
from rosld.server.sparql.ros_functions import functions
from rosld.server.sparql.stored_query import bind_parameters, shipped_queries

BASE = "http://robot.example/below/"
SPACE = Space(BASE)
LIBRARY = TypeLibrary(ros_version=1)
QUERIES = shipped_queries()
TWIST, SCAN, STRING = "geometry_msgs/msg/Twist", "sensor_msgs/msg/LaserScan", "std_msgs/msg/String"
TRIGGER = "std_srvs/srv/Trigger"
SECOND = 1_000_000_000
AGES = {SPACE.topic("/scan"): 0.1, SPACE.topic("/cmd_vel"): 3600.0}
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
PARAMETERS: dict[str, ParameterValue] = {"robot": {"wheels": 4, "name": "rosie"}, "robotic": True}
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
GRAPH = Graph(
    1,
    nodes={node.name: node for node in NODES},
    topics={topic.name: topic for topic in TOPICS},
    services={service.name: service for service in SERVICES},
    parameters={name: Parameter(name) for name in ("/robot/wheels", "/robot/name", "/robotic")},
)


@dataclass(frozen=True)
class Track:
    name: str
    type: TypeRef
    count: int
    unreadable: str | None = None


@dataclass(frozen=True)
class Bag:
    name: str
    format: str
    count: int
    start_ns: int
    end_ns: int
    topics: Mapping[str, Track]
    first: int = 0
    silent: tuple[str, ...] = ()


BAG = Bag("walk", "rosbag1", 7, SECOND, 3 * SECOND, {"/odom": Track("/odom", TypeRef(TWIST), 7)})


def schema(name: str) -> MessageSchema:
    found = LIBRARY.find(TypeRef(name))
    assert isinstance(found, MessageSchema)
    return found


def filled(name: str, **values: object) -> Message:
    """A message of zeros but for `values`."""
    size = {TWIST: 48, SCAN: 52}[name]
    message = schema(name).codec.decode(bytes(size), Encoding.ROS1)
    for attribute, value in values.items():
        setattr(message, attribute, value)
    return message


def latest() -> Iterator[tuple[str, LiftedMessage]]:
    twist = filled(TWIST)
    twist.linear.x = 0.5  # type: ignore[attr-defined]
    scan = filled(SCAN, ranges=np.array([3.0, np.inf, 0.25], np.float32))
    for topic, name, message in (("/cmd_vel", TWIST, twist), ("/scan", SCAN, scan)):
        envelope = Envelope(SECOND, 1, SPACE.node("/talker"))
        yield topic, LiftedMessage("#message", lifter(schema(name)), message, envelope)


def documents() -> Iterator[Document]:
    messages = dict(latest())
    rates = {"/scan": 10.0, "/cmd_vel": 20.5}
    yield describe.entry_document(GRAPH, SPACE)
    for view in describe.node_views(GRAPH).values():
        yield describe.node_document(replace(view, offers=True), SPACE)
    for topic in GRAPH.topics.values():
        found = [messages[topic.name]] if topic.name in messages else []
        yield describe.topic_document(topic, SPACE, GRAPH, rates.get(topic.name, 0.0), found)
    for service in GRAPH.services.values():
        yield describe.service_document(service, SPACE, GRAPH)
    for room, names in (("nodes", GRAPH.nodes), ("topics", GRAPH.topics), ("services", GRAPH.services)):
        yield describe.namespace_document(room, (), describe.members_of(names)[()], SPACE)
    yield describe.parameter_container_document((), PARAMETERS, SPACE)
    yield describe.parameter_document("/robot/wheels", 4, SPACE)
    for name in (TWIST, SCAN, TRIGGER):
        yield describe.type_document(LIBRARY.find(TypeRef(name)), SPACE)
    yield describe.bag_document(BAG, SPACE)
    for number, status in ((1, 204), (2, 201), (3, 422)):
        yield describe.activity_document(written(number, status), SPACE)
    request = schema(f"{TRIGGER}_Request")
    for number, state in ((1, "Succeeded"), (2, "Failed")):
        asked = (request, request.codec.build(request.ref.name, {}))
        view = describe.CallView(str(number), "/reset", state, number * SECOND, asked, words="as it said")
        yield describe.call_document(view, SPACE)


def written(number: int, status: int) -> describe.Receipt:
    """The receipt of a write of a topic."""
    what = (SPACE.topic("/cmd_vel"),)
    return describe.Receipt(
        number, f"r{number}", "ann", None, number * SECOND, number * SECOND, "PUT", what[0], None, 0, None, None, False,
        (f"publish {number}",), what, 1, status, None, None,
    )  # fmt: skip


FUNCTIONS = {NamedNode(iri): function for iri, function in functions(AGES.get).items()}


@pytest.fixture(scope="module")
def store() -> Store:
    made = Store()
    for document in documents():
        triples = serialize(document, Syntax.N_TRIPLES)
        for graph in (document.url, f"{BASE}data/copies"):  # what is said twice must not be answered twice
            made.load(triples, RdfFormat.N_TRIPLES, to_graph=NamedNode(graph))
    return made


@pytest.fixture
def ask(store: Store) -> Callable[..., list[tuple[object, ...]]]:
    """The rows a stored query answers with these parameters; IRIs of the robot as paths, other terms as texts."""

    def asked(name: str, **given: str) -> list[tuple[object, ...]]:
        answer = store.query(
            bind_parameters(QUERIES[name], given, BASE), use_default_graph_as_union=True, custom_functions=FUNCTIONS
        )
        assert isinstance(answer, QuerySolutions)
        return [tuple(map(shown, row)) for row in answer]

    return asked


def shown(term: object) -> object:
    if isinstance(term, NamedNode):
        for start, written in ((SPACE.types, ""), (PREFIXES["ros"], "ros:"), (BASE, "/")):
            if term.value.startswith(start):
                return written + term.value[len(start) :]
    return term.value if isinstance(term, NamedNode | Literal) else term


Ask = Callable[..., list[tuple[object, ...]]]


def test_the_inventory_counts_each_thing_once_and_what_there_is_none_of_too(ask: Ask) -> None:
    assert dict(cast("Sequence[tuple[str, str]]", ask("inventory"))) == {
        "ros:Bag": "1",
        "ros:MessageType": "2",
        "ros:Node": "5",
        "ros:Parameter": "5",
        "ros:Service": "2",
        "ros:ServiceType": "1",
        "ros:Topic": "5",
    }


def test_a_topic_is_silent_after_as_many_seconds_as_asked(ask: Ask) -> None:
    [(topic, name, age)] = ask("silent-topics", seconds="1800")
    assert (topic, name) == ("/topics/cmd_vel", "/cmd_vel")
    assert float(str(age)) == pytest.approx(3600, abs=1800)
    assert ask("silent-topics", seconds="1e9") == []
    assert len(ask("silent-topics", seconds="-1")) == 2


def test_topics_without_any_message_are_unseen(ask: Ask) -> None:
    assert ask("unseen-topics") == [
        ("/topics/idle", "/idle", "/nodes/mute"),
        ("/topics/odd", "/odd", "/nodes/talker"),
    ]


def test_the_fastest_topics_come_first(ask: Ask) -> None:
    assert [row[1:] for row in ask("fastest-topics")] == [("/cmd_vel", "20.5"), ("/scan", "10")]
    assert [row[1] for row in ask("fastest-topics", least="15")] == ["/cmd_vel"]
    assert len(ask("fastest-topics", least="0")) == len(TOPICS)


def test_publishers_are_found_by_the_type_they_publish(ask: Ask) -> None:
    twist = (TWIST, "/topics/cmd_vel", "/nodes/talker")
    assert ask("who-publishes", type="Twist") == ask("who-publishes", type=TWIST) == [twist]
    assert ask("who-publishes", type="wist") == []
    assert twist in ask("who-publishes")
    assert len(ask("who-publishes")) == 3


def test_topics_nobody_listens_to_are_unheard_and_those_nobody_publishes_wait(ask: Ask) -> None:
    assert ask("unheard-topics") == [("/topics/cmd_vel", "/cmd_vel", "/nodes/talker")]
    assert ask("waiting-topics") == [("/topics/map", "/map", "/nodes/listener")]


def test_conversations_go_from_publisher_to_subscriber(ask: Ask) -> None:
    assert ask("conversations") == [
        ("/nodes/mute", "/topics/idle", "/nodes/listener"),
        ("/nodes/talker", "/topics/odd", "/nodes/listener"),
        ("/nodes/talker", "/topics/scan", "/nodes/listener"),
    ]


def test_a_node_is_known_by_what_it_does(ask: Ask) -> None:
    assert ask("node", node="/nodes/talker") == [
        ("provides", "/services/reset", TRIGGER),
        ("publishes", "/topics/cmd_vel", TWIST),
        ("publishes", "/topics/odd", None),
        ("publishes", "/topics/scan", SCAN),
    ]
    assert ask("node", node=SPACE.node("/listener")) == ask("node", node="/nodes/listener") != []


def test_conflicting_types_are_shown_with_the_nodes_that_use_them(ask: Ask) -> None:
    assert ask("conflicting-types") == [
        ("/topics/odd", f"/types/{TWIST}?hash={'b' * 32}", "/nodes/listener"),
        ("/topics/odd", f"/types/{STRING}?hash={'a' * 32}", "/nodes/talker"),
    ]


def test_what_cannot_be_reached_is_shown_with_the_reason(ask: Ask) -> None:
    assert ask("unreachable") == [("/nodes/mute", None, "no answer"), ("/nodes/mute", "/topics/idle", "refused")]


def test_managed_nodes_are_shown_with_state_and_transitions(ask: Ask) -> None:
    camera = ("/nodes/camera", "/camera", "inactive")
    rows = ask("lifecycles")
    assert [(*row[:3], sorted(str(row[3] or "").split()), row[4]) for row in rows] == [
        (*camera, ["activate", "cleanup"], None),
        ("/nodes/lidar", "/lidar", None, [], "it does not answer"),
    ]
    assert [row[:3] for row in ask("lifecycles", state="inactive")] == [camera]
    assert ask("lifecycles", state="active") == []


def test_what_can_be_done_is_told_with_the_request_that_does_it(ask: Ask) -> None:
    camera = "/nodes/camera"
    expected = [(camera, label, "POST", f"{BASE}nodes/camera") for label in ("activate", "cleanup")]
    assert ask("what-can-be-done") == expected
    assert ask("what-can-be-done", below="/camera") == expected
    assert ask("what-can-be-done", below="/elsewhere") == []


def test_services_are_found_by_type_and_without_one(ask: Ask) -> None:
    reset = ("/services/reset", "/reset", TRIGGER, "/nodes/talker", None)
    lost = ("/services/lost", "/lost", None, "/nodes/mute", "its node does not answer")
    assert ask("services") == [lost, reset]
    assert ask("services", type="Trigger") == [reset]


def test_calls_come_newest_first(ask: Ask) -> None:
    assert [(row[0], row[1], row[2], row[4], row[5]) for row in ask("calls")] == [
        ("/calls/2", "/services/reset", "ros:Failed", None, "as it said"),
        ("/calls/1", "/services/reset", "ros:Succeeded", None, "as it said"),
    ]


def test_what_was_moved_comes_newest_first_and_refusals_moved_nothing(ask: Ask) -> None:
    topic = "/topics/cmd_vel"
    rows = [(row[1], row[2], row[3], row[4]) for row in ask("who-moved-what", about="cmd_vel")]
    assert rows == [("ann", topic, "publish 2", "/activity/r2"), ("ann", topic, "publish 1", "/activity/r1")]
    assert ask("who-moved-what", about="/other") == []


def test_parameters_are_found_by_the_beginning_of_their_names(ask: Ask) -> None:
    robot = [("/robot/name", "rosie"), ("/robot/wheels", "4")]
    assert ask("parameters", prefix="/robot/") == robot
    assert ask("parameters") == [*robot, ("/robotic", "true")]


def test_fields_come_in_the_order_of_the_definition(ask: Ask) -> None:
    vector = "geometry_msgs/msg/Vector3"
    assert ask("message-fields", type="Twist") == [
        (TWIST, "0", "linear", vector, vector),
        (TWIST, "1", "angular", vector, vector),
    ]
    assert [row[2] for row in ask("message-fields", type=f"{TRIGGER}_Response")] == ["success", "message"]
    assert len(ask("message-fields")) == 2 + len(schema(SCAN).type.fields) + 2


def test_the_newest_message_is_shown_by_the_paths_of_its_fields(ask: Ask) -> None:
    values = dict(cast("Sequence[tuple[str, str]]", ask("latest-values", topic="/topics/cmd_vel")))
    assert values.pop("linear.x") == "0.5"
    assert set(values) == {"linear.y", "linear.z", "angular.x", "angular.y", "angular.z"}
    scan = dict(cast("Sequence[tuple[str, str]]", ask("latest-values", topic="/topics/scan")))
    assert scan["ranges"] == '[3.0,"INF",0.25]'
    assert "header.stamp.sec" in scan
    assert ask("latest-values", topic="/topics/idle") == []


def test_the_nearest_obstacle_is_the_least_of_the_ranges(ask: Ask) -> None:
    assert ask("nearest-obstacle") == [("/topics/scan", "0.25", "1970-01-01T00:00:01Z")]


def test_recordings_are_shown_with_their_topics(ask: Ask) -> None:
    walk = ("/bags/walk/", "/odom", TWIST, "7", "1970-01-01T00:00:01Z", "1970-01-01T00:00:03Z")
    assert ask("recordings") == ask("recordings", topic="/odom") == [walk]
    assert ask("recordings", topic="/scan") == []


def test_the_computation_graph_is_built_once_a_triple(store: Store) -> None:
    answer = store.query(bind_parameters(QUERIES["graph"], {}, BASE), use_default_graph_as_union=True)
    assert isinstance(answer, QueryTriples)
    triples = list(answer)
    assert len(triples) == len(set(triples)) == 10
    ros, talker = PREFIXES["ros"], NamedNode(SPACE.node("/talker"))
    assert Triple(talker, NamedNode(f"{ros}publishes"), NamedNode(SPACE.topic("/scan"))) in triples
    assert Triple(talker, NamedNode(f"{ros}provides"), NamedNode(SPACE.service("/reset"))) in triples


SAMPLES = {"topic": "/topics/x", "node": "/nodes/x"}


@pytest.mark.parametrize("name", QUERIES)
def test_a_shipped_query_is_understood_and_needs_no_more_than_it_asks_for(name: str) -> None:
    query = QUERIES[name]
    given = {one.name: SAMPLES[one.name] for one in query.parameters if one.default is None}
    analysis = Analyser(BASE, SPACE.types).analyse(bind_parameters(query, given, BASE))
    assert analysis.form in ("SELECT", "CONSTRUCT")
    looks_at_all = {"silent-topics", "unseen-topics", "fastest-topics"}
    assert analysis.needs.is_everything == (name in looks_at_all)
    assert analysis.needs.needs_messages == (name in {*looks_at_all, "latest-values", "nearest-obstacle"})
    assert analysis.needs.needs_parameters == (name in {"parameters", "latest-values"})


def test_the_newest_values_are_asked_of_their_topic_alone() -> None:
    analysis = Analyser(BASE, SPACE.types).analyse(
        bind_parameters(QUERIES["latest-values"], {"topic": "/topics/x"}, BASE)
    )
    assert analysis.needs.graphs == frozenset({SPACE.topic("/x")})


@pytest.mark.parametrize("name", ["past-rates", "past-faults", "past-messages"])
def test_queries_about_the_past_read_no_more_than_they_are_given(name: str) -> None:
    given = {"topic": "/topics/x"} if name == "past-messages" else {}
    asked = Analyser(BASE, SPACE.types).analyse(bind_parameters(QUERIES[name], given, BASE)).past
    assert asked is not None
    selections = asked.selections(Interval(1000 * SECOND, 1001 * SECOND))
    seconds = 600 if name == "past-faults" else 10
    assert [each.time.low for each in selections] == [(1000 - seconds) * SECOND] * (3 if name == "past-faults" else 1)
    assert all(each.types for each in selections) == (name == "past-faults")
    assert (selections[0].urls is not None) == (name == "past-messages")


def test_every_shipped_query_is_asked_here() -> None:
    text = Path(__file__).read_text("utf-8")
    assert [name for name in QUERIES if text.count(f'"{name}"') == 0] == []
