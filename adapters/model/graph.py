"""The computation graph: what nodes, topics, services and parameters there are, as one immutable value.

A `Graph` is a snapshot. Two snapshots share the values that did not change, so that a reader finds what
changed by comparing entries with `is` or `==`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from types import MappingProxyType
from typing import TypeVar

from rosld.adapters.model.action import Action
from rosld.adapters.model.lifecycle import Lifecycle
from rosld.adapters.model.names import action_of
from rosld.adapters.model.parameter import Descriptor
from rosld.adapters.model.qos import Qos
from rosld.adapters.model.schema import TypeRef

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
    """What ROS itself can do with a thing; `Adapter.allows` answers with these."""

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
        """Its one type, or None where there is no type or a conflict."""
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
    """A read-only copy of `mapping`."""
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
