"""Discovery of the graph, and the last known state of nodes that have left."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from dataclasses import replace

from rosld.adapters.base import Sink
from rosld.adapters.model import Graph, Live, Stale
from rosld.adapters.ros2.graph import GraphInputs, Observation, compose, foreign_nodes, stale
from rosld.adapters.ros2.middleware import Names, Participant

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
            self._show(stale(self._last_whole(), time.time_ns(), "none of its nodes is visible any more"))

    def mark_stale(self, reason: str) -> None:
        """Mark the graph as stale, with a reason."""
        self._show(stale(self.current, time.time_ns(), reason))

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
        try:
            await asyncio.wait_for(self._poll_requested.wait(), min(max(_EVERY, _SHARE * self._took), _ALL))
        except asyncio.TimeoutError:
            pass
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
        if whole or sorted(nodes) != sorted(before.nodes) or services != before.services or self._unprovided(services):
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

    def _unprovided(self, services: Names) -> bool:
        provided = {service for of in self.observation.providers.values() for service in of}
        return not services.keys() <= provided
