"""Waiting for a change without a stream: the answer comes when there is something new, or when the time is over."""

from __future__ import annotations

from collections.abc import Callable

from starlette.requests import Request

from rosld.server.events import query_params
from rosld.server.events.broadcaster import Broadcaster, Broadcasters, Waiter
from rosld.server.http.problem import Problem
from rosld.server.rest.resource import Resource
from rosld.server.rest.state import State


async def wait_for_change(
    broadcasters: Broadcasters,
    resource: Resource,
    after: str,
    name: Callable[[State], str],
    request: Request,
    seconds: float,
) -> bool:
    """Whether the resource is, within so many seconds, in another state than `after` (or not there any more).

    False at once where the client has gone or the server ends. Raises a 503 or 429 Problem where too many wait already.
    """
    broadcasters.require_capacity(request.client)

    async def changes() -> None:
        with broadcasters.subscribe(resource) as broadcaster:
            await _until_other(broadcaster, after, name)

    with broadcasters.count_reader(request.scope):
        return await broadcasters.run_for_client(changes(), request.receive, seconds)


async def _until_other(broadcaster: Broadcaster, after: str, name: Callable[[State], str]) -> None:
    waiter = Waiter()
    while True:
        version = broadcaster.version
        state = (await broadcaster.observe()).state
        if isinstance(state, Problem) or not query_params.is_state(after, name(state)):
            return
        await broadcaster.wait(waiter, version)
