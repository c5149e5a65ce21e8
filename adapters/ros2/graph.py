"""Computation graph: discovered through the middleware, and composed sharing unchanged parts with the previous one."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from msgspec import Struct, field

from rosld.adapters.base import Sink
from rosld.adapters.model import (
    Action,
    Endpoint,
    Graph,
    Lifecycle,
    Live,
    Node,
    Parameter,
    Service,
    Stale,
    Topic,
    TypeRef,
)
from rosld.adapters.model.names import action_of
from rosld.adapters.ros2.middleware import DiscoveredEndpoint, Names, Participant
from rosld.adapters.thread import wait_event

_SEND_GOAL = "/_action/send_goal"
_FEEDBACK = "/_action/feedback"


class Observation(Struct, frozen=True):
    """An observation of the system, including our own things; `advertised` are our explicit publications."""

    nodes: tuple[str, ...] = ()
    topics: Names = field(default_factory=dict)
    services: Names = field(default_factory=dict)
    publishers: Mapping[str, tuple[DiscoveredEndpoint, ...]] = field(default_factory=dict)
    subscribers: Mapping[str, tuple[DiscoveredEndpoint, ...]] = field(default_factory=dict)
    providers: Mapping[str, Names] = field(default_factory=dict)
    callers: Mapping[str, Names] = field(default_factory=dict)


class GraphInputs(Struct, frozen=True):
    """Inputs of the graph in addition to the observation.

    `problems` are the reasons why types cannot be used here, by name.
    """

    hidden_node: str
    own_node: str
    advertised: frozenset[str] = frozenset()
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    unreachable: Mapping[str, str] = field(default_factory=dict)
    lifecycles: Mapping[str, Lifecycle] = field(default_factory=dict)
    simulated_time: bool = False
    problems: Callable[[str], str | None] = lambda _: None

    @property
    def ours(self) -> frozenset[str]:
        """Names of our nodes."""
        return frozenset((self.hidden_node, self.own_node))


def compose(previous: Graph, observation: Observation, inputs: GraphInputs) -> Graph:
    """Return the graph of an observation, which is `previous` itself if nothing changed."""
    providers = _by_service(observation.providers, inputs)
    callers = _by_service(observation.callers, inputs)
    topics = _topics(observation, inputs)
    actions = _actions(observation, providers, callers, inputs)
    services = {
        name: _service(name, types, providers.get(name, ()), inputs)
        for name, types in observation.services.items()
        if providers.get(name)
    }
    nodes = {
        name: Node(name, None, inputs.unreachable.get(name), inputs.lifecycles.get(name))
        for name in foreign_nodes(observation, inputs.hidden_node)
    }
    if inputs.advertised:
        nodes[inputs.own_node] = Node(inputs.own_node)
    return previous.updated(
        own_node=inputs.own_node,
        simulated_time=inputs.simulated_time,
        nodes=nodes,
        topics=topics,
        services=services,
        actions=actions,
        parameters=inputs.parameters,
    )


def foreign_nodes(observation: Observation, hidden_node: str) -> tuple[str, ...]:
    """Return the distinct names of all nodes except our hidden one."""
    return tuple(name for name in dict.fromkeys(observation.nodes) if name != hidden_node)


def _topics(observation: Observation, inputs: GraphInputs) -> dict[str, Topic]:
    topics: dict[str, Topic] = {}
    for name in observation.topics:
        ours = inputs.ours if name not in inputs.advertised else {inputs.hidden_node}
        publishers = [each for each in observation.publishers.get(name, ()) if each.node not in ours]
        subscribers = [each for each in observation.subscribers.get(name, ()) if each.node not in ours]
        if publishers or subscribers:
            topics[name] = _topic(name, publishers, subscribers, inputs)
    return topics


def _topic(
    name: str,
    publishers: list[DiscoveredEndpoint],
    subscribers: list[DiscoveredEndpoint],
    inputs: GraphInputs,
) -> Topic:
    refs = dict.fromkeys(each.type for each in (*publishers, *subscribers))
    hashed = {ref.name for ref in refs if ref.hash is not None}
    used = tuple(ref for ref in refs if ref.hash is not None or ref.name not in hashed)
    words = next((found for ref in used if (found := inputs.problems(ref.name)) is not None), None)
    return Topic(name, used, _endpoints(publishers, publish=True), _endpoints(subscribers, publish=False), words)


def _endpoints(discovered: list[DiscoveredEndpoint], *, publish: bool) -> tuple[Endpoint, ...]:
    """Return the endpoints with known nodes. Only publishers can be latched."""
    endpoints = [
        Endpoint(each.node, each.type, publish and each.qos.durability == "transient_local", None, each.qos)
        for each in discovered
        if each.node
    ]
    return tuple(endpoints if len(endpoints) < 2 else sorted(endpoints, key=lambda each: (each.node, repr(each.qos))))


def _service(name: str, types: tuple[str, ...], providers: tuple[str, ...], inputs: GraphInputs) -> Service:
    if len(types) != 1:
        return Service(name, None, providers, f"it has several types: {', '.join(types)}")
    return Service(name, TypeRef(types[0]), providers, of_action(name) or inputs.problems(types[0]))


def of_action(service: str) -> str | None:
    """Return why an action's service must not be called directly (past the followers of its goals), or None."""
    action = action_of(service)
    return action and f"it is a part of the action {action}: send, follow and cancel goals there"


def _actions(
    observation: Observation,
    providers: Mapping[str, tuple[str, ...]],
    callers: Mapping[str, tuple[str, ...]],
    inputs: GraphInputs,
) -> dict[str, Action]:
    typed = {
        name.removesuffix(_FEEDBACK): types for name, types in observation.topics.items() if name.endswith(_FEEDBACK)
    }
    typed |= {
        name.removesuffix(_SEND_GOAL): types
        for name, types in observation.services.items()
        if name.endswith(_SEND_GOAL)
    }
    actions: dict[str, Action] = {}
    for name, types in typed.items():
        servers, clients = (of.get(name + _SEND_GOAL, ()) for of in (providers, callers))
        if servers or clients:
            kinds = {each.removesuffix("_SendGoal").removesuffix("_FeedbackMessage") for each in types}
            type = kinds.pop() if len(kinds) == 1 else None
            words = inputs.problems(type) if type else f"it has the types {', '.join(types)}"
            actions[name] = Action(name, TypeRef(type) if type else None, servers, clients, words)
    return actions


def _by_service(by_node: Mapping[str, Names], inputs: GraphInputs) -> dict[str, tuple[str, ...]]:
    nodes_by_service: dict[str, list[str]] = {}
    for node in sorted(by_node):
        if node not in inputs.ours:
            for service in by_node[node]:
                nodes_by_service.setdefault(service, []).append(node)
    return {service: tuple(nodes) for service, nodes in nodes_by_service.items()}


def type_in_use(graph: Graph, ref: TypeRef) -> TypeRef:
    """Return the type with the hash that a topic's type of this name has, unless the hash is given."""
    if ref.hash is not None:
        return ref
    types = (each for topic in graph.topics.values() for each in topic.types)
    return next((each for each in types if each.name == ref.name), ref)


def nodes_using(graph: Graph, ref: TypeRef) -> list[str]:
    """Return the nodes that use a type and describe their types."""
    nodes: dict[str, None] = {}
    for topic in graph.topics.values():
        for each in (*topic.publishers, *topic.subscribers):
            if each.type is not None and each.type.name == ref.name:
                nodes[each.node] = None
    for service in graph.services.values():
        if service.type is not None and service.type.name == ref.name:
            nodes.update(dict.fromkeys(service.providers))
    return [node for node in nodes if f"{node}/get_type_description" in graph.services]


_LEAVE_SECONDS = 5.0
"""Maximum seconds in which all nodes of a robot that is switched off disappear."""


class LiveGraph:
    """The current graph; changes are reported to the sink. `current` is thread-safe."""

    def __init__(self, graph: Graph, sink: Sink) -> None:
        self.current = graph
        self.has_robot = False
        """Whether nodes of the robot are present."""
        self._sink = sink
        self._graph_before_leave: tuple[Graph, float] | None = None

    def update(self, observation: Observation, inputs: GraphInputs, *, has_robot: bool) -> None:
        """Rebuild the graph from an observation; it is stale if all nodes of the robot have disappeared."""
        if has_robot or not self.has_robot:
            self.has_robot = has_robot
            graph = compose(self.current, observation, inputs)
            self._note_leave(graph)
            self._show(graph)
        else:
            self._show(self._last_whole().as_stale("none of its nodes is visible any more"))

    def mark_stale(self, reason: str) -> None:
        """Mark the graph as stale, with a reason."""
        self._show(self.current.as_stale(reason))

    def _show(self, graph: Graph) -> None:
        if graph is not self.current:
            self.current = graph
            self._sink.graph_changed(graph)

    def _note_leave(self, graph: Graph) -> None:
        """Store the graph from before nodes began to disappear, in case all of them do."""
        now = asyncio.get_running_loop().time()
        before, after = (each.nodes.keys() - {graph.own_node} for each in (self.current, graph))
        if after > before:
            self._graph_before_leave = None
            return
        is_new = self._graph_before_leave is None or now - self._graph_before_leave[1] > _LEAVE_SECONDS
        if is_new and before - after and isinstance(self.current.state, Live):
            self._graph_before_leave = self.current, now

    def _last_whole(self) -> Graph:
        """Return the last known graph, including nodes that have disappeared one after another just now."""
        if isinstance(self.current.state, Stale) or self._graph_before_leave is None:
            return self.current
        whole, since = self._graph_before_leave
        if asyncio.get_running_loop().time() - since > _LEAVE_SECONDS:
            return self.current
        return replace(whole, revision=self.current.revision, own_node=self.current.own_node)


_COUNTS = 1.0
_ALL = 10.0
_EVERY = 0.2
_SHARE = 20  # polls may take this fraction of our time
_AT_ONCE = 25


class Discovery:
    """Polls the system through one participant; `observation` is the last one. Belongs to the ROS thread."""

    def __init__(self, participant: Participant) -> None:
        self.observation = Observation()
        self._participant = participant
        self._counts: dict[str, tuple[int, int]] = {}
        self._all_at = 0.0
        self._counted_at = 0.0
        self._took = 0.0
        self._poll_requested = asyncio.Event()
        self._poll_lock = asyncio.Lock()

    def poll_soon(self) -> None:
        """End the pause before the next poll."""
        self._poll_requested.set()

    async def pause(self) -> None:
        """Wait until the next poll is due."""
        await wait_event(self._poll_requested, min(max(_EVERY, _SHARE * self._took), _ALL))
        self._poll_requested.clear()

    async def poll(self, topics: Sequence[str] = ()) -> None:
        """Poll now, always including the endpoints of these topics."""
        async with self._poll_lock:
            started = time.monotonic()
            await self._poll(topics)
            self._took = time.monotonic() - started

    async def _poll(self, required: Sequence[str]) -> None:
        participant, before, now = self._participant, self.observation, asyncio.get_running_loop().time()
        nodes, topics, services = participant.node_names(), participant.topics(), participant.services()
        due = set(required) & topics.keys()
        whole = now - self._all_at > max(_ALL, _SHARE * self._took)
        if whole or sorted(nodes) != sorted(before.nodes):
            due.update(topics)
            self._all_at = now
        else:
            due.update(name for name, types in topics.items() if before.topics.get(name) != types)
            due.update(name for name in topics if self._incomplete(name))
            if now - self._counted_at > _COUNTS:
                due.update(name for name in topics if self._counts.get(name) != participant.counts(name))
                self._counted_at = now
        publishers = {name: before.publishers[name] for name in topics if name in before.publishers}
        subscribers = {name: before.subscribers[name] for name in topics if name in before.subscribers}
        for position, name in enumerate(sorted(due)):
            publishers[name], subscribers[name] = participant.publishers(name), participant.subscribers(name)
            self._counts[name] = len(publishers[name]), len(subscribers[name])
            if position % _AT_ONCE == _AT_ONCE - 1:
                await asyncio.sleep(0)
        self._counts = {name: count for name, count in self._counts.items() if name in topics}
        providers, callers = before.providers, before.callers
        is_unprovided = not services.keys() <= {service for of in providers.values() for service in of}
        if whole or sorted(nodes) != sorted(before.nodes) or services != before.services or is_unprovided:
            foreign = foreign_nodes(Observation(nodes), participant.hidden_name)
            providers = {node: participant.services_of(node) for node in foreign}
            callers = {node: participant.clients_of(node) for node in foreign}
        self.observation = Observation(nodes, topics, services, publishers, subscribers, providers, callers)

    def _incomplete(self, topic: str) -> bool:
        """Whether an endpoint was discovered before its node, which follows a moment later."""
        observation = self.observation
        return any(
            not each.node for of in (observation.publishers, observation.subscribers) for each in of.get(topic, ())
        )
