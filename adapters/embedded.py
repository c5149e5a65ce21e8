"""Base of adapters of embedded robots, which live on the server's own loop and need nothing else installed.

They answer at once: a deadline matters only if it has passed already, and all operations before `open` or after `close`
raise Unreachable.
"""

from __future__ import annotations

import asyncio
import time
from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from types import MappingProxyType
from typing import NamedTuple, cast

from msgspec import Struct

from rosld.adapters.base import Adapter, AdapterOptions, Capabilities, Published, Sink, Subscription, Watch
from rosld.adapters.model import (
    Action,
    ActionSchema,
    Encoding,
    Endpoint,
    GoalEvent,
    GoalId,
    GoalStatus,
    Graph,
    Kind,
    Message,
    MessageSchema,
    Node,
    NotFound,
    Operation,
    Parameter,
    Ref,
    Refused,
    Sample,
    Schema,
    Service,
    ServiceSchema,
    TimedOut,
    Topic,
    TypeRef,
    Unreachable,
    freeze,
)
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.model.plain import message_of
from rosld.adapters.slots import Slot

ROSLD = "/rosld"
"""The node that rosld appears as while it advertises a topic."""


_MAX_ADVERTISED = 10_000


class Interface(NamedTuple):
    """The type of a topic, service or action of an embedded robot, and its node."""

    type: str
    node: str
    latched: bool = False


class _AdvertisedTopic(Struct):
    """A topic that rosld advertises; `epoch` counts its advertisings, `sequence` its messages."""

    type: TypeRef
    latched: bool
    epoch: int
    matched: int
    sequence: int = 0


class EmbeddedRobot(Adapter):
    """Base class of embedded robots.

    A subclass says what the robot publishes, subscribes to and serves, by name, and overrides what it can do; by
    default it has no parameters and pursues no goals.
    """

    def __init__(
        self,
        capabilities: Capabilities,
        options: AdapterOptions,
        *,
        published: Mapping[str, Interface],
        subscribed: Mapping[str, Interface] = MappingProxyType({}),
        services: Mapping[str, Interface] = MappingProxyType({}),
        actions: Mapping[str, Interface] = MappingProxyType({}),
    ) -> None:
        self._capabilities = capabilities
        self._library = TypeLibrary(
            ros_version=1 if capabilities.encoding is Encoding.ROS1 else 2, folders=options.types
        )
        self._published, self._subscribed, self._services, self._actions = published, subscribed, services, actions
        interfaces = {**published, **subscribed, **services, **actions}
        self._types = {name: self._library.find(TypeRef(each.type)).ref for name, each in interfaces.items()}
        self._slots = {topic: Slot() for topic in (*published, *subscribed)}
        self._sequences: dict[str, int] = {}
        self._advertised: dict[str, _AdvertisedTopic] = {}
        self._advertisings = 0
        self._sink: Sink | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._graph = self._describe(1)

    @property
    def capabilities(self) -> Capabilities:
        """The capabilities of the ROS that the robot resembles, without a master or a middleware."""
        return self._capabilities

    @property
    def graph(self) -> Graph:
        """The robot, and rosld while it advertises something."""
        return self._graph

    async def open(self, sink: Sink, *, deadline: float) -> None:
        """Start the robot. Idempotent."""
        if self._sink is None:
            self._sink = sink
            self._start()

    async def close(self) -> None:
        """Stop and end the goal, with nothing left advertised. Idempotent."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if (goal := self._current_goal()) is not None:
            words = f"the {self._capabilities.system} is no longer there"
            for action in self._actions:
                self._announce(action, goal, GoalEvent(time.time_ns(), GoalStatus.LOST, words, own=True))
        for topic in tuple(self._advertised):
            await self.unadvertise(topic)
        self._sink = None

    def allows(self, ref: Ref) -> frozenset[Operation]:
        """Return the operations on a thing. Any topic can be published to."""
        if ref.kind is Kind.TOPIC:
            return frozenset({Operation.PUBLISH, *([Operation.SUBSCRIBE] if ref.name in self._graph.topics else [])})
        if ref.kind is Kind.SERVICE:
            return frozenset({Operation.CALL} if ref.name in self._services else ())
        if ref.kind is Kind.ACTION:
            return frozenset({Operation.SEND_GOAL} if ref.name in self._actions else ())
        return self._parameter_operations(ref.name) if ref.kind is Kind.PARAMETER else frozenset()

    async def schema(self, ref: TypeRef, *, deadline: float) -> Schema:
        """Return the schema of a type that is shipped or in the folders of `--types`."""
        return self._library.find(ref)

    def known_types(self) -> Sequence[TypeRef]:
        """Return the types of the robot's topics, services and actions, and of what rosld advertises."""
        return list(dict.fromkeys([*self._types.values(), *(each.type for each in self._advertised.values())]))

    async def subscribe(self, topic: str, *, depth: int = 1) -> Subscription:
        return self._slot(topic).subscribe(depth)

    async def publish(
        self, topic: str, type: TypeRef, data: bytes, *, latch: bool = False, deadline: float
    ) -> Published:
        """Publish without waiting: no subscriber can match later. Raises Refused for another type."""
        self._require_reachable(deadline)
        own = self._advertised.get(topic)
        if own is None or own.latched != latch or own.type != type:
            own = self._advertise(topic, type, latch)
        own.sequence += 1
        self._put(topic, data, own.type, ROSLD, own.sequence, own.epoch, latch)
        return Published(own.matched)

    async def advertise(self, topic: str, type: TypeRef, *, deadline: float) -> None:
        """Do nothing: the robot receives what is published at once."""
        self._require_reachable(deadline)

    async def unadvertise(self, topic: str) -> None:
        """Stop advertising, and drop the messages that rosld published."""
        if self._advertised.pop(topic, None) is None:
            raise NotFound(f"rosld does not advertise {topic}")
        slot = self._slots[topic]
        slot.drop(ROSLD)
        if not slot.subscriptions and topic not in self._published and topic not in self._subscribed:
            del self._slots[topic]
        self._revise()

    async def call(self, service: str, type: TypeRef, request: bytes, *, deadline: float) -> bytes:
        """Call a service of the robot. Raises Refused for another type, and for bytes that are no request."""
        self._require_reachable(deadline)
        schema = self._service(service, type)
        return self._encode(schema.response, self._answer(service, self._decode(schema.request, request, service)))

    async def send_goal(self, action: str, type: TypeRef, goal: bytes, *, deadline: float) -> GoalId:
        """Send a goal to the robot. Raises Refused where the robot rejects it, and for another type."""
        self._require_reachable(deadline)
        decoded = self._decode(self._action(action, type).goal, goal, action)
        id = self._accept(action, decoded)
        self._announce(action, id, GoalEvent(time.time_ns(), GoalStatus.ACCEPTED, goal=goal, own=True))
        return GoalId(action, id)

    async def cancel_goal(self, goal: GoalId, *, deadline: float) -> None:
        """Cancel a goal. Raises NotFound for any other than the current one."""
        self._require_reachable(deadline)
        self._action(goal.action)
        if not self._cancel(goal.id):
            raise NotFound(f"the {self._capabilities.system} is not pursuing the goal {goal.id}")
        self._announce(goal.action, goal.id, GoalEvent(time.time_ns(), GoalStatus.CANCELING, own=True))

    async def cancel_goals(self, action: str, *, deadline: float) -> None:
        """Cancel the goal that the robot pursues, if any."""
        self._require_reachable(deadline)
        self._action(action)
        current = self._current_goal()
        if current is not None:
            await self.cancel_goal(GoalId(action, current), deadline=deadline)

    async def follow_goals(self, action: str, *, deadline: float) -> Watch:
        """Return a watch without effect: all goals are announced in any case."""
        self._action(action)
        return ExitStack()

    @abstractmethod
    def _start(self) -> None:
        """Start publishing, on the running loop."""

    def _answer(self, service: str, request: Message) -> Mapping[str, object]:
        """Return the fields of the response to a request."""
        raise NotImplementedError

    def _accept(self, action: str, goal: Message) -> str:
        """Pursue a goal and return its id. Raises Refused."""
        raise NotImplementedError

    def _cancel(self, id: str) -> bool:
        """Cancel the current goal if it has this id; whether it has."""
        raise NotImplementedError

    def _current_goal(self) -> str | None:
        """Return the id of the goal that the robot pursues."""
        return None

    def _parameters_of_graph(self) -> Mapping[str, Parameter]:
        """Return the parameters of the computation graph."""
        return {}

    def _parameter_operations(self, name: str) -> frozenset[Operation]:
        """Return the operations on a parameter."""
        return frozenset()

    def _describe(self, revision: int) -> Graph:
        """Return the current computation graph."""
        interfaces = {**self._published, **self._subscribed, **self._services, **self._actions}
        nodes = dict.fromkeys(each.node for each in interfaces.values())
        topics = dict.fromkeys((*self._published, *self._subscribed, *sorted(self._advertised)))
        return Graph(
            revision,
            own_node=ROSLD,
            nodes=freeze({name: Node(name) for name in (*nodes, *([ROSLD] if self._advertised else []))}),
            topics=freeze({name: self._topic(name) for name in topics}),
            services=freeze(
                {name: Service(name, self._types[name], (each.node,)) for name, each in self._services.items()}
            ),
            actions=freeze(
                {name: Action(name, self._types[name], (each.node,)) for name, each in self._actions.items()}
            ),
            parameters=freeze(self._parameters_of_graph()),
        )

    def _topic(self, name: str) -> Topic:
        own = self._advertised.get(name)
        type = own.type if own else self._types[name]
        publishers = [
            *_endpoints(self._published.get(name), type),
            *([Endpoint(ROSLD, type, latched=own.latched)] if own else []),
        ]
        return Topic(name, (type,), tuple(publishers), tuple(_endpoints(self._subscribed.get(name), type)))

    def _publish(self, topic: str, fields: Mapping[str, object]) -> None:
        """Publish a message of the robot on a topic of its own."""
        interface = self._published[topic]
        data = self._encode(self._message(self._types[topic]), fields)
        sequence = self._sequences[topic] = self._sequences.get(topic, 0) + 1
        self._put(topic, data, self._types[topic], interface.node, sequence, 0, interface.latched)

    def _put(self, topic: str, data: bytes, type: TypeRef, node: str, sequence: int, epoch: int, latched: bool) -> None:
        encoding = self._capabilities.encoding
        self._slot(topic).put(Sample(data, encoding, type, node, time.time_ns(), sequence, epoch, latched))

    def _slot(self, topic: str) -> Slot:
        return self._slots.setdefault(topic, Slot())

    def _is_subscribed(self, topic: str) -> bool:
        return topic in self._slots and bool(self._slots[topic].subscriptions)

    def _advertise(self, topic: str, type: TypeRef, latch: bool) -> _AdvertisedTopic:
        """Advertise a topic, or take note of another way of publishing on it."""
        kind = self._message(type).ref
        own = self._advertised.get(topic)
        is_robots = topic in self._published or topic in self._subscribed
        carried = self._types[topic] if is_robots else own.type if own else kind
        if carried != kind:
            raise Refused(f"the topic {topic} carries {carried.name}, not this {kind.name}")
        if own is not None and own.latched == latch:
            return own
        if own is None and len(self._advertised) >= _MAX_ADVERTISED:
            raise Refused(f"rosld advertises {_MAX_ADVERTISED} topics already: DELETE one first")
        self._advertisings += 1
        own = _AdvertisedTopic(kind, latch, epoch=self._advertisings, matched=int(topic in self._subscribed))
        self._advertised[topic] = own
        self._revise()
        return own

    def _encode(self, schema: MessageSchema, fields: Mapping[str, object]) -> bytes:
        return schema.codec.encode(message_of(schema, fields), self._capabilities.encoding)

    def _require_reachable(self, deadline: float) -> None:
        """Raise Unreachable if the adapter is closed, TimedOut if the deadline (loop time) has passed."""
        robot = self._capabilities.system
        if self._sink is None:
            raise Unreachable(f"the {robot} is not there: the adapter is closed")
        if asyncio.get_running_loop().time() > deadline:
            raise TimedOut(f"the deadline passed before the request reached the {robot}")

    def _message(self, ref: TypeRef) -> MessageSchema:
        schema = self._library.find(ref)
        if not isinstance(schema, MessageSchema):
            raise Refused(f"{ref.name} is not a message type: only messages can be published")
        return schema

    def _service(self, name: str, requested: TypeRef) -> ServiceSchema:
        return cast(ServiceSchema, self._found("service", self._services, name, requested))

    def _action(self, name: str, requested: TypeRef | None = None) -> ActionSchema:
        return cast(ActionSchema, self._found("action", self._actions, name, requested))

    def _found(self, kind: str, among: Mapping[str, Interface], name: str, requested: TypeRef | None) -> Schema:
        """Return the schema of a service or an action. Raises NotFound, and Refused if another type is requested."""
        if name not in among:
            raise NotFound(f"there is no {kind} {name}")
        schema = self._library.find(self._types[name])
        if requested and (requested.name != schema.ref.name or requested.hash not in (None, schema.ref.hash)):
            raise Refused(f"the {kind} {name} is a {schema.ref.name}, not this {requested.name}")
        return schema

    def _decode(self, schema: MessageSchema, data: bytes, name: str) -> Message:
        try:
            return schema.codec.decode(data, self._capabilities.encoding)
        except ValueError as error:
            raise Refused(f"{name} cannot decode its request", words=str(error)) from error

    def _announce(self, action: str, id: str, event: GoalEvent) -> None:
        if self._sink is not None:
            self._sink.goal_changed(GoalId(action, id), event)

    def _revise(self) -> None:
        self._graph = self._describe(self._graph.revision + 1)
        if self._sink is not None:
            self._sink.graph_changed(self._graph)


def _endpoints(interface: Interface | None, type: TypeRef) -> Iterable[Endpoint]:
    if interface is not None:
        yield Endpoint(interface.node, type, latched=interface.latched)
