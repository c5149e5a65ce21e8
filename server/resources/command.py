"""Resources whose writes command the robot."""

from __future__ import annotations

from rosld.server.resources.context import Robot
from rosld.server.rest.resource import Resource

WRITES = frozenset({"PUT", "POST", "PATCH", "DELETE"})


class CommandResource(Resource):
    """Base of the resources whose writes command the robot: none is offered while it is stopped."""

    robot: Robot

    @property
    def withheld(self) -> frozenset[str]:
        return WRITES if self.robot.is_stopped else frozenset()
