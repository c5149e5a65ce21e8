"""The containers of what comes and goes as the robot is used: calls, goals, holds."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from rosld.adapters.base import Watch
from rosld.ontology.describe_containers import container_document
from rosld.server.hypermedia.message_schemas import MessageSchemas
from rosld.server.resources.context import Robot
from rosld.server.rest.path_item import PathItem
from rosld.server.rest.resource import BASIC_CONTAINER, RDF_SOURCE, RESOURCE, Resource
from rosld.server.rest.state import State
from rosld.server.runtime.signals import Signal


class ListingResource(Resource):
    """`/NAME/`: a container of the members that there are now, whose URLs `members` tells; `changes` says when."""

    links = (RESOURCE, RDF_SOURCE, BASIC_CONTAINER)

    def __init__(
        self, robot: Robot, name: str, summary: str, members: Callable[[], Iterator[str]], changes: Signal
    ) -> None:
        super().__init__(robot.space.container(name))
        self.kind = name.capitalize()
        self._robot = robot
        self._summary = summary
        self._members = members
        self._changes = changes

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        return PathItem(self._summary)

    @property
    def conforms_to(self) -> Sequence[str]:
        return (self._robot.space.document_shape("Container"),)

    async def state(self) -> State:
        members = tuple(self._members())
        return self._robot.states.get_or_make(
            self.url, members, lambda: State(lambda: container_document(self.url, members, self.kind))
        )

    async def watch(self, wake: Callable[[], None]) -> Watch:
        return self._changes.watch(wake)


def calls_listing(robot: Robot) -> ListingResource:
    """`/calls/`: the calls made through rosld and kept."""
    known, url = robot.calls, robot.space.call
    return ListingResource(
        robot, "calls", "The calls that are kept", lambda: (url(call.id) for call in known.all()), known.changes
    )


def goals_listing(robot: Robot) -> ListingResource:
    """`/goals/`: the goals known and kept, ours and others'."""
    known, url = robot.goals, robot.space.goal
    return ListingResource(
        robot, "goals", "The goals that are kept", lambda: (url(goal.id) for goal in known.all()), known.changes
    )


def holds_listing(robot: Robot) -> ListingResource:
    """`/holds/`: the holds that there are."""
    known, url = robot.holds, robot.space.hold
    return ListingResource(
        robot, "holds", "The holds of topics", lambda: (url(hold.id) for hold in known.all()), known.changes
    )
