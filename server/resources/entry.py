"""The entry point `/`: the distributed application itself (paper, Table 1)."""

from __future__ import annotations

from rosld.ontology.describe_graph import entry_document
from rosld.server.ldp.resource import BASIC_CONTAINER, RDF_SOURCE, RESOURCE, Resource
from rosld.server.ldp.state import State
from rosld.server.robot import Robot


class EntryResource(Resource):
    """Where every client begins."""

    kind = "Robot"
    links = (RESOURCE, RDF_SOURCE, BASIC_CONTAINER)

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot.space.base)
        self.robot = robot

    async def state(self) -> State:
        graph = self.robot.graph
        system = self.robot.adapter.capabilities.system
        return self.robot.states.get(
            self.url, graph.revision, lambda: State(lambda: entry_document(graph, self.robot.space, system))
        )
