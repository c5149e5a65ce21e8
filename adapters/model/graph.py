"""The computation graph: nodes, topics, services, actions and lifecycles, as an immutable snapshot."""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass, field
from enum import Enum
from types import MappingProxyType
from typing import TypeVar

from rosld.adapters.model.errors import NotFound, Refused
from rosld.adapters.model.names import action_of
from rosld.adapters.model.parameter import Descriptor
from rosld.adapters.model.qos import Qos
from rosld.adapters.model.schema import TypeRef


class GoalStatus(Enum):
    """How a goal stands. The words are action_msgs/GoalStatus'; actionlib's states are told in them.

    actionlib: PENDING is ACCEPTED, ACTIVE is EXECUTING, PREEMPTING and RECALLING are CANCELING, PREEMPTED and RECALLED
    are CANCELED. LOST: the server is gone, or no longer knows the goal.
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
        """Whether nothing comes after it."""
        return self not in (GoalStatus.ACCEPTED, GoalStatus.EXECUTING, GoalStatus.CANCELING)

    @property
    def is_settled(self) -> bool:
        """Whether it has ended as its server says; a goal that is lost may be pursued still."""
        return self.is_final and self is not GoalStatus.LOST


@dataclass(frozen=True, slots=True)
class Action:
    """An action: its type, the nodes that serve it and those that send goals; `unusable` says why no goal can be sent.

    Its inner topics and services are in the graph as well: under hidden names in ROS 2, where none of them is called.
    """

    name: str
    type: TypeRef | None = None
    servers: tuple[str, ...] = ()
    clients: tuple[str, ...] = ()
    unusable: str | None = None


@dataclass(frozen=True, slots=True)
class GoalId:
    """A goal of an action: `id` is what the action server knows it by (ROS 1: any text; ROS 2: 32 hex digits)."""

    action: str
    id: str


@dataclass(frozen=True, slots=True)
class GoalEvent:
    """What became known of a goal: any of its status, the server's words, the latest feedback, the result.

    `feedback` and `result` are messages of the action's type in the adapter's encoding. `received_ns` is wall-clock
    time. `own`: it was sent by rosld.
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
    """A state as its node calls it ("inactive"), with its number in lifecycle_msgs/msg/State."""

    label: str
    id: int

    @property
    def is_underway(self) -> bool:
        """Whether a transition is being made: what then follows is for the node alone to say."""
        return self.id in _UNDERWAY


@dataclass(frozen=True, slots=True)
class Transition:
    """A transition as its node calls it ("activate"), its number there, and the state that it leads to."""

    label: str
    id: int
    goal: LifecycleState


@dataclass(frozen=True, slots=True)
class Lifecycle:
    """How a managed node stands: its state and the transitions that are legal now, as it told them itself.

    `service` is the service that carries them out. `unknown` says in words why its state cannot be told now; a state
    beside it is the last one told. Without a state nothing was told ever.
    """

    service: str
    state: LifecycleState | None = None
    transitions: tuple[Transition, ...] = ()
    unknown: str | None = None


def without_lifecycle(nodes: Container[str], node: str) -> NotFound | Refused:
    """Return the error of `Adapter.change_state` for a node that is unmanaged or missing."""
    if node not in nodes:
        return NotFound(f"there is no node {node}")
    return Refused(f"{node} is no managed node: it has no lifecycle")


_V = TypeVar("_V")

_ACTIONLIB = frozenset({"goal", "cancel", "status", "feedback", "result"})
"""The last segments of the topics that an action of ROS 1 is made of."""


class Kind(Enum):
    """The kinds of thing that have a ROS name."""

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
    """The graph is as the robot is now."""


@dataclass(frozen=True, slots=True)
class Stale:
    """The robot cannot be seen since `since_ns` (wall clock, nanoseconds); the graph is the last one known."""

    since_ns: int
    why: str


@dataclass(frozen=True, slots=True)
class Master:
    """The name service of the system (ROS 1's master); `uri` as it would be given in ROS_MASTER_URI."""

    uri: str
    run_id: str | None = None


@dataclass(frozen=True, slots=True)
class Node:
    """A node. `unreachable` says in words why it does not answer, None while it does or nobody asked.

    `lifecycle` is that of a managed node (ROS 2), None for all others.
    """

    name: str
    uri: str | None = None
    unreachable: str | None = None
    lifecycle: Lifecycle | None = None


@dataclass(frozen=True, slots=True)
class Endpoint:
    """A node's publisher or subscriber on a topic; `type` is what this endpoint says, where it says so.

    `qos` is its quality of service where the system has that (ROS 2).
    """

    node: str
    type: TypeRef | None = None
    latched: bool = False
    unreachable: str | None = None
    qos: Qos | None = None


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic. `types` holds every type its endpoints use: two or more are a conflict, none means unknown.

    `unreadable` says in words why its messages cannot be decoded, None while they can.
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
    """A service; `uncallable` says in words why it cannot be called, None while it can."""

    name: str
    type: TypeRef | None = None
    providers: tuple[str, ...] = ()
    uncallable: str | None = None


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter that is a leaf: not a tree.

    `node` is its owner where parameters belong to nodes (ROS 2), or a node heeds it (dynamic_reconfigure).

    `descriptor` is what that node declares of it, None where nothing is declared, or not known yet.
    """

    name: str
    node: str | None = None
    descriptor: Descriptor | None = None


def freeze(mapping: Mapping[str, _V]) -> Mapping[str, _V]:
    """Return a read-only copy of `mapping`."""
    return MappingProxyType(dict(mapping))


@dataclass(frozen=True, slots=True)
class Graph:
    """The computation graph at one moment; `revision` rises by one whenever anything in it changes.

    `own_node` is the name under which rosld itself appears among the nodes and endpoints (it is in the graph
    only while it has registered something). `simulated_time` is true while `/use_sim_time` holds.
    """

    revision: int
    state: Live | Stale = field(default_factory=Live)
    master: Master | None = None
    own_node: str = "/rosld"
    simulated_time: bool = False
    nodes: Mapping[str, Node] = field(default_factory=dict)
    topics: Mapping[str, Topic] = field(default_factory=dict)
    services: Mapping[str, Service] = field(default_factory=dict)
    actions: Mapping[str, Action] = field(default_factory=dict)
    parameters: Mapping[str, Parameter] = field(default_factory=dict)

    def is_of_action(self, name: str) -> bool:
        """Whether a topic is a part of an action: of one of ROS 2 by its name, or of one of actionlib.

        The latter has five topics, whose siblings are all there.
        """
        # By names alone, for what may not be written to: a topic whose type is not known yet may be a goal's. Which
        # topics are resources goes by types as well (server/hypermedia/conventions.py).
        if action_of(name) is not None:
            return True
        parent, _, last = name.rpartition("/")
        return last in _ACTIONLIB and all(f"{parent}/{part}" in self.topics for part in _ACTIONLIB)
