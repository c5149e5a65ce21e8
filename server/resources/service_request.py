"""Requests of services: from the body of a POST to the message that is sent."""

from __future__ import annotations

from rosld.adapters.model import Kind, Message, MessageSchema, Refused, Sent, ServiceSchema
from rosld.ontology.body import parse_body, parse_json
from rosld.ontology.lift import LiftSettings
from rosld.ontology.lower import lowerer
from rosld.ontology.urls import Space
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.value import refusal_text
from rosld.server.receipts.audit_context import Sender
from rosld.server.resources.limit_checks import LimitChecks, is_strict
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import JSON
from rosld.server.rest.ros_problems import problem_of
from rosld.server.robot.calls import CallOutcome, IdempotencyKeyReused
from rosld.server.robot.session import Session
from rosld.server.runtime.tasks import loop_time


async def read_request(
    exchange: Exchange,
    space: Space,
    lifting: LiftSettings,
    limit_checks: LimitChecks,
    service: str,
    schema: ServiceSchema,
    url: str,
) -> Message:
    """Return the request of a service in a body sent to `url`; raises as `read_message`."""
    return await read_message(exchange, space, lifting, limit_checks, Kind.SERVICE, service, schema.request, url)


async def read_message(
    exchange: Exchange,
    space: Space,
    lifting: LiftSettings,
    limit_checks: LimitChecks,
    kind: Kind,
    name: str,
    schema: MessageSchema,
    url: str,
) -> Message:
    """Return the request or the goal in a body sent to `url`, for what is called `name`.

    No body is a message without fields: for one that has some, `{}` asks for its defaults, and a body that got lost
    does not move the robot. Raises BodyError, LoweringError, and Problems.
    """
    data = await exchange.body()
    lowering = lowerer(schema, lifting)
    if not data.strip():
        return lowering.from_json({}, defaults=exchange.query_flag("defaults"))
    if exchange.media_type == JSON:
        return lowering.from_json(parse_json(data), defaults=not is_strict(exchange))
    body, node = parse_body(data, exchange.media_type, url), "#goal" if kind is Kind.ACTION else "#request"
    own = space.action(name) if kind is Kind.ACTION else space.service(name)
    await limit_checks.require_text(kind, name, schema, body, own, node)
    return lowering.from_body(body, url, node)


def sender_of(exchange: Exchange) -> Sender:
    """Return the sender of a request: its agent and its receipt."""
    return Sender(exchange.agent.name, exchange.audit.receipt_id())


async def call_service(
    exchange: Exchange, session: Session, service: str, schema: ServiceSchema, request: Message
) -> CallOutcome:
    """Call a service, once only for each Idempotency-Key. Raises a 422 Problem for a key of another request."""
    deadline = loop_time() + session.settings.call_deadline
    key, sender = exchange.header("idempotency-key"), sender_of(exchange)
    if key is None:
        return await session.calls.call(service, schema, request, deadline=deadline, sender=sender)
    try:
        return await session.calls.call_idempotent(
            key, service, schema, request, await exchange.body(), deadline=deadline, sender=sender
        )
    except IdempotencyKeyReused as error:
        raise Problem(422, f"The Idempotency-Key {key!r} came before with another request.") from error


def call_problem(space: Space, outcome: CallOutcome) -> Problem | None:
    """Return the Problem of a call that did not succeed, with the URL of the call; None where an answer came."""
    error = outcome.error
    if error is None:
        return None
    url = space.call(outcome.call.id)
    problem = problem_of(error)
    problem.about += (space.service(outcome.call.service),)
    problem.extra |= {"call": url, "state": outcome.call.state.value}
    if isinstance(error, Refused) and not error.words:
        problem.detail = f"{outcome.call.service} refused the call: {error.sentence}"
    elif problem.status == 503 and error.sent is not Sent.NO:
        problem.detail += " It may have been carried out."
    problem.headers["Location"] = url
    return problem


def refusal_problem(space: Space, outcome: CallOutcome) -> Problem | None:
    """Return the Problem of a call whose answer says `bool success` false: a refusal in the robot's words."""
    call = outcome.call
    if call.response is None:
        return None
    words = refusal_text(call.schema.response, call.response)
    if words is None:
        return None
    problem = problem_of(Refused(f"{call.service} refused", words=words or None, sent=Sent.YES))
    problem.about += (space.service(call.service),)
    problem.extra |= {"call": space.call(call.id)}
    return problem
