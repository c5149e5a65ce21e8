"""The container of calls."""

from __future__ import annotations

from collections.abc import Callable

from rosld.adapters.base import Watch
from rosld.ontology.describe_containers import container_document
from rosld.server.ldp.resource import BASIC_CONTAINER, RDF_SOURCE, RESOURCE, Resource
from rosld.server.ldp.state import State
from rosld.server.robot import Robot


class CallContainer(Resource):
    """`/calls/`: the calls made through rosld and kept."""

    kind = "Calls"
    links = (RESOURCE, RDF_SOURCE, BASIC_CONTAINER)

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot.space.container("calls"))
        self.robot = robot

    async def state(self) -> State:
        members = [self.robot.space.call(call.id) for call in self.robot.calls.all()]
        return self.robot.states.get(
            self.url,
            self.robot.calls.revision,
            lambda: State(lambda: container_document(self.url, members, "Calls")),
        )

    async def watch(self, wake: Callable[[], None]) -> Watch:
        return self.robot.calls.changes.watch(wake)
