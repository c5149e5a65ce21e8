"""Writes of properties: planned, checked against the limits, carried out, reported."""

from __future__ import annotations

from starlette.responses import Response

from rosld.adapters.model import Kind
from rosld.ontology.urls import Space
from rosld.server.http.problem_details import render
from rosld.server.hypermedia.catalogue import Property, Setter
from rosld.server.hypermedia.property_writer import PlannedWrite, WriteOutcome, plan_write
from rosld.server.hypermedia.value import MessageValue
from rosld.server.resources.limit_checks import LimitChecks
from rosld.server.resources.publisher import goes_on_response
from rosld.server.rest.exchange import Exchange
from rosld.server.robot.publication import no_subscriber_problem
from rosld.server.robot.session import Session


async def plan_property_write(
    session: Session, limit_checks: LimitChecks, own: Property, content: object, *, defaults: bool = False
) -> PlannedWrite:
    """How a property comes to have a value: within the limits, and nothing moves yet. Raises as `plan_write` does."""
    plan = plan_write(session, own, content, defaults=defaults)
    name, value = plan.writer.name, plan.value
    if not isinstance(value, MessageValue):
        await limit_checks.require_parameter(name, value.value)
    elif isinstance(plan.writer, Setter):
        url = session.space.service(name)
        await limit_checks.require_message(Kind.SERVICE, name, value.schema, value.message, url, "#request")
    else:
        url = session.space.topic(name)
        await limit_checks.require_message(Kind.TOPIC, name, value.schema, value.message, url, "#message")
    return plan


def write_response(exchange: Exchange, space: Space, plan: PlannedWrite, written: WriteOutcome) -> Response:
    """The answer to a write that was carried out: 204, or 202 where nobody was there to hear it."""
    name = plan.writer.name
    if written is WriteOutcome.UNHEARD:
        return render(no_subscriber_problem(name), exchange.accept).response()
    if written is WriteOutcome.GOES_ON:
        return goes_on_response(exchange, name, space.topic(name))
    return Response(status_code=204)
