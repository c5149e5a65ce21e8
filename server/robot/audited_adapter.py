"""The adapter as the server uses it: each write passes the interlock and is recorded in the audit of its request."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import lru_cache
from typing import ParamSpec, TypeAlias, TypeVar

from rosld.adapters.base import Adapter, Capabilities, Published, Recording, Sink, Subscription, Watch
from rosld.adapters.catalogue import Catalogue
from rosld.adapters.model import (
    GoalId,
    Graph,
    Operation,
    ParameterValue,
    Ref,
    Refused,
    RosError,
    Sample,
    Schema,
    TimedOut,
    TypeRef,
)
from rosld.ontology.urls import Space
from rosld.server.receipts.audit import current_audit, record_step
from rosld.server.robot.interlock import Stopped, WriteInterlock
from rosld.server.runtime.dry_run import DryRunEnded, is_dry_run
from rosld.server.runtime.timings import Timings

_T = TypeVar("_T")
_P = ParamSpec("_P")
Gate: TypeAlias = Callable[[Callable[[], Awaitable[_T]]], Awaitable[_T]]


class _CountedSubscription:
    """A subscription that counts as open until it is closed; reads go to the adapter's subscription directly."""

    def __init__(self, inner: Subscription, topic: str, counts: Counter[str]) -> None:
        self.latest = inner.latest
        self.watch = inner.watch
        self._inner = inner
        self._topic = topic
        self._counts = counts
        self._is_open = True
        counts[topic] += 1

    def close(self) -> None:
        """Close the subscription. Idempotent."""
        if self._is_open:
            self._is_open = False
            self._counts[self._topic] -= 1
            self._inner.close()


@contextmanager
def errors_about(*urls: str) -> Iterator[None]:
    """Add these URLs to the subjects of a ROS error, unless the robot is stopped."""
    try:
        yield
    except RosError as error:
        if not isinstance(error, Stopped):
            error.about += urls
        raise


@contextmanager
def _step(does: str, url: str) -> Iterator[None]:
    """Record a step of a write, and add its URL to ROS errors."""
    record_step(does, url)
    with errors_about(url):
        yield


def _outcome_of(error: BaseException) -> str:
    """Return the outcome of a command that raised an error."""
    if isinstance(error, DryRunEnded):
        return "dry_run"
    if isinstance(error, asyncio.CancelledError):
        return "cancelled"
    if isinstance(error, TimedOut):
        return "timeout"
    return "refused" if isinstance(error, Refused | Stopped) else "failed"


class AuditedAdapter:
    """An `Adapter` behind the interlock that records each write in the audit context of its request.

    ROS errors of a write carry the URLs of their subjects. In a dry run a publish returns its likely outcome, and every
    other write ends the run; nothing is sent.

    `inner` is the wrapped adapter, for reads that call services (getters). `published` are the topics published to,
    until they are no longer advertised; `subscriptions` counts the open ones by topic, `timings` those of commands.
    """

    def __init__(self, inner: Adapter, interlock: WriteInterlock, space: Space) -> None:
        self.inner = inner
        self.published: set[str] = set()
        self.subscriptions = Counter[str]()
        self.timings = Timings(_outcome_of)
        self._interlock = interlock
        self._space = space
        self._topic_url = lru_cache(maxsize=4096)(space.topic)

    async def _run(
        self, gate: Gate[_T], method: Callable[_P, Awaitable[_T]], *arguments: _P.args, **named: _P.kwargs
    ) -> _T:
        """Run a command of the adapter behind a gate of the interlock, and measure it by the name of the method."""
        subject = arguments[0]
        attributes = {"rosld.name": subject} if isinstance(subject, str) else {}
        with self.timings.measure(method.__name__, attributes):
            return await gate(lambda: method(*arguments, **named))

    # Writes

    async def publish(
        self,
        topic: str,
        type: TypeRef,
        data: bytes,
        *,
        latch: bool = False,
        deadline: float,
        passes_stop: bool = False,
    ) -> Published:
        """Publish; raises TopicHeld while an agent holds the topic. `passes_stop`: also while stopped."""
        audit, url = current_audit.get(), self._topic_url(topic)
        if audit is not None:
            audit.add_step(f"publish a {type.name} on {topic}", url)
        with errors_about(url):
            self._interlock.require_free(topic)
            if is_dry_run():
                return self._planned_publish(topic, passes_stop=passes_stop)
            self.published.add(topic)
            run = self._interlock.run_always if passes_stop else self._interlock.run
            published = await self._run(run, self.inner.publish, topic, type, data, latch=latch, deadline=deadline)
        if audit is not None:
            audit.add_receivers(published.matched)
        return published

    def _planned_publish(self, topic: str, *, passes_stop: bool) -> Published:
        """Return the expected outcome of a publish in a dry run, from the graph. Raises Stopped."""
        if not passes_stop:
            self._interlock.require_open()
        graph = self.graph
        there = graph.topics.get(topic)
        return Published(0 if there is None else sum(each.node != graph.own_node for each in there.subscribers))

    async def publish_for_hold(
        self, topic: str, type: TypeRef, data: bytes, *, deadline: float, passes_stop: bool = False
    ) -> Published:
        """Publish for the hold of the topic (see `Adapter.publish`). `passes_stop`: also while the robot is stopped."""
        self.published.add(topic)
        run = self._interlock.run_always if passes_stop else self._interlock.run
        return await self._run(run, self.inner.publish, topic, type, data, deadline=deadline)

    async def publish_always(self, topic: str, type: TypeRef, data: bytes, *, deadline: float) -> Published:
        """Publish even while the robot is stopped, to end a hold or stop the robot (see `Adapter.publish`)."""
        self.published.add(topic)
        return await self._run(self._interlock.run_always, self.inner.publish, topic, type, data, deadline=deadline)

    async def call_always(self, service: str, type: TypeRef, request: bytes, *, deadline: float) -> bytes:
        """Call a service even while the robot is stopped, to stop it (see `Adapter.call`)."""
        return await self._run(self._interlock.run_always, self.inner.call, service, type, request, deadline=deadline)

    async def advertise(self, topic: str, type: TypeRef, *, deadline: float) -> None:
        """Advertise even while the robot is stopped, as this sends nothing (see `Adapter.advertise`)."""
        self.published.add(topic)
        await self._interlock.run_always(lambda: self.inner.advertise(topic, type, deadline=deadline))

    async def unadvertise(self, topic: str) -> None:
        """Stop advertising (see `Adapter.unadvertise`). Raises TopicHeld while an agent holds the topic."""
        record_step(f"stop advertising {topic}", self._space.topic(topic))
        self._interlock.require_free(topic)
        await self._interlock.run(lambda: self.inner.unadvertise(topic))
        self.published.discard(topic)

    async def unadvertise_always(self, topic: str) -> None:
        """Stop advertising, even while the robot is stopped, a topic advertised to stop it."""
        await self._interlock.run_always(lambda: self.inner.unadvertise(topic))
        self.published.discard(topic)

    async def call(self, service: str, type: TypeRef, request: bytes, *, deadline: float) -> bytes:
        """See `Adapter.call`."""
        with _step(f"call {service} ({type.name})", self._space.service(service)):
            return await self._run(self._interlock.run, self.inner.call, service, type, request, deadline=deadline)

    async def send_goal(self, action: str, type: TypeRef, goal: bytes, *, deadline: float) -> GoalId:
        """See `Adapter.send_goal`."""
        with _step(f"send a goal to {action} ({type.name})", self._space.action(action)):
            return await self._run(self._interlock.run, self.inner.send_goal, action, type, goal, deadline=deadline)

    async def cancel_goal(self, goal: GoalId, *, deadline: float) -> None:
        """Cancel a goal even while the robot is stopped, as this ends motion (see `Adapter.cancel_goal`)."""
        with _step(f"cancel the goal {goal.id} of {goal.action}", self._space.action(goal.action)):
            await self._run(self._interlock.run_always, self.inner.cancel_goal, goal, deadline=deadline)

    async def cancel_goals(self, action: str, *, deadline: float) -> None:
        """Cancel goals even while the robot is stopped, as this ends motion (see `Adapter.cancel_goals`)."""
        with _step(f"cancel all goals of {action}", self._space.action(action)):
            await self._run(self._interlock.run_always, self.inner.cancel_goals, action, deadline=deadline)

    async def change_state(self, node: str, transition: str, *, deadline: float) -> None:
        """See `Adapter.change_state`."""
        record_step(f"have {node} {transition}", self._space.node(node))
        await self._run(self._interlock.run, self.inner.change_state, node, transition, deadline=deadline)

    async def set_parameters(self, values: Mapping[str, ParameterValue], *, deadline: float) -> None:
        """See `Adapter.set_parameters`."""
        for name in values:
            record_step(f"set the parameter {name}", self._space.parameter(name))
        with errors_about(*map(self._space.parameter, values)):
            await self._run(self._interlock.run, self.inner.set_parameters, values, deadline=deadline)

    async def delete_parameters(self, names: Sequence[str], *, deadline: float) -> None:
        """See `Adapter.delete_parameters`."""
        for name in names:
            record_step(f"delete the parameter {name}", self._space.parameter(name))
        await self._run(self._interlock.run, self.inner.delete_parameters, names, deadline=deadline)

    # Reads

    @property
    def capabilities(self) -> Capabilities:
        """See `Adapter.capabilities`."""
        return self.inner.capabilities

    @property
    def graph(self) -> Graph:
        """See `Adapter.graph`."""
        return self.inner.graph

    @property
    def recordings(self) -> Mapping[str, Recording]:
        """See `Adapter.recordings`."""
        return self.inner.recordings

    @property
    def catalogue(self) -> Catalogue | None:
        """See `Adapter.catalogue`."""
        return self.inner.catalogue

    async def wait_for_recordings(self) -> None:
        """See `Adapter.wait_for_recordings`."""
        await self.inner.wait_for_recordings()

    async def open(self, sink: Sink, *, deadline: float) -> None:
        """See `Adapter.open`."""
        await self.inner.open(sink, deadline=deadline)

    async def close(self) -> None:
        """See `Adapter.close`."""
        await self.inner.close()

    def allows(self, ref: Ref) -> frozenset[Operation]:
        """See `Adapter.allows`."""
        return self.inner.allows(ref)

    async def schema(self, ref: TypeRef, *, deadline: float) -> Schema:
        """See `Adapter.schema`."""
        return await self.inner.schema(ref, deadline=deadline)

    def known_types(self) -> Sequence[TypeRef]:
        """See `Adapter.known_types`."""
        return self.inner.known_types()

    async def subscribe(self, topic: str, *, depth: int = 1) -> Subscription:
        """See `Adapter.subscribe`."""
        return _CountedSubscription(await self.inner.subscribe(topic, depth=depth), topic, self.subscriptions)

    def age_ns(self, sample: Sample) -> int:
        """See `Adapter.age_ns`."""
        return self.inner.age_ns(sample)

    async def follow_goals(self, action: str, *, deadline: float) -> Watch:
        """See `Adapter.follow_goals`."""
        return await self.inner.follow_goals(action, deadline=deadline)

    async def get_parameters(self, names: Sequence[str], *, deadline: float) -> Mapping[str, ParameterValue]:
        """See `Adapter.get_parameters`."""
        return await self.inner.get_parameters(names, deadline=deadline)


async def has_other_values(
    adapter: AuditedAdapter, requested: Mapping[str, ParameterValue], *, deadline: float
) -> bool:
    """Whether a node changed a requested value.

    Only parameters that nodes declare are read again: others always retain the value set. A value that cannot be read
    now counts as set.
    """
    parameters = adapter.graph.parameters
    declared = [name for name in requested if name in parameters and parameters[name].descriptor is not None]
    if not declared:
        return False
    try:
        current = await adapter.get_parameters(declared, deadline=deadline)
    except RosError:
        return False
    return any(current[name] != requested[name] for name in declared if name in current)
