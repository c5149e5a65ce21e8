"""Dry runs: a write that is planned and checked as usual, and answered with its plan instead of being carried out."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterator

import orjson
from starlette.responses import Response

from rosld.adapters.model import Graph
from rosld.ontology.urls import Space
from rosld.server.auth.permissions import Permissions
from rosld.server.hypermedia.message_schemas import MessageSchemas
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.resource import Resource
from rosld.server.robot.session import Session
from rosld.server.runtime.dry_run import DryRun, DryRunEnded, PlannedStep, current_dry_run


async def answer_dry_run(
    exchange: Exchange, resource: Resource, session: Session, answer: Callable[[], Awaitable[Response]]
) -> Response:
    """Answer a write of a resource by `answer` in a dry run: 200 with the plan as JSON, or the refusal of the write.

    Raises what `answer` raises.
    """
    dry_run = DryRun()
    token = current_dry_run.set(dry_run)
    try:
        answered = await answer()
        if answered.status_code >= 400:  # a form, on its page again
            return answered
        dry_run.status = answered.status_code
    except DryRunEnded:
        dry_run.status = dry_run.status or _only_status(resource, exchange.method, session)
    finally:
        current_dry_run.reset(token)
    plan = {
        "dryRun": True,
        "method": exchange.method,
        "url": resource.url,
        "steps": [*_steps(dry_run, resource.url, session, exchange.permissions)],
        "limits": [*filter(exchange.permissions.may_read, dry_run.limits)],
        "conditions": [*filter(exchange.permissions.may_read, dry_run.conditions)],
        "status": dry_run.status,
    }
    body = orjson.dumps(plan, option=orjson.OPT_INDENT_2)
    return Response(body, 200, {"Cache-Control": "no-store"}, "application/json")


def _only_status(resource: Resource, method: str, session: Session) -> int | None:
    """The status of success of a method, None where it has several."""
    item = resource.path_item(MessageSchemas(lambda ref: None, session.lifting))
    statuses = item.write(method).statuses(method)
    return statuses[0] if len(statuses) == 1 else None


def _steps(dry_run: DryRun, url: str, session: Session, permissions: Permissions) -> Iterator[dict[str, object]]:
    """The steps that an agent may know of, with the URLs of the nodes that each would reach."""
    space, graph = session.space, session.graph
    for step in dry_run.steps:
        about = step.touches[0] if step.touches else url
        if about != url and not all(map(permissions.may_read, step.touches)):
            continue
        nodes = (space.node(name) for name in _receivers(step, space, graph))
        yield {"does": step.description, "url": about, "receivers": [*filter(permissions.may_read, nodes)]}


def _receivers(step: PlannedStep, space: Space, graph: Graph) -> list[str]:
    """The nodes that a step would reach: subscribers of a topic, providers of a service or an action, owners."""
    found: list[str] = []
    for url in step.touches:
        location = space.location(url)
        if location is None:
            continue
        name = location.name
        match location.kind:
            case "topics" if name in graph.topics:
                found += (endpoint.node for endpoint in graph.topics[name].subscribers)
            case "services" if name in graph.services:
                found += graph.services[name].providers
            case "actions" if name in graph.actions:
                found += graph.actions[name].servers
            case "nodes":
                found.append(name)
            case "parameters" if name in graph.parameters:
                found += filter(None, (graph.parameters[name].node,))
    return [node for node in dict.fromkeys(found) if node != graph.own_node]
