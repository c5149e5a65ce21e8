"""Triggers of recordings: a condition on the value of a resource, or one of a mapping, followed as streams are."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Callable
from urllib.parse import urljoin

from rosld.adapters.base import Watch
from rosld.ontology.document import Document
from rosld.ontology.urls import Space
from rosld.server.auth.permissions import Permissions
from rosld.server.events.broadcaster import Broadcaster, Waiter
from rosld.server.events.until import Until
from rosld.server.history.recordings import ArmedRecording, Trigger
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.affordance_service import AffordanceService
from rosld.server.hypermedia.conditions import url_of
from rosld.server.hypermedia.mapping import Condition
from rosld.server.hypermedia.mappings import Mappings
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.resource import Resource
from rosld.server.rest.state import State
from rosld.server.runtime.signals import Signal

Find = Callable[[str], Resource]
"""The resource at a path below the base."""


class MappedCondition(Resource):
    """A condition of a mapping as something that changes: its plain JSON is whether it holds."""

    kind = "Condition"

    def __init__(self, affordances: AffordanceService[State], condition: Condition) -> None:
        super().__init__(condition.iri)
        self._affordances = affordances
        self._condition = condition

    async def state(self) -> State:
        offers = self._affordances
        tree = await offers.tree()
        (holds,) = await offers.conditions_hold(tree, tree.properties_in([self._condition]), [self._condition])
        data = b"true" if holds else b"false"
        return State(lambda: Document(self.url, ()), lambda: data, token=data.decode())

    async def watch(self, wake: Callable[[], None]) -> Watch | None:
        offers = self._affordances
        tree = await offers.tree()
        return await offers.watch(tree.properties_in([self._condition]), wake)


async def trigger_of(
    space: Space,
    changes: Signal,
    affordances: AffordanceService[State],
    mappings: Mappings,
    trigger: Trigger,
    find: Find | None,
    exchange: Exchange,
) -> Callable[[ArmedRecording], AsyncGenerator[None, None]]:
    """What tells each time that a trigger's condition comes to hold, as who asks may see it. Raises 403, 422 Problems.

    That it holds at the beginning counts as well.
    """
    permissions = exchange.permissions
    resource: Resource
    if trigger.resource is None:
        resource, expression = (
            _mapped_condition(space, affordances, mappings, trigger.condition, permissions),
            "value = true",
        )
    else:
        resource, expression = _resource(space, trigger.resource, find, permissions), trigger.condition

    def view(state: State) -> State:
        return state if permissions.is_unrestricted else resource.redact(state, permissions)

    try:
        until = Until(expression, view)
        await resource.prepare()
        until.holds(await resource.state())
    except Problem as problem:
        words = problem.detail.removeprefix("?until= ")
        raise Problem(422, f"The trigger cannot be waited for: {words}") from problem

    async def occurrences(one: ArmedRecording) -> AsyncGenerator[None, None]:
        broadcaster, waiter, held = Broadcaster(resource, changes), Waiter(), False
        broadcaster.start()
        try:
            while True:
                version = broadcaster.version
                state = (await broadcaster.observe()).state
                holds, one.problem = _judge(until, state)
                if holds and not held:
                    yield
                held = holds
                await broadcaster.wait(waiter, version)
        finally:
            broadcaster.stop()

    return occurrences


def _judge(until: Until, state: State | Problem) -> tuple[bool, str | None]:
    """Whether the condition holds of a state, and why that cannot be told."""
    try:
        if isinstance(state, Problem):
            raise state
        return until.holds(state), None
    except Problem as problem:
        return False, f"It cannot be told whether its condition holds: {problem.detail}"


def _resource(space: Space, url: str, find: Find | None, permissions: Permissions) -> Resource:
    base = space.base
    whole = urljoin(base, url)
    if find is None or not whole.startswith(base) or "?" in whole or "#" in whole:
        raise Problem(422, f"The trigger is about {url[:200]}: it is about the URL of a value below {base}.")
    if not permissions.may_read(whole):
        raise Problem(403, f"You may not read {url[:200]}, so you may not wait for it.")
    try:
        return find("/" + whole[len(base) :])
    except ValueError as error:
        raise Problem(422, f"The trigger is about {url[:200]}: {error}.") from error
    except Problem as problem:
        raise Problem(422, f"The trigger is about {url[:200]}: {problem.detail}") from problem


def _mapped_condition(
    space: Space, affordances: AffordanceService[State], mappings: Mappings, iri: str, permissions: Permissions
) -> MappedCondition:
    for resource in mappings.mapping_set.resources.values():
        for condition in resource.conditions():
            if condition.iri == iri:
                if not permissions.may_read(url_of(condition.about, space)):
                    raise Problem(403, f"You may not read {condition.about}, so you may not wait for it.")
                return MappedCondition(affordances, condition)
    raise Problem(422, f"No mapping has a condition {iri[:200]}: a trigger on a value names its resource, too.")
