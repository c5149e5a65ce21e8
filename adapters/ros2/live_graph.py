"""The graph of the system as it was last seen, and what is known of it when its nodes leave."""

from __future__ import annotations

import asyncio
import time
from dataclasses import replace

from rosld.adapters.base import Sink
from rosld.adapters.model import Graph, Live, Stale
from rosld.adapters.ros2.graph import GraphInputs, Observation, compose, stale

_LEAVING = 5.0
"""Seconds that a robot may take to go away node by node."""


class LiveGraph:
    """Keeps the graph, and tells the sink where it changed. `current` may be read in any thread."""

    def __init__(self, graph: Graph, sink: Sink) -> None:
        self.current = graph
        self.has_robot = False
        """Whether nodes of the robot have been seen, and not all of them have gone."""
        self._sink = sink
        self._before_leaving: tuple[Graph, float] | None = None

    def update(self, seen: Observation, known: GraphInputs, *, has_robot: bool) -> None:
        """Rebuild the graph from what was seen; where all nodes of the robot have gone it is stale."""
        if has_robot or not self.has_robot:
            self.has_robot = has_robot
            graph = compose(self.current, seen, known)
            self._note_leaving(graph)
            self._show(graph)
        else:
            self._show(stale(self._last_whole(), time.time_ns(), "none of its nodes can be seen any more"))

    def mark_stale(self, reason: str) -> None:
        """Say that the graph is as it was, and why."""
        self._show(stale(self.current, time.time_ns(), reason))

    def _show(self, graph: Graph) -> None:
        if graph is not self.current:
            self.current = graph
            self._sink.graph_changed(graph)

    def _note_leaving(self, graph: Graph) -> None:
        """Remember the graph as it was before nodes began to leave: they may all be about to."""
        now = asyncio.get_running_loop().time()
        before, after = (each.nodes.keys() - {graph.own_node} for each in (self.current, graph))
        if after > before:
            self._before_leaving = None
            return
        is_new = self._before_leaving is None or now - self._before_leaving[1] > _LEAVING
        if is_new and before - after and isinstance(self.current.state, Live):
            self._before_leaving = self.current, now

    def _last_whole(self) -> Graph:
        """The graph as last known: nodes that left one by one, but in one go, are still in it."""
        if isinstance(self.current.state, Stale) or self._before_leaving is None:
            return self.current
        whole, since = self._before_leaving
        if asyncio.get_running_loop().time() - since > _LEAVING:
            return self.current
        return replace(whole, revision=self.current.revision, own_node=self.current.own_node)
