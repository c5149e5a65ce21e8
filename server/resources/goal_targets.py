"""Where a pose that somebody chooses on a map is sent: navigation actions, and topics of goals."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator, Callable, Sequence
from dataclasses import dataclass

from rosld.adapters.model import Graph, Nested, RosError
from rosld.server.auth.permissions import Permissions
from rosld.server.resources.namespaces import listed_graph
from rosld.server.rest.resource import Resource
from rosld.server.robot.session import Session
from rosld.server.robot.velocity import subscribers_of

_POSE, _STAMPED = "geometry_msgs/msg/Pose", "geometry_msgs/msg/PoseStamped"
_MAX_TARGETS = 20


@dataclass(frozen=True, slots=True)
class GoalTarget:
    """An action or a topic that takes a pose, by `method` at `url`.

    `field` is the field of the goal that the pose is in, empty where it is the whole message; `is_stamped` says whether
    it has a header.
    """

    url: str
    name: str
    type: str
    method: str
    field: str
    is_stamped: bool


class GoalTargets:
    """The targets that an agent may send poses to now; `topic` and `action` give the resources of names."""

    def __init__(self, session: Session, topic: Callable[[str], Resource], action: Callable[[str], Resource]) -> None:
        self._session = session
        self._topic = topic
        self._action = action
        self._found: tuple[Graph, Sequence[GoalTarget]] | None = None

    @property
    def now(self) -> float | None:
        """The time for the headers of poses, in seconds; None where it is simulated and not this server's to say."""
        return None if self._session.graph.simulated_time else time.time()

    async def offered(self, permissions: Permissions) -> Sequence[GoalTarget]:
        """The targets on offer, actions first; none while the robot is stopped."""
        graph = self._session.graph
        if self._found is None or self._found[0] is not graph:
            self._found = graph, [each async for each in self._targets(graph)]
        found = [each for each in self._found[1] if permissions.may(each.method, each.url) and self._is_open(each)]
        return found[:_MAX_TARGETS]

    def _is_open(self, target: GoalTarget) -> bool:
        resource = (self._action if target.method == "POST" else self._topic)(target.name)
        return target.method in resource.methods() - resource.withheld

    async def _targets(self, graph: Graph) -> AsyncIterator[GoalTarget]:
        """Return all targets that take a pose, whatever the rights of the agent."""
        space, listed = self._session.space, listed_graph(graph, self._session.adapter.capabilities)
        for name, action in sorted(listed.actions.items()):
            if action.type is None:
                continue
            try:
                schema = await self._session.schemas.action(action.type)
            except RosError:
                continue
            poses = [
                (each.name, each.type.name == _STAMPED)
                for each in schema.goal.type.fields
                if isinstance(each.type, Nested) and each.type.name in (_POSE, _STAMPED)
            ]
            if len(poses) == 1:
                yield GoalTarget(space.action(name), name, action.type.name, "POST", *poses[0])
        for name, topic in sorted(listed.topics.items()):
            if topic.type is not None and topic.type.name == _STAMPED and subscribers_of(topic, graph):
                yield GoalTarget(space.topic(name), name, _STAMPED, "PUT", "", is_stamped=True)
