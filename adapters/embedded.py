"""Base of adapters of embedded robots, which live on the server's own loop and need nothing else installed.

They answer at once: a deadline matters only if it has passed already, and all operations before `open` or after `close`
raise Unreachable.
"""

from __future__ import annotations

import asyncio
import time
from abc import ABC, abstractmethod
from collections.abc import Collection, Container, Mapping, Sequence
from types import MappingProxyType

from rosld.adapters.base import AdapterOptions, Capabilities, Published, Recording, Sink, Subscription, Watch
from rosld.adapters.local_topics import LocalTopics
from rosld.adapters.model import (
    ActionSchema,
    Encoding,
    GoalEvent,
    GoalId,
    Graph,
    Message,
    MessageSchema,
    NotFound,
    Refused,
    Sample,
    Schema,
    ServiceSchema,
    TimedOut,
    TypeRef,
    Unreachable,
    without_lifecycle,
)
from rosld.adapters.model.library import TypeLibrary


class NoWatch:
    """A watch without effect, for changes that are announced in any case."""

    def close(self) -> None:
        """Do nothing."""


class EmbeddedRobot(ABC):
    """The part of an `Adapter` that is the same for all embedded robots.

    `types` are those of all topics, services and actions by name, `topics` the names of topics among them, of which the
    robot subscribes to those in `heard`. `own_node` is the name of rosld.
    """

    _graph: Graph

    def __init__(
        self,
        capabilities: Capabilities,
        options: AdapterOptions,
        types: Mapping[str, str],
        topics: Collection[str],
        heard: Container[str],
        own_node: str,
    ) -> None:
        self._capabilities = capabilities
        self._library = TypeLibrary(
            ros_version=1 if capabilities.encoding is Encoding.ROS1 else 2, folders=options.types
        )
        self._types = {name: self._library.find(TypeRef(type)).ref for name, type in types.items()}
        own = {topic: self._types[topic] for topic in topics}
        self._topics = LocalTopics(
            own, heard, capabilities.encoding, own_node, lambda ref: self._message(ref).ref, self._revise
        )
        self._sink: Sink | None = None
        self._timer: asyncio.TimerHandle | None = None

    @property
    def capabilities(self) -> Capabilities:
        """The capabilities of the ROS that the robot resembles, without a master or a middleware."""
        return self._capabilities

    @property
    def graph(self) -> Graph:
        """The robot, and rosld while it advertises something."""
        return self._graph

    @property
    def recordings(self) -> Mapping[str, Recording]:
        """None."""
        return MappingProxyType({})

    async def close(self) -> None:
        """Stop, with nothing left advertised. Idempotent."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        for topic in tuple(self._topics.advertised):
            self._topics.unadvertise(topic)
        self._sink = None

    async def schema(self, ref: TypeRef, *, deadline: float) -> Schema:
        """Return the schema of a type that is shipped or in the folders of `--types`."""
        return self._library.find(ref)

    def known_types(self) -> Sequence[TypeRef]:
        """Return the types of the robot's topics, services and actions, and of what rosld advertises."""
        return list(dict.fromkeys([*self._types.values(), *(each.type for each in self._topics.advertised.values())]))

    async def subscribe(self, topic: str, *, depth: int = 1) -> Subscription:
        """Subscribe to a topic, whether or not it exists yet."""
        return self._topics.subscribe(topic, depth)

    def age_ns(self, sample: Sample) -> int:
        """Return the time since a sample was received."""
        return max(0, time.time_ns() - sample.received_ns)

    async def publish(
        self, topic: str, type: TypeRef, data: bytes, *, latch: bool = False, deadline: float
    ) -> Published:
        """Publish without waiting: no subscriber can match later. Raises Refused for another type."""
        self._require_reachable(deadline)
        return self._topics.publish(topic, type, data, latch)

    async def advertise(self, topic: str, type: TypeRef, *, deadline: float) -> None:
        """Do nothing: the robot receives what is published at once."""
        self._require_reachable(deadline)

    async def unadvertise(self, topic: str) -> None:
        """Stop advertising, and drop the messages that rosld published."""
        self._topics.unadvertise(topic)

    async def cancel_goals(self, action: str, *, deadline: float) -> None:
        """Cancel the goal that the robot pursues, if any."""
        self._require_reachable(deadline)
        self._action(action)
        current = self._current_goal()
        if current is not None:
            await self.cancel_goal(GoalId(action, current), deadline=deadline)

    @abstractmethod
    async def cancel_goal(self, goal: GoalId, *, deadline: float) -> None:
        """Cancel a goal. Raises NotFound for any other than the current one."""

    async def follow_goals(self, action: str, *, deadline: float) -> Watch:
        """Return a watch without effect: all goals are announced in any case."""
        self._action(action)
        return NoWatch()

    async def change_state(self, node: str, transition: str, *, deadline: float) -> None:
        """Raise Refused: the nodes have no lifecycles; NotFound for an unknown node."""
        raise without_lifecycle(self._graph.nodes, node)

    @abstractmethod
    def _describe(self, revision: int) -> Graph:
        """Return the current computation graph."""

    @abstractmethod
    def _current_goal(self) -> str | None:
        """Return the id of the goal that the robot pursues."""

    def _require_reachable(self, deadline: float) -> None:
        """Raise Unreachable if the adapter is closed, TimedOut if the deadline (loop time) has passed."""
        robot = self._capabilities.system
        if self._sink is None:
            raise Unreachable(f"the {robot} is not there: the adapter is closed")
        if asyncio.get_running_loop().time() > deadline:
            raise TimedOut(f"the deadline had passed before the {robot} was asked")

    def _message(self, ref: TypeRef) -> MessageSchema:
        schema = self._library.find(ref)
        if not isinstance(schema, MessageSchema):
            raise Refused(f"{ref.name} is no message type: only messages can be published")
        return schema

    def _service(self, name: str, asked: TypeRef) -> ServiceSchema:
        if name not in self._graph.services:
            raise NotFound(f"there is no service {name}")
        schema = self._library.find(self._types[name])
        assert isinstance(schema, ServiceSchema)
        _require_type(name, "service", schema.ref, asked)
        return schema

    def _action(self, name: str, asked: TypeRef | None = None) -> ActionSchema:
        if name not in self._graph.actions:
            raise NotFound(f"there is no action {name}")
        schema = self._library.find(self._types[name])
        assert isinstance(schema, ActionSchema)
        if asked is not None:
            _require_type(name, "action", schema.ref, asked)
        return schema

    def _decode(self, schema: MessageSchema, data: bytes, name: str) -> Message:
        try:
            return schema.codec.decode(data, self._capabilities.encoding)
        except ValueError as error:
            raise Refused(f"{name} cannot read what it is sent", words=str(error)) from error

    def _announce(self, action: str, id: str, event: GoalEvent) -> None:
        if self._sink is not None:
            self._sink.goal_changed(GoalId(action, id), event)

    def _revise(self) -> None:
        self._graph = self._describe(self._graph.revision + 1)
        if self._sink is not None:
            self._sink.graph_changed(self._graph)


def _require_type(name: str, kind: str, ref: TypeRef, asked: TypeRef) -> None:
    if asked.name != ref.name or asked.hash not in (None, ref.hash):
        raise Refused(f"the {kind} {name} is a {ref.name}, not this {asked.name}")
