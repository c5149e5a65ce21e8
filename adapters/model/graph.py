"""Computation graph: nodes, topics, services, actions and lifecycles, as an immutable snapshot."""

from __future__ import annotations

import time
from collections.abc import Container, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from types import MappingProxyType
from typing import Any, TypeVar

from rosld.adapters.model.errors import NotFound, Refused
from rosld.adapters.model.names import action_of
from rosld.adapters.model.parameter import Descriptor
from rosld.adapters.model.qos import Qos
from rosld.adapters.model.schema import TypeRef


class GoalStatus(Enum):
    """Status of a goal, in the terms of action_msgs/GoalStatus, to which actionlib's states are mapped.

    actionlib: PENDING is ACCEPTED, ACTIVE is EXECUTING, PREEMPTING and RECALLING are CANCELING, PREEMPTED and RECALLED
    are CANCELED. LOST: the server has disappeared, or no longer knows the goal.
    """

    ACCEPTED = "accepted"
    EXECUTING = "executing"
    CANCELING = "canceling"
    SUCCEEDED = "succeeded"
    CANCELED = "canceled"
    ABORTED = "aborted"
    REJECTED = "rejected"
    LOST = "lost"

    @property
    def is_final(self) -> bool:
        """Whether no other status follows."""
        return self not in (GoalStatus.ACCEPTED, GoalStatus.EXECUTING, GoalStatus.CANCELING)

    @property
    def is_settled(self) -> bool:
        """Whether the server reported the end of the goal; a lost goal may still be pursued."""
        return self.is_final and self is not GoalStatus.LOST


GOAL_STATUSES = {
    1: GoalStatus.ACCEPTED,
    2: GoalStatus.EXECUTING,
    3: GoalStatus.CANCELING,
    4: GoalStatus.SUCCEEDED,
    5: GoalStatus.CANCELED,
    6: GoalStatus.ABORTED,
}
"""Statuses by their numbers in action_msgs/GoalStatus."""


@dataclass(frozen=True, slots=True)
class Action:
    """An action: its type, its servers and clients; `unusable` is the reason why no goal can be sent.

    Its inner topics and services are in the graph as well; in ROS 2 they have hidden names, and none can be called.
    """

    name: str
    type: TypeRef | None = None
    servers: tuple[str, ...] = ()
    clients: tuple[str, ...] = ()
    unusable: str | None = None


@dataclass(frozen=True, slots=True)
class GoalId:
    """A goal of an action: `id` is its id in the action server (ROS 1: any text; ROS 2: 32 hex digits)."""

    action: str
    id: str


@dataclass(frozen=True, slots=True)
class GoalEvent:
    """An update about a goal: any of its status, the server's message, the latest feedback, the result.

    `feedback` and `result` are messages of the action's type in the adapter's encoding. `received_ns` is wall-clock
    time. `own`: rosld sent the goal.
    """

    received_ns: int
    status: GoalStatus | None = None
    words: str | None = None
    feedback: bytes | None = None
    result: bytes | None = None
    goal: bytes | None = None
    own: bool = False


_UNDERWAY = range(10, 16)


@dataclass(frozen=True, slots=True)
class LifecycleState:
    """A lifecycle state: the node's label ("inactive"), and its number in lifecycle_msgs/msg/State."""

    label: str
    id: int

    @property
    def is_underway(self) -> bool:
        """Whether a transition is in progress, whose outcome only the node decides."""
        return self.id in _UNDERWAY


@dataclass(frozen=True, slots=True)
class Transition:
    """A lifecycle transition: the node's label ("activate"), its number, and its target state."""

    label: str
    id: int
    goal: LifecycleState


@dataclass(frozen=True, slots=True)
class Lifecycle:
    """Lifecycle of a managed node: its state and the transitions that are available now, as reported by the node.

    `service` is the service that changes the state. `unknown` is the reason why the state is unknown now; then `state`
    is the last one reported, or None if none ever was.
    """

    service: str
    state: LifecycleState | None = None
    transitions: tuple[Transition, ...] = ()
    unknown: str | None = None


def without_lifecycle(nodes: Container[str], node: str) -> NotFound | Refused:
    """Return the error of `Adapter.change_state` for a node that is unmanaged or missing."""
    if node not in nodes:
        return NotFound(f"there is no node {node}")
    return Refused(f"{node} is not a managed node: it has no lifecycle")


_V = TypeVar("_V")

_ACTIONLIB = frozenset({"goal", "cancel", "status", "feedback", "result"})
"""Last segments of the topics of a ROS 1 action."""


class Kind(Enum):
    """Kind of a named thing in ROS."""

    NODE = "node"
    TOPIC = "topic"
    SERVICE = "service"
    ACTION = "action"
    PARAMETER = "parameter"
    TYPE = "type"


class Operation(Enum):
    """Operation that ROS permits on a thing; the result of `Adapter.allows`."""

    SUBSCRIBE = "subscribe"
    PUBLISH = "publish"
    CALL = "call"
    SEND_GOAL = "send-goal"
    CHANGE_STATE = "change-state"
    GET_PARAMETER = "get-parameter"
    SET_PARAMETER = "set-parameter"
    DELETE_PARAMETER = "delete-parameter"


@dataclass(frozen=True, slots=True)
class Ref:
    """A thing of the robot: its kind and its ROS name."""

    kind: Kind
    name: str


@dataclass(frozen=True, slots=True)
class Live:
    """The graph shows the robot as it is now."""


@dataclass(frozen=True, slots=True)
class Stale:
    """The robot has been unreachable since `since_ns` (wall clock, ns); the graph is the last one known."""

    since_ns: int
    why: str


@dataclass(frozen=True, slots=True)
class Master:
    """The name service of the system (ROS 1's master); `uri` is its URI as in ROS_MASTER_URI."""

    uri: str
    run_id: str | None = None


@dataclass(frozen=True, slots=True)
class Node:
    """A node. `unreachable` is the reason why it does not respond, None if it does or was not contacted.

    `lifecycle` is that of a managed node (ROS 2), else None.
    """

    name: str
    uri: str | None = None
    unreachable: str | None = None
    lifecycle: Lifecycle | None = None


@dataclass(frozen=True, slots=True)
class Endpoint:
    """A node's publisher or subscriber on a topic; `type` is the type stated by this endpoint, if any.

    `qos` is its quality of service, in ROS 2.
    """

    node: str
    type: TypeRef | None = None
    latched: bool = False
    unreachable: str | None = None
    qos: Qos | None = None


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic. `types` are all types that its endpoints use: several are a conflict, none means unknown.

    `unreadable` is the reason why its messages cannot be decoded, or None.
    """

    name: str
    types: tuple[TypeRef, ...] = ()
    publishers: tuple[Endpoint, ...] = ()
    subscribers: tuple[Endpoint, ...] = ()
    unreadable: str | None = None

    @property
    def type(self) -> TypeRef | None:
        """The only type; None without a type, or if types conflict."""
        return self.types[0] if len(self.types) == 1 else None


@dataclass(frozen=True, slots=True)
class Service:
    """A service; `uncallable` is the reason why it cannot be called, or None."""

    name: str
    type: TypeRef | None = None
    providers: tuple[str, ...] = ()
    uncallable: str | None = None


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter that is a leaf, not a tree.

    `node` is its owner if parameters belong to nodes (ROS 2), or the node that uses it (dynamic_reconfigure).

    `descriptor` is the node's declaration of it, None if it is undeclared or not known yet.
    """

    name: str
    node: str | None = None
    descriptor: Descriptor | None = None


def freeze(mapping: Mapping[str, _V]) -> Mapping[str, _V]:
    """Return a read-only copy of `mapping`."""
    return MappingProxyType(dict(mapping))


def _empty() -> Mapping[str, Any]:
    return MappingProxyType({})


@dataclass(frozen=True, slots=True)
class Graph:
    """Snapshot of the computation graph; `revision` increases with every change.

    `own_node` is the name of rosld's own node, which is in the graph only while it has registered something.
    `simulated_time` is the value of `/use_sim_time`.
    """

    revision: int
    state: Live | Stale = field(default_factory=Live)
    master: Master | None = None
    own_node: str = "/rosld"
    simulated_time: bool = False
    nodes: Mapping[str, Node] = field(default_factory=_empty)
    topics: Mapping[str, Topic] = field(default_factory=_empty)
    services: Mapping[str, Service] = field(default_factory=_empty)
    actions: Mapping[str, Action] = field(default_factory=_empty)
    parameters: Mapping[str, Parameter] = field(default_factory=_empty)

    def updated(self, **parts: Any) -> Graph:
        """Return this graph as live with these parts; itself if nothing has changed. Equal parts are shared."""
        for name, part in parts.items():
            if isinstance(part, Mapping):
                parts[name] = _shared(getattr(self, name), part)
        graph = replace(self, state=Live(), **parts)
        return self if graph == self else replace(graph, revision=self.revision + 1)

    def as_stale(self, why: str) -> Graph:
        """Return this graph as the last known one of a robot that is unreachable from now on."""
        if isinstance(self.state, Stale):
            return self
        return replace(self, state=Stale(time.time_ns(), why), revision=self.revision + 1)

    def is_of_action(self, name: str) -> bool:
        """Whether a topic is part of an action: by its name in ROS 2, or as one of actionlib's five topics.

        For actionlib, all five topics must exist.
        """
        # By names alone, because this protects goals from direct writes: a topic of unknown type may be a goal's. Which
        # topics are resources also depends on types (server/hypermedia/conventions.py).
        if action_of(name) is not None:
            return True
        parent, _, last = name.rpartition("/")
        return last in _ACTIONLIB and all(f"{parent}/{part}" in self.topics for part in _ACTIONLIB)


def _shared(previous: Mapping[str, _V], values: Mapping[str, _V]) -> Mapping[str, _V]:
    """Return these values, sorted; reuse equal previous values, and the mapping if all are equal."""
    shared = {name: old if (old := previous.get(name)) == values[name] else values[name] for name in sorted(values)}
    if len(shared) == len(previous) and all(previous.get(name) is value for name, value in shared.items()):
        return previous
    return freeze(shared)
