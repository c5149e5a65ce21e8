"""Computation graph from the master's state and facts about endpoints, and the topics of actionlib. No I/O."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple, TypeVar

from msgspec import Struct, field

from rosld.adapters.model import (
    Action,
    Endpoint,
    GoalStatus,
    Graph,
    Live,
    Master,
    Node,
    Parameter,
    Service,
    Stale,
    Topic,
    TypeRef,
    freeze,
)
from rosld.adapters.ros1.tcpros import WireReader
from rosld.adapters.ros1.types import EndpointFacts, Facts, ServiceFacts, message_type

_TIME = struct.Struct("<II")
_LENGTH = struct.Struct("<I")
_GOAL_ID, _STATUSES = "actionlib_msgs/GoalID", "actionlib_msgs/GoalStatusArray"
_MAX_STATUSES = 10_000
STATUSES: Mapping[int, GoalStatus] = {
    0: GoalStatus.ACCEPTED,  # PENDING
    1: GoalStatus.EXECUTING,  # ACTIVE
    2: GoalStatus.CANCELED,  # PREEMPTED
    3: GoalStatus.SUCCEEDED,
    4: GoalStatus.ABORTED,
    5: GoalStatus.REJECTED,
    6: GoalStatus.CANCELING,  # PREEMPTING
    7: GoalStatus.CANCELING,  # RECALLING
    8: GoalStatus.CANCELED,  # RECALLED
    9: GoalStatus.LOST,
}
"""Status of action_msgs/GoalStatus for each number of actionlib_msgs/GoalStatus."""


def actions_of(
    publishers: Mapping[str, Sequence[str]], subscribers: Mapping[str, Sequence[str]], types: Mapping[str, str]
) -> Mapping[str, Action]:
    """Return the actions among topics by name. An action is five topics of matching types.

    `publishers` and `subscribers` are the nodes by topic, `types` are ROS 1's names of types. Publishers of the status
    serve the action; publishers of goals are clients.
    """
    actions: dict[str, Action] = {}
    for topic, stated in types.items():
        name, slash, last = topic.rpartition("/")
        package, _, short = stated.partition("/")
        if not (name and slash and last == "goal" and short.endswith("ActionGoal")):
            continue
        kind = short.removesuffix("ActionGoal")
        expected = {
            "cancel": _GOAL_ID,
            "status": _STATUSES,
            "feedback": f"{package}/{kind}ActionFeedback",
            "result": f"{package}/{kind}ActionResult",
        }
        are_there = all(f"{name}/{end}" in publishers or f"{name}/{end}" in subscribers for end in expected)
        if kind and are_there and all(types.get(f"{name}/{end}") == each for end, each in expected.items()):
            servers = tuple(publishers.get(f"{name}/status", ()))
            unusable = None if servers else "no node serves it: nobody publishes its status"
            clients = tuple(publishers.get(topic, ()))
            actions[name] = Action(name, TypeRef(f"{package}/action/{kind}"), servers, clients, unusable)
    return actions


class Status(NamedTuple):
    """Status of a goal: actionlib's number, and the server's text."""

    id: str
    number: int
    words: str

    @property
    def status(self) -> GoalStatus | None:
        """The status as the model's value, or None for an unknown number."""
        return STATUSES.get(self.number)


class _Reader(WireReader):
    """Reader of the common parts of actionlib's messages."""

    def header(self) -> None:
        """Skip a std_msgs/Header."""
        self.skip(4 + _TIME.size)
        self.text()

    def goal_id(self) -> str:
        """Return the id in an actionlib_msgs/GoalID."""
        self.skip(_TIME.size)
        return self.text()

    def status(self) -> Status:
        """Return an actionlib_msgs/GoalStatus."""
        return Status(self.goal_id(), self.skip(1)[0], self.text())


def read_statuses(data: bytes) -> list[Status]:
    """Return the statuses in a GoalStatusArray. Raises ValueError."""
    reader = _Reader(data)
    reader.header()
    return reader.array(reader.status, _MAX_STATUSES)


def read_feedback_or_result(data: bytes) -> tuple[Status, bytes]:
    """Return the goal and the message in an XActionFeedback or XActionResult. Raises ValueError."""
    reader = _Reader(data)
    reader.header()
    return reader.status(), reader.rest()


def read_goal(data: bytes) -> tuple[str, bytes]:
    """Return the id and the goal in an XActionGoal. Raises ValueError."""
    reader = _Reader(data)
    reader.header()
    return reader.goal_id(), reader.rest()


def goal_message(id: str, stamp_ns: int, goal: bytes) -> bytes:
    """Return an XActionGoal."""
    stamp = _TIME.pack(stamp_ns // 1_000_000_000, stamp_ns % 1_000_000_000)
    return _LENGTH.pack(0) + stamp + _text("") + stamp + _text(id) + goal


def cancel_message(id: str) -> bytes:
    """Return a GoalID that cancels this goal, or all goals if the id is empty."""
    return _TIME.pack(0, 0) + _text(id)


def _text(value: str) -> bytes:
    data = value.encode("utf-8", "surrogateescape")
    return _LENGTH.pack(len(data)) + data


_V = TypeVar("_V")
_NOTHING = EndpointFacts()
_UNPROBED = ServiceFacts(None, "its type is not known yet: waiting for its node to report it")


class SystemState(Struct, frozen=True):
    """Response of getSystemState and getTopicTypes: nodes by name, types by topic."""

    publishers: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    subscribers: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    services: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    topic_types: Mapping[str, str] = field(default_factory=dict)

    def nodes(self) -> set[str]:
        """Return every node with a publisher, a subscriber or a service."""
        return {
            node for each in (self.publishers, self.subscribers, self.services) for of in each.values() for node in of
        }


class Observation(Struct, frozen=True):
    """All inputs of the graph except learnt facts."""

    master: Master
    own_node: str
    system: SystemState = field(default_factory=SystemState)
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    simulated_time: bool = False


def compose(previous: Graph, observation: Observation, facts: Facts, unreadable: Mapping[TypeRef, str]) -> Graph:
    """Return the graph of an observation, which is `previous` itself if nothing changed."""
    system = observation.system

    def topic(name: str) -> Topic:
        return _topic(name, system, facts, unreadable)

    def service(name: str) -> Service:
        fact = facts.services.get(name, _UNPROBED)
        return Service(name, fact.type, system.services[name], fact.uncallable)

    def node(name: str) -> Node:
        return Node(name, facts.uris.get(name), facts.unreachable.get(name))

    actions = actions_of(system.publishers, system.subscribers, system.topic_types)
    graph = replace(
        previous,
        state=Live(),
        master=observation.master,
        own_node=observation.own_node,
        simulated_time=observation.simulated_time,
        nodes=_shared(previous.nodes, system.nodes(), node),
        topics=_shared(previous.topics, _topic_names(system), topic),
        services=_shared(previous.services, system.services, service),
        actions=_shared(previous.actions, actions, lambda name: actions[name]),
        parameters=_shared(previous.parameters, observation.parameters, lambda name: observation.parameters[name]),
    )
    return previous if graph == previous else replace(graph, revision=previous.revision + 1)


def stale(previous: Graph, since_ns: int, why: str) -> Graph:
    """Return the last known graph, marked as stale."""
    if isinstance(previous.state, Stale):
        return previous
    return replace(previous, state=Stale(since_ns, why), revision=previous.revision + 1)


def _topic_names(system: SystemState) -> set[str]:
    return {*system.publishers, *system.subscribers}  # the master never forgets the types of former topics


def _topic(name: str, system: SystemState, facts: Facts, unreadable: Mapping[TypeRef, str]) -> Topic:
    nodes = system.publishers.get(name, ())
    endpoints = [facts.endpoints.get((name, node), _NOTHING) for node in nodes]
    publishers = tuple(
        Endpoint(node, endpoint.type, endpoint.latched, endpoint.unreachable)
        for node, endpoint in zip(nodes, endpoints, strict=True)
    )
    subscribers = tuple(Endpoint(node) for node in system.subscribers.get(name, ()))
    types = _types(system.topic_types.get(name), [endpoint.type for endpoint in endpoints])
    words = next((unreadable[each] for each in types if each in unreadable), None)
    if not types and (stated := system.topic_types.get(name)) and stated != "*":
        words = f"{stated!r} is not a type name"
    return Topic(name, types, publishers, subscribers, words)


def _types(stated: str | None, reported: list[TypeRef | None]) -> tuple[TypeRef, ...]:
    """Return every type in use: those stated by publishers and, while one is unknown, the master's."""
    types = dict.fromkeys(each for each in reported if each is not None)
    if None in reported or not reported:
        name = message_type(stated) if stated else None
        if name and all(each.name != name for each in types):
            types[TypeRef(name)] = None
    return tuple(types)


def _shared(previous: Mapping[str, _V], names: Iterable[str], make: Callable[[str], _V]) -> Mapping[str, _V]:
    """Return the values of these names, sorted; reuse equal previous values, and the mapping if all are equal."""
    values: dict[str, _V] = {}
    for name in sorted(names):
        new, old = make(name), previous.get(name)
        values[name] = old if old is not None and old == new else new
    if len(values) == len(previous) and all(previous.get(name) is value for name, value in values.items()):
        return previous
    return freeze(values)
