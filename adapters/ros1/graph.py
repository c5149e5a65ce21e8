"""Computation graph from the master's state and facts about endpoints, and the topics of actionlib. No I/O."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from msgspec import Struct, field

from rosld.adapters.model import Action, Endpoint, GoalStatus, Graph, Node, Service, Topic, TypeRef
from rosld.adapters.ros1.types import EndpointFacts, Facts, ServiceFacts, type_name
from rosld.adapters.ros1.wire import decode, encode, read_after_header

_GOAL_ID, _STATUSES = "actionlib_msgs/GoalID", "actionlib_msgs/GoalStatusArray"
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
            unusable = None if servers else "no node serves it: no node publishes its status"
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


def _status(message: Any) -> Status:
    return Status(message.goal_id.id, message.status, message.text)


def read_statuses(data: bytes) -> list[Status]:
    """Return the statuses in a GoalStatusArray. Raises ValueError."""
    return [_status(each) for each in decode("actionlib_msgs/msg/GoalStatusArray", data).status_list]


def read_feedback_or_result(data: bytes) -> tuple[Status, bytes]:
    """Return the goal and the message in an XActionFeedback or XActionResult. Raises ValueError."""
    status, message = read_after_header("actionlib_msgs/msg/GoalStatus", data)
    return _status(status), message


def read_goal(data: bytes) -> tuple[str, bytes]:
    """Return the id and the goal in an XActionGoal. Raises ValueError."""
    id, goal = read_after_header("actionlib_msgs/msg/GoalID", data)
    return id.id, goal


def goal_message(id: str, stamp_ns: int, goal: bytes) -> bytes:
    """Return an XActionGoal."""
    stamp = {"sec": stamp_ns // 1_000_000_000, "nanosec": stamp_ns % 1_000_000_000}
    header = encode("std_msgs/msg/Header", {"stamp": stamp})
    return header + encode("actionlib_msgs/msg/GoalID", {"stamp": stamp, "id": id}) + goal


def cancel_message(id: str) -> bytes:
    """Return a GoalID that cancels this goal, or all goals if the id is empty."""
    return encode("actionlib_msgs/msg/GoalID", {"id": id})


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


def compose(
    previous: Graph, system: SystemState, facts: Facts, unreadable: Mapping[TypeRef, str], **others: object
) -> Graph:
    """Return the graph of a system, which is `previous` itself if nothing changed; `others` are further parts of it."""

    known = ((name, facts.services.get(name, _UNPROBED)) for name in system.services)
    topics = {*system.publishers, *system.subscribers}  # the master never forgets the types of former topics
    return previous.updated(
        nodes={name: Node(name, facts.uris.get(name), facts.unreachable.get(name)) for name in system.nodes()},
        topics={name: _topic(name, system, facts, unreadable) for name in topics},
        services={name: Service(name, fact.type, system.services[name], fact.uncallable) for name, fact in known},
        actions=actions_of(system.publishers, system.subscribers, system.topic_types),
        **others,
    )


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
        name = type_name(stated) if stated else None
        if name and all(each.name != name for each in types):
            types[TypeRef(name)] = None
    return tuple(types)
