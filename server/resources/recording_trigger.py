"""Triggers of recordings: a condition on the value of a resource, or one of a mapping, followed like a stream."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncGenerator, Callable, Iterator, Sequence
from functools import partial
from urllib.parse import urljoin

from rosld.adapters.base import Capabilities, Watch
from rosld.adapters.model import RosError
from rosld.ontology.document import Document
from rosld.ontology.urls import Space
from rosld.server.auth.authenticator import Authenticator
from rosld.server.auth.permissions import ALLOW_ALL, Permissions
from rosld.server.events.broadcaster import LOOK_AGAIN_SECONDS, Broadcaster, Waiter
from rosld.server.events.long_poll import Until
from rosld.server.history.armed_recordings import ArmedRecording, MayRecord
from rosld.server.history.recording_orders import RecordingOrder, order_to_json
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.conditions import url_of
from rosld.server.hypermedia.mapping import Condition
from rosld.server.hypermedia.mappings import Mappings
from rosld.server.resources.base import Services, SessionResource
from rosld.server.resources.recording_order import order_of
from rosld.server.rest.resource import Find, Resource
from rosld.server.rest.ros_problems import problem_of
from rosld.server.rest.state import State
from rosld.server.runtime.tasks import call_every
from rosld.server.settings import Settings

NOTHING_IS_RECORDED = "This server is read-only, or serves a recording: it makes no recordings."


class MappedCondition(SessionResource):
    """A condition of a mapping as a resource; its plain JSON is true or false."""

    kind = "Condition"

    def __init__(self, services: Services, condition: Condition) -> None:
        super().__init__(services, condition.iri)
        self._affordances = services.affordances
        self.condition = condition

    async def state(self) -> State:
        offers = self._affordances
        tree = await offers.tree()
        (holds,) = await offers.conditions_hold(tree, tree.properties_in([self.condition]), [self.condition])
        data = b"true" if holds else b"false"
        return State(lambda: Document(self.url, ()), lambda: data, token=data.decode())

    async def watch(self, wake: Callable[[], None]) -> Watch | None:
        offers = self._affordances
        tree = await offers.tree()
        return await offers.watch(tree.properties_in([self.condition]), wake)


class FollowedCondition:
    """The trigger of a recording: a resource, and a condition on its state redacted for the agent."""

    def __init__(self, resource: Resource, expression: str, permissions: Permissions) -> None:
        """Raise a 400 Problem for an invalid condition."""
        self.resource = resource
        self.permissions = permissions
        self.until = Until(expression, self._view)

    def _view(self, state: State) -> State:
        return state if self.permissions.is_unrestricted else self.resource.redact(state, self.permissions)


class RecordingTriggers:
    """Follower of triggers; checks the agent's permissions when a recording is ordered, resumed and triggered.

    Without an `authenticator`, every agent may do everything.
    """

    def __init__(self, services: Services, authenticator: Authenticator | None) -> None:
        self._services = services
        self._session = services.session
        self._mappings = services.mappings
        self._authenticator = authenticator

    async def resume(self) -> None:
        """Wait again for the triggers of orders from before a restart."""
        self._services.recordings.resume(self.occurrences)

    async def follow(self, order: RecordingOrder, permissions: Permissions) -> FollowedCondition:
        """Return the condition of an order. Raises 403, 422 Problems if these permissions are insufficient."""
        trigger, space = order.trigger, self._session.space
        assert trigger is not None, "an armed recording has a trigger"
        try:
            if trigger.resource is None:
                resource = _mapped_condition(self._services, trigger.condition, permissions)
                followed = FollowedCondition(resource, "value = true", permissions)
            else:
                found = _resource(space, trigger.resource, self._services.find, permissions)
                followed = FollowedCondition(found, trigger.condition, permissions)
            await followed.resource.prepare()
            followed.until.holds(await followed.resource.state())
        except Problem as problem:
            if problem.status in (403, 422):
                raise
            words = problem.detail.removeprefix("?until= is invalid: ")
            words = f"The trigger is invalid: {words}"
            raise Problem(422, words, extra=problem.quoted_members, about=problem.about) from problem
        return followed

    async def occurrences(self, one: ArmedRecording) -> AsyncGenerator[MayRecord, None]:
        """Yield whenever the condition becomes true, with a function for the topics that the agent may record.

        Also yields if the condition is true at the beginning. While it cannot be followed, the recording shows why.
        """
        waiter = Waiter()
        while True:
            with self._woken_by_changes(waiter):
                try:
                    followed = await self.follow(one.order, self._require(one))
                except (Problem, RosError) as error:
                    one.suspend((error if isinstance(error, Problem) else problem_of(error)).with_quotes)
                    await waiter.sleep()
                    continue
            async with contextlib.aclosing(self._changes(one, followed)) as found:
                async for _ in found:
                    yield partial(may_read_topic, self._session.space, followed.permissions)

    async def _changes(self, one: ArmedRecording, followed: FollowedCondition) -> AsyncGenerator[None, None]:
        """Yield whenever the condition becomes true; end when the order would no longer be accepted."""
        broadcaster, waiter, held = Broadcaster(followed.resource, self._session.changes), Waiter(), False
        watch = None if self._authenticator is None else self._authenticator.changed.watch(broadcaster.wake_all)
        broadcaster.start()
        try:
            while True:
                # Read the version before the state, so that no change in between is missed.
                version = broadcaster.version
                state = (await broadcaster.observe()).state
                holds, problem = _judge(followed.until, state)
                try:
                    if not self._is_defined_so(followed.resource):
                        return
                    if (holds and not held) or self._permissions(one) is not followed.permissions:
                        followed.permissions = self._require(one)
                except Problem:
                    return
                one.suspend(problem)
                if holds and not held:
                    yield
                held = holds
                await broadcaster.wait(waiter, version)
        finally:
            broadcaster.stop()
            if watch is not None:
                watch.close()

    def _is_defined_so(self, resource: Resource) -> bool:
        """Whether a condition is unchanged in its mapping. Raises a 422 Problem if no mapping has it any more."""
        if not isinstance(resource, MappedCondition):
            return True
        return _condition(self._mappings, resource.condition.iri) == resource.condition

    def _permissions(self, one: ArmedRecording) -> Permissions | None:
        """Return the current permissions of the order's agent, or None if the agent is no longer known."""
        return ALLOW_ALL if self._authenticator is None else self._authenticator.current_permissions(one.agent)

    def _require(self, one: ArmedRecording) -> Permissions:
        """Return the current permissions of the order's agent. Raises 403, 422 Problems if they are insufficient."""
        space, permissions = self._session.space, self._permissions(one)
        if not can_record(self._session.settings, self._session.adapter.capabilities):
            raise Problem(403, NOTHING_IS_RECORDED)
        if permissions is None:
            raise Problem(403, "The agent that ordered it is no longer known.")
        if not permissions.may("POST", space.container("bags")):
            raise Problem(403, "The agent that ordered it may no longer record.")
        order_of(order_to_json(one.order))
        resource, condition = one.trigger.resource, one.trigger.condition
        if resource is None:
            resource = url_of(_condition(self._mappings, condition).about, space)
        for url in (resource, *map(space.topic, named_topics(one.order))):
            if not permissions.may_read(urljoin(space.base, url)):
                raise Problem(403, f"The agent that ordered it may no longer read {url[:200]}.")
        return permissions

    @contextlib.contextmanager
    def _woken_by_changes(self, waiter: Waiter) -> Iterator[None]:
        """Wake the waiter after changes of the robot, a mapping or permissions, and periodically."""
        watches = [self._session.changes.watch(waiter.wake), call_every(LOOK_AGAIN_SECONDS, waiter.wake)]
        if self._authenticator is not None:
            watches.append(self._authenticator.changed.watch(waiter.wake))
        try:
            yield
        finally:
            for watch in watches:
                watch.close()


def can_record(settings: Settings, capabilities: Capabilities) -> bool:
    """Whether clients may order recordings on this server."""
    return not settings.read_only and capabilities.system != "recording"


def may_read_topic(space: Space, permissions: Permissions, topic: str) -> bool:
    """Whether the agent may read a topic."""
    return permissions.may_read(space.topic(topic))


def named_topics(order: RecordingOrder) -> Sequence[str]:
    """Return the topics that an order names, without globs, which match only readable topics."""
    return [topic for topic in order.topics if not set(topic) & set("*?[")]


def urls_of(order: RecordingOrder, space: Space) -> Sequence[str]:
    """Return the URLs of the topics of an order (globs are treated as names) and of its trigger."""
    trigger = () if order.trigger is None else (order.trigger.resource or order.trigger.condition,)
    topics = (space.topic(each if each.startswith("/") else f"/{each}") for each in order.topics)
    return (*topics, *(urljoin(space.base, each) for each in trigger))


def require_topics(order: RecordingOrder, permissions: Permissions, space: Space) -> None:
    """Raise a 403 Problem if an order names a topic that the agent may not read."""
    for topic in named_topics(order):
        if not may_read_topic(space, permissions, topic):
            raise Problem(403, f"You may not read {topic}, so you may not record it.")


def _judge(until: Until, state: State | Problem) -> tuple[bool, str | None]:
    """Return whether the condition holds for a state, and the reason if it cannot be evaluated."""
    try:
        if isinstance(state, Problem):
            raise state
        return until.holds(state), None
    except Problem as problem:
        return False, f"Its condition cannot be evaluated: {problem.with_quotes}"


def _resource(space: Space, url: str, find: Find, permissions: Permissions) -> Resource:
    base = space.base
    whole = urljoin(base, url)
    if not whole.startswith(base) or "?" in whole or "#" in whole:
        raise Problem(422, f"The resource of the trigger must be the URL of a value below {base}, not {url[:200]}.")
    if not permissions.may_read(whole):
        raise Problem(403, f"You may not read {url[:200]}, so you may not wait for it.")
    try:
        return find("/" + whole[len(base) :])
    except ValueError as error:
        raise Problem(422, f"The resource of the trigger is {url[:200]}: {error}.") from error
    except Problem as problem:
        words = f"The resource of the trigger is {url[:200]}: {problem.detail}"
        raise Problem(422, words, extra=problem.quoted_members, about=problem.about) from problem


def _mapped_condition(services: Services, iri: str, permissions: Permissions) -> MappedCondition:
    condition = _condition(services.mappings, iri)
    if not permissions.may_read(url_of(condition.about, services.space)):
        raise Problem(403, f"You may not read {condition.about}, so you may not wait for it.")
    return MappedCondition(services, condition)


def _condition(mappings: Mappings, iri: str) -> Condition:
    for resource in mappings.mapping_set.resources.values():
        for condition in resource.conditions():
            if condition.iri == iri:
                return condition
    raise Problem(422, f"No mapping has a condition {iri[:200]}: a trigger on a value also needs a resource.")
