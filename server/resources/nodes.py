"""Nodes: what each publishes, subscribes to and provides."""

from __future__ import annotations

from rosld.adapters.model import Graph
from rosld.ontology.describe_graph import node_document
from rosld.server.http.problem import Problem
from rosld.server.ldp.resource import Resource
from rosld.server.ldp.state import State
from rosld.server.resources.namespaces import moved_to_namespace
from rosld.server.robot import Robot


class NodeResource(Resource):
    """One node."""

    kind = "Node"

    def __init__(self, robot: Robot, name: str) -> None:
        super().__init__(robot.space.node(name))
        self.robot = robot
        self.name = self.title = name

    async def state(self) -> State:
        graph: Graph = self.robot.graph
        node = graph.nodes.get(self.name)
        if node is None:
            raise moved_to_namespace(self.robot, "nodes", self.name) or Problem(404, f"There is no node {self.name}.")
        found = node
        return self.robot.states.get(
            self.url, graph.revision, lambda: State(lambda: node_document(found, graph, self.robot.space))
        )
