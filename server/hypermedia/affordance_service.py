"""Affordances: the current state of the resources below `/resources/`, and the operations on offer.

The resource tree describes which resources exist, the readings their state, and the results of conditions what is on
offer. All three are values, which this service keeps in sync with the robot.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Iterable, Mapping, Sequence
from contextlib import asynccontextmanager
from typing import Generic, TypeVar

from msgspec import Struct
from msgspec.structs import replace

from rosld.adapters.base import Watch
from rosld.adapters.model import ActionSchema, Descriptor, Graph, Kind, Operation, Ref, RosError, Schema, TypeRef
from rosld.ontology.neutral_message import COMMANDS
from rosld.ontology.units import UNKNOWN
from rosld.ontology.violations import violations_text
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.catalogue import GoalSource, ParameterSource, Property, Reader, TopicSource, source_url
from rosld.server.hypermedia.conditions import ConditionResults, url_of
from rosld.server.hypermedia.conventions import CONVENTIONS, Conventions, catalogue, needed_types
from rosld.server.hypermedia.mapping import Condition, MappingSet
from rosld.server.hypermedia.mapping_check import field_shape, limited_shape, with_descriptor
from rosld.server.hypermedia.mappings import Mappings
from rosld.server.hypermedia.property_reader import PropertyReader
from rosld.server.hypermedia.property_writer import current_writer
from rosld.server.hypermedia.resource_tree import ActionPlan, ComplexPlan, MemberPlan, PropertyPlan, ResourceTree
from rosld.server.hypermedia.value import Reading
from rosld.server.hypermedia.views import (
    ActionAffordance,
    ActionView,
    ComplexView,
    GoalAffordance,
    LinkAffordance,
    Member,
    PropertyAffordance,
    PropertyView,
)
from rosld.server.robot.session import Session
from rosld.server.runtime.tasks import Signal, call_every, combine_watches, loop_time
from rosld.server.runtime.version_cache import VersionCache
from rosld.server.settings import Settings
from rosld.shapes.limits import Limits

T = TypeVar("T")

_MIN_SECONDS = 0.1
"""Minimum interval in seconds between calls of a getter whose value is observed."""
_MANY_NAMES = 200
"""Number of names in a graph from which a thread computes the resources (10,000 names take most of a second)."""
_TYPES_SECONDS = 3.0
"""Seconds that a tree waits for missing types; those that arrive later lead to another tree."""


class Snapshot(Struct, frozen=True):
    """Readings of some properties at one moment, by name, and the results of the conditions on them."""

    readings: Mapping[str, Reading]
    results: ConditionResults


class AffordanceService(Generic[T]):
    """The resources of levels two and three of one robot."""

    def __init__(
        self,
        session: Session,
        mappings: Mappings,
        readings: PropertyReader,
        states: VersionCache[T],
        limits: Callable[[], Limits],
    ) -> None:
        self._session = session
        self._mappings = mappings
        self._readings = readings
        self._states = states
        self._absences = VersionCache[Problem]()
        self._limits = limits
        self.conventions = conventions_of(session.settings)
        session.add_write_listener(self._on_write)
        self._last: tuple[Graph, int, MappingSet, ResourceTree] | None = None
        self._making: asyncio.Lock = asyncio.Lock()
        self._turns: dict[str, asyncio.Lock] = {}
        self._changes = Signal()

    # The tree

    def cached_tree(self) -> ResourceTree | None:
        """Return the tree if it matches the current graph, types and mappings, without waiting."""
        last, session = self._last, self._session
        if last is None or last[0] is not session.graph or last[2] is not self._mappings.mapping_set:
            return None
        return last[3] if last[1] == session.schemas.count else None

    @property
    def last_tree(self) -> ResourceTree | None:
        """Return the most recent tree, which may be outdated."""
        return None if self._last is None else self._last[3]

    async def tree(self) -> ResourceTree:
        """Return the current tree, after fetching the types of new services."""
        found = self.cached_tree()
        if found is not None:
            return found
        async with self._making:
            return self.cached_tree() or await self._build_tree()

    async def _build_tree(self) -> ResourceTree:
        session = self._session
        graph, mapping_set = session.graph, self._mappings.mapping_set
        await self._learn(needed_types(graph, self.conventions))
        known, count = self._last, session.schemas.count
        if known is not None and known[0] is graph and known[1] == count:
            found = known[3].catalogue
        else:
            find = self._schema_at_hand
            is_small = len(graph.topics) + len(graph.services) + len(graph.parameters) < _MANY_NAMES
            found = (
                catalogue(graph, find, self.conventions)
                if is_small
                else await asyncio.to_thread(catalogue, graph, find, self.conventions)
            )
        tree = ResourceTree(found, mapping_set)
        self._last = (graph, count, mapping_set, tree)
        return tree

    async def _learn(self, refs: Iterable[TypeRef]) -> None:
        schemas = self._session.schemas
        unknown = [ref for ref in refs if self._schema_at_hand(ref) is None]
        if not unknown:
            return

        async def find(ref: TypeRef) -> Schema | None:
            with contextlib.suppress(RosError, asyncio.TimeoutError):
                return await schemas.get(ref)
            return None

        with contextlib.suppress(asyncio.TimeoutError, TimeoutError):
            await asyncio.wait_for(asyncio.gather(*map(find, unknown)), _TYPES_SECONDS)

    def _schema_at_hand(self, ref: TypeRef) -> Schema | None:
        """Return the schema of a type if it is known; by name alone where its hash is unknown."""
        schemas = self._session.schemas
        return schemas.find_cached(ref) or (schemas.find_cached_by_name(ref.name) if ref.hash is None else None)

    async def mapping_warnings(self, url: str) -> tuple[str, ...]:
        """Return sentences about the missing or unavailable parts of the mapping at a URL."""
        document = self._mappings.documents.get(url)
        if document is None:
            return ()
        tree = await self.tree()
        plans = (tree.complex(resource.path) for resource in document.resources)
        return tuple(words for plan in plans if plan is not None for words in plan.warnings)

    # Reading

    def cached_readings(self, reads: Sequence[Property]) -> tuple[Reading, ...] | None:
        """Return the readings of these properties if all are still valid, without waiting."""
        known = self._readings.cached
        found = []
        for one in reads:
            reading = known(one)
            if reading is None:
                return None
            found.append(reading)
        return tuple(found)

    async def read(self, reads: Sequence[Property], *, refresh: bool = False) -> tuple[Reading, ...]:
        """Return the readings of these properties, read together under one deadline; `refresh`: read them all again."""
        session = self._session
        deadline = loop_time() + session.settings.read_deadline
        found = await self._readings.read(reads, deadline=deadline, refresh=refresh)
        return tuple(found[one.name] for one in reads)

    async def cached_state(
        self, url: str, tree: ResourceTree, reads: Sequence[Property], make: Callable[[Snapshot], T]
    ) -> T:
        """Return the state of the resource at `url`, cached while the readings of these properties are valid.

        Raises what `make` raises. That it does not exist is cached, too: a query asks for all that may exist, and the
        conditions took a third of its time.
        """
        readings = self.cached_readings(reads) or await self.read(reads)
        version = (tree, readings, self._is_open)
        absence = self._absences.find(url, version)
        if absence is not None:
            raise absence.with_traceback(None)
        try:
            return self._states.get_or_make(url, version, lambda: make(self.snapshot(tree, readings)))
        except Problem as problem:
            self._absences.put(url, version, problem)
            raise

    def unread(self, tree: ResourceTree, reads: Iterable[Property]) -> Snapshot:
        """Return the snapshot in which these properties have no values yet."""
        return self.snapshot(tree, (_unread(one.name) for one in reads))

    def snapshot(self, tree: ResourceTree, readings: Iterable[Reading]) -> Snapshot:
        """Return the snapshot with these readings."""
        by_name = {reading.name: reading for reading in readings}
        return Snapshot(by_name, ConditionResults(tree, by_name, self._session.space, self._session.lifting))

    def max_age(self, readings: Sequence[Reading]) -> int:
        """Return for how many seconds these readings may be cached: 0 if one can change at any moment."""
        if not readings or any(one.fresh_until is None for one in readings):
            return 0
        return int(self._session.settings.freshness)

    async def watch(self, reads: Sequence[Property], wake: Callable[[], None]) -> Watch:
        """Call `wake` when one of these properties may have changed, or the graph, types or mappings have."""
        session, names = self._session, {one.name for one in reads}
        watches = [session.changes.watch(wake), self._changes.watch(wake, lambda name: name in names)]
        watches += [await self._watch_source(one.readers[0], wake) for one in reads if is_observable(one)]
        if not all(map(is_observable, reads)):
            watches.append(call_every(max(_MIN_SECONDS, session.settings.freshness), wake))
        return combine_watches(*watches)

    async def _watch_source(self, source: Reader, wake: Callable[[], None]) -> Watch:
        session = self._session
        if isinstance(source, GoalSource):
            await session.goals.follow(source.name, deadline=loop_time() + session.settings.first_value_wait)
            return session.goals.watch(source.name, wake)
        return await session.topics.watch(source.name, wake)

    # Views

    def complex_view(self, plan: ComplexPlan, snapshot: Snapshot) -> ComplexView:
        """Return a complex resource with everything on offer now. Raises a 404 Problem if it does not exist."""
        results = snapshot.results
        self.require_exists(plan.exists_when, results, plan.path)
        space = self._session.space
        mapped = plan.mapped
        return ComplexView(
            url_of(plan.path, space),
            plan.path,
            tuple(
                Member(
                    self.member_affordance(one, self._is_open and results.hold(one.write_conditions)),
                    snapshot.readings[one.source.name],
                    one.field,
                )
                for one in plan.members
            ),
            tuple(
                self.action_affordance(action)
                for action in plan.actions
                if self._is_open and results.hold(action.conditions)
            ),
            tuple(
                LinkAffordance(link.relation, url_of(link.target, space))
                for link in plan.links
                if results.hold(link.conditions)
            ),
            tuple(url_of(child.path, space) for child in plan.children if results.hold(child.conditions)),
            None if plan.parent is None else url_of(plan.parent, space),
            mapped.title if mapped else None,
            mapped.iri if mapped else None,
            plan.warnings,
        )  # fmt: skip

    def property_view(self, plan: PropertyPlan, snapshot: Snapshot) -> PropertyView:
        """Return a single property. Raises a 404 Problem if it does not exist."""
        self.require_exists(plan.exists_when, snapshot.results, plan.source.name)
        own, space = plan.source, self._session.space
        affordance = self.member_affordance(plan.member, self._is_open and snapshot.results.hold(plan.write_conditions))
        reading = snapshot.readings[own.name]
        return PropertyView(
            affordance,
            reading,
            tuple(source_url(way, space) for way in own.readers),
            tuple(source_url(way, space) for way in own.writers),
            url_of(plan.parent, space),
            plan.member.field,
        )

    def action_view(self, plan: ActionPlan, snapshot: Snapshot) -> ActionView:
        """Return a single action. Raises a 404 Problem if it is not on offer."""
        self.require_exists((*plan.exists_when, *plan.conditions), snapshot.results, plan.name)
        space = self._session.space
        invokes = space.action(plan.service) if plan.sends_goals else space.service(plan.service)
        affordance = replace(self.action_affordance(plan), is_open=self._is_open)
        parts = tuple(self.member_affordance(_member_of(one), write=False) for one in plan.parts)
        return ActionView(affordance, invokes, url_of(plan.parent, space), parts)

    @property
    def _is_open(self) -> bool:
        """Whether the robot accepts operations; it does not while it is stopped."""
        return not self._session.is_stopped

    def require_exists(self, conditions: Iterable[Condition], results: ConditionResults, name: str) -> None:
        """Raise a 404 Problem with the reason if a condition for the existence of a resource does not hold."""
        broken = results.violations(conditions)
        if broken:
            raise Problem(
                404,
                f"{name} is not on offer now: {violations_text(broken)}.",
                title="Not on offer now",
                violations=broken,
            )

    # Affordances

    async def conditions_hold(
        self, tree: ResourceTree, reads: Sequence[Property], *conditions: Sequence[Condition]
    ) -> Sequence[bool]:
        """Whether all of each group of conditions hold now. Raises RosError if the state cannot be read."""
        if not any(conditions):
            return [True] * len(conditions)
        results = self.snapshot(tree, self.cached_readings(reads) or await self.read(reads)).results
        return [results.hold(each) for each in conditions]

    def member_affordance(self, plan: MemberPlan, write: bool) -> PropertyAffordance:
        """Return the affordance of a property, empty without a URL; `write`: whether its conditions hold."""
        own, mapped, session = plan.source, plan.mapped, self._session
        url = url_of(plan.url_name or own.name, session.space)
        quantity = mapped.quantity if mapped else UNKNOWN
        shape = limited_shape(own.shape, self._limits(), url, quantity)
        declared = self._declared_descriptor(own)
        if declared is not None:
            shape = with_descriptor(shape, declared)
        if plan.field is not None:
            shape = field_shape(shape, plan.field, self._limits().bounds_of_resource(url), quantity)
        return PropertyAffordance(
            plan.name,
            url,
            shape,
            mapped.predicate if mapped else None,
            read=plan.url_name is not None and bool(own.readers),
            write=plan.url_name is not None and write and self.is_writable(own),
            observe=plan.url_name is not None and is_observable(own),
            description=None if declared is None else declared.description or None,
            hold=self._held_at(own) if write and plan.field is None else None,
        )

    def _held_at(self, own: Property) -> str | None:
        """Return the URL for holding the topic that a property is written to, if that takes velocity commands."""
        match current_writer(self._session.adapter, self._session.settings, own):
            case TopicSource(name=name, schema=schema) if schema is not None and schema.ref.name in COMMANDS:
                return self._session.space.topic(name)
        return None

    def _declared_descriptor(self, own: Property) -> Descriptor | None:
        """Return the declaration of the parameter that is the first writer of a property."""
        first = own.writers[0] if own.writers else None
        parameter = self._session.graph.parameters.get(first.name) if isinstance(first, ParameterSource) else None
        return None if parameter is None else parameter.descriptor

    def action_affordance(self, plan: ActionPlan) -> ActionAffordance:
        """Return the affordance of an action."""
        request = plan.request if self.is_callable(plan) else None
        url = url_of(plan.name, self._session.space)
        name = plan.name.rpartition("/")[2]
        goals: GoalAffordance | None = None
        if plan.sends_goals:
            schema = plan.schema if isinstance(plan.schema, ActionSchema) else None
            status = url_of(f"{plan.service}/", self._session.space) if plan.parts else None
            can_cancel = self.can_cancel(plan)
            feedback, result = (None, None) if schema is None else (schema.feedback, schema.result)
            goals = GoalAffordance(status, can_cancel, feedback, result)
        return ActionAffordance(name, url, request, plan.relation, goals=goals)

    # Writing

    def is_writable(self, own: Property) -> bool:
        """Whether ROS and the settings permit writes of a property now, regardless of conditions."""
        return current_writer(self._session.adapter, self._session.settings, own) is not None

    def is_callable(self, plan: ActionPlan) -> bool:
        """Whether ROS and the settings permit calls of an action now, regardless of conditions."""
        session = self._session
        if plan.schema is None or session.settings.read_only:
            return False
        if plan.sends_goals:
            return Operation.SEND_GOAL in session.adapter.allows(Ref(Kind.ACTION, plan.service))
        return Operation.CALL in session.adapter.allows(Ref(Kind.SERVICE, plan.service))

    def can_cancel(self, plan: ActionPlan) -> bool:
        """Whether goals of an action can be canceled, also while the robot is stopped and regardless of conditions."""
        session = self._session
        return plan.sends_goals and session.adapter.capabilities.writes and not session.settings.read_only

    @asynccontextmanager
    async def lock(self, tree: ResourceTree, *names: str, modified: Iterable[str] = ()) -> AsyncIterator[None]:
        """Lock these names and all names related to them by conditions, so that no other request writes them meanwhile.

        This includes the properties `modified`, whose new values depend on their old ones. Raises a 503 Problem if
        other writers hold a lock for too long.
        """
        keys = sorted({*tree.lock_names(names), *modified})
        locks = [self._turns.setdefault(key, asyncio.Lock()) for key in keys]
        if not locks:
            yield
            return
        async with contextlib.AsyncExitStack() as held:
            try:
                await asyncio.wait_for(_take(held, locks), self._session.settings.call_deadline)
            except (asyncio.TimeoutError, TimeoutError):
                sentence = f"Another write to the members of {names[0]} is still in progress; nothing was done."
                raise Problem(503, sentence, headers={"Retry-After": "1"}) from None
            yield

    def _on_write(self, kind: Kind, name: str) -> None:
        """Invalidate values that a write to a topic, service or parameter may have changed."""
        if self._last is not None:
            affected = self._last[3].affected_by(kind, name)
            self._readings.invalidate(affected)
            for each in affected:
                self._changes.emit(each)


def conventions_of(settings: Settings) -> Conventions:
    """Return the conventions extended by the settings. Raises ValueError for an invalid template or glob."""
    return CONVENTIONS.extend(getters=settings.getter, setters=settings.setter, excluded=settings.exclude_service)


async def _take(held: contextlib.AsyncExitStack, locks: Iterable[asyncio.Lock]) -> None:
    for lock in locks:
        await held.enter_async_context(lock)


def is_observable(found: Property) -> bool:
    """Whether changes of a property are pushed: those of topics and of goals are."""
    return bool(found.readers) and isinstance(found.readers[0], TopicSource | GoalSource)


def _unread(name: str) -> Reading:
    """Return the same reading each time, as readings are compared by identity."""
    return Reading(name, None)


def _member_of(part: Property) -> MemberPlan:
    """Return a property of an action's goal as a member of the complex resource below the action's name."""
    return MemberPlan(part.name.rpartition("/")[2], part, part.name, ())
