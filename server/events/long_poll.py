"""Requests that wait for a change of a resource (long polling), or for a condition on it (`?until=`)."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

from starlette.requests import Request

from rosld.server.events.broadcaster import Broadcaster, Broadcasters, Waiter
from rosld.server.events.condition import Condition, ConditionError, Value, named_members, parse_condition
from rosld.server.http.problem import Problem
from rosld.server.rest.resource import Resource
from rosld.server.rest.state import EndedState, State


class Until:
    """A condition on the states of one resource, as seen by one agent.

    The first value must have the fields of the condition, with matching types: otherwise the wait would be in vain.
    """

    def __init__(self, text: str, view: Callable[[State], State]) -> None:
        """Initialize; `view` redacts a state for the agent. Raises a 400 Problem for an invalid condition."""
        try:
            self._condition: Condition = parse_condition(text)
        except ConditionError as error:
            raise _refusal(error) from error
        self._view = view
        self._is_checked = False

    def holds(self, state: State) -> bool:
        """Whether the condition is true for a state.

        Raises Problem 400 if it never can be, 409 if it no longer can because the subject has ended, and those of
        rendering the state as JSON.
        """
        view = self._view(state)
        if view.plain is None:
            raise Problem(
                400,
                "?until= needs a value, as topics, resources, parameters, calls and goals have. This has none: use "
                "?after=.",
            )
        value = cast(Value, view.json_value)
        if not self._is_checked and value is not None:
            try:
                self._condition.check(value)
            except ConditionError as error:
                raise _refusal(error) from error
            self._is_checked = True
        if self._condition.holds(value):
            return True
        if isinstance(view, EndedState) and not view.open_members & named_members(self._condition):
            detail = "?until= can no longer become true: the resource has ended; `state` is its final state."
            raise Problem(409, detail, title="Has ended", extra={"state": value})
        return False


def _refusal(error: ConditionError) -> Problem:
    return Problem(400, f"?until= is invalid: {error}.")


async def wait_for_state(
    broadcasters: Broadcasters,
    resource: Resource,
    is_wanted: Callable[[State], bool],
    request: Request,
    seconds: float,
) -> State | Problem | None:
    """Wait for the first wanted state of the resource, or its Problem; return None after `seconds`.

    Return None at once if the client disconnects or the server ends. Raises a 503 or 429 Problem if too many wait
    already, and exceptions of `is_wanted`.
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
