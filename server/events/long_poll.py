"""Long polling: a request is answered once the state is the one that it waits for, or at its timeout."""

from __future__ import annotations

from collections.abc import Callable

from starlette.requests import Request

from rosld.server.events.broadcaster import Broadcaster, Broadcasters, Waiter
from rosld.server.http.problem import Problem
from rosld.server.rest.resource import Resource
from rosld.server.rest.state import State


async def wait_for_state(
    broadcasters: Broadcasters,
    resource: Resource,
    is_wanted: Callable[[State], bool],
    request: Request,
    seconds: float,
) -> State | Problem | None:
    """The first state of the resource that is wanted, within so many seconds; the Problem where it has none.

    None where the time is over; at once where the client has gone or the server ends. Raises a 503 or 429 Problem where
    too many wait already, and what `is_wanted` raises.
    """
    broadcasters.require_capacity(request.client)
    found: list[State | Problem] = []

    async def changes() -> None:
        with broadcasters.subscribe(resource) as broadcaster:
            found.append(await _first(broadcaster, is_wanted))

    with broadcasters.count_reader(request.scope):
        await broadcasters.run_for_client(changes(), request.receive, seconds)
    return found[0] if found else None


async def _first(broadcaster: Broadcaster, is_wanted: Callable[[State], bool]) -> State | Problem:
    waiter = Waiter()
    while True:
        version = broadcaster.version
        state = (await broadcaster.observe()).state
        if isinstance(state, Problem) or is_wanted(state):
            return state
        await broadcaster.wait(waiter, version)
