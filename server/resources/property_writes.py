"""Writes of properties: planned, checked against the limits, carried out, reported."""

from __future__ import annotations

from starlette.responses import Response

from rosld.adapters.model import Kind
from rosld.server.http.problem_details import render
from rosld.server.hypermedia.catalogue import Property, Setter
from rosld.server.hypermedia.property_writer import PlannedWrite, WriteOutcome, plan_write
from rosld.server.hypermedia.value import MessageValue
from rosld.server.resources.context import Robot
from rosld.server.resources.limit_checks import require_message, require_parameter
from rosld.server.robot.publication import no_subscriber_problem


async def plan_property_write(robot: Robot, own: Property, content: object, *, defaults: bool = False) -> PlannedWrite:
    """How a property comes to have a value: within the limits, and nothing moves yet. Raises as `plan_write` does."""
    plan = plan_write(robot, own, content, defaults=defaults)
    name, value = plan.writer.name, plan.value
    if not isinstance(value, MessageValue):
        await require_parameter(robot, name, value.value)
    elif isinstance(plan.writer, Setter):
        url = robot.space.service(name)
        await require_message(robot, Kind.SERVICE, name, value.schema, value.message, url, "#request")
    else:
        url = robot.space.topic(name)
        await require_message(robot, Kind.TOPIC, name, value.schema, value.message, url, "#message")
    return plan


def write_response(plan: PlannedWrite, written: WriteOutcome, accept: str | None) -> Response:
    """The answer to a write that was carried out: 204, or 202 where nobody was there to hear it."""
    if written is WriteOutcome.UNHEARD:
        return render(no_subscriber_problem(plan.writer.name), accept).response()
    return Response(status_code=204)
