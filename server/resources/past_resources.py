"""`/resources/...?at=TIME`: former states of resources, from the history of their topics.

What getters and parameters said then nobody recorded: that is told in place of a value. Nothing is on offer
then, and whether a mapping had it on offer is not judged.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Sequence
from dataclasses import replace
from functools import partial
from urllib.parse import quote

from starlette.responses import Response

from rosld.adapters.model import RosError
from rosld.server.history.history import History
from rosld.server.html.forms import Form
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.affordance_service import AffordanceService, Snapshot
from rosld.server.hypermedia.catalogue import Getter, ParameterSource, Property, TopicSource, source_url
from rosld.server.hypermedia.resource_tree import ComplexPlan, PropertyPlan
from rosld.server.hypermedia.source_reader import decode_value
from rosld.server.hypermedia.value import Reading
from rosld.server.hypermedia.view_documents import complex_document, complex_json, property_document, property_json
from rosld.server.resources.complex_resource import ComplexResource
from rosld.server.resources.limit_checks import LimitChecks
from rosld.server.resources.memento import (
    SETTLED_NS,
    VARY,
    found,
    is_recorded,
    memento_datetime,
    memento_url,
    parse_accept_datetime,
    read_history,
    time_map_of,
    timegate_links,
)
from rosld.server.resources.property_action import MemberResource
from rosld.server.resources.series import read_time
from rosld.server.resources.things import ThingDescriptions
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.resource import READ, Resource
from rosld.server.rest.state import State
from rosld.server.robot.session import Session
from rosld.server.runtime.version_cache import VersionCache

_NOT_KEPT = "Nothing is recorded: rosld serve --history records topics."


class PastReadings:
    """The readings of properties at a time."""

    def __init__(self, session: Session, affordances: AffordanceService[State], history: History, at_ns: int) -> None:
        self._session = session
        self._affordances = affordances
        self._history = history
        self._at_ns = at_ns

    async def snapshot(self, properties: Sequence[Property]) -> Snapshot:
        """Return the state that follows from readings of these properties."""
        readings = [await self._reading(each) for each in properties]
        return self._affordances.snapshot(await self._affordances.tree(), readings)

    async def _reading(self, property: Property) -> Reading:
        recorded = _recorded_topic(self._history, property)
        about = tuple(source_url(each, self._session.space) for each in property.readers)
        unreadable = partial(Reading, property.name, None, about=about)
        if recorded is None:
            return unreadable(_unknown(property))
        sample = await read_history(lambda: self._history.writer.latest_at(recorded, self._at_ns))
        if sample is None:
            return unreadable(f"nothing is recorded of {recorded} until then")
        try:
            schema = await self._session.schemas.message(sample.schema)
        except RosError as error:
            return unreadable(f"the message of {recorded} cannot be read: {error.sentence}")
        found = decode_value(recorded, sample, schema, property.name)
        return Reading(property.name, found.value, found.failure, found.read_ns, about=about if found.failure else ())


class _PastResource(Resource):
    """Base of the mementos of properties and complex resources: nothing is written, nothing changes."""

    kind = "Resource as it was"
    is_cacheable = False
    _history: History
    _at_ns: int
    _text: str
    """The time as it was asked for."""

    def _set_time(self, history: History, at_ns: int, text: str) -> None:
        self.links = (*self.links, *timegate_links(self.url))
        self._history, self._at_ns, self._text = history, at_ns, text

    @property
    def variant_key(self) -> Hashable:
        return self._text

    @property
    def query(self) -> str:
        return f"at={quote(self._text, safe=':')}"

    def methods(self) -> frozenset[str]:
        return READ

    async def watch(self, wake: Callable[[], None]) -> None:
        """The past changes no more."""

    async def forms(self) -> Sequence[Form]:
        return ()


class PastMember(_PastResource, MemberResource):
    """A property as it was at a time: a memento of it (RFC 7089)."""

    def __init__(self, now: MemberResource, history: History, at_ns: int, text: str) -> None:
        MemberResource.__init__(self, now.session, now.affordances, now.limit_checks, now.things, now.states, now.name)
        self._set_time(history, at_ns, text)

    async def state(self) -> State:
        tree = await self.affordances.tree()
        plan = tree.property(self.name)
        if plan is None:
            raise Problem(404, f"{self.name} is an action: nothing is recorded of it.")
        readings = PastReadings(self.session, self.affordances, self._history, self._at_ns)
        snapshot = await readings.snapshot(plan.reads)
        return _settle(self._as_it_was(replace(plan, exists_when=()), snapshot), self._at_ns)

    def _as_it_was(self, plan: PropertyPlan, snapshot: Snapshot) -> State:
        view = self.affordances.property_view(plan, snapshot)
        view = replace(view, affordance=replace(view.affordance, write=False, observe=False))
        return replace(
            self._state_of(plan, snapshot),
            describe=lambda: property_document(
                view, self.space, self.session.lifting, simulated_time=self.session.graph.simulated_time
            ),
            plain=lambda: property_json(view, self.session.lifting),
            view=None,
        )


class PastComplex(_PastResource, ComplexResource):
    """A complex resource as it was at a time: a memento of it (RFC 7089)."""

    def __init__(self, now: ComplexResource, history: History, at_ns: int, text: str) -> None:
        ComplexResource.__init__(self, now.session, now.affordances, now.limit_checks, now.things, now.path)
        self._set_time(history, at_ns, text)

    async def state(self) -> State:
        _, plan = await self._plan()
        readings = PastReadings(self.session, self.affordances, self._history, self._at_ns)
        snapshot = await readings.snapshot(plan.reads)
        return _settle(self._as_it_was(replace(plan, exists_when=()), snapshot), self._at_ns)

    def _as_it_was(self, plan: ComplexPlan, snapshot: Snapshot) -> State:
        view = self.affordances.complex_view(plan, snapshot)
        members = tuple(
            replace(each, affordance=replace(each.affordance, write=False, observe=False)) for each in view.members
        )
        view = replace(view, members=members, actions=())
        return replace(
            self._state_of(plan, snapshot),
            describe=lambda: complex_document(
                view, self.space, self.session.lifting, simulated_time=self.session.graph.simulated_time
            ),
            plain=lambda: complex_json(view, self.session.lifting),
            view=view,
        )

    async def custom_get(self, exchange: Exchange) -> Response | None:
        return None


class _TimeGate(Resource):
    """Base of properties and complex resources that are the TimeGates of their mementos (RFC 7089)."""

    session: Session
    history: History

    def _set_history(self, history: History) -> None:
        self.history = history
        if history.is_kept:
            self.links = (*self.links, *timegate_links(self.url))

    async def state(self) -> State:
        """Return the current state, with headers against caching for requests of other times."""
        state = await super().state()
        return replace(state, headers={**state.headers, "vary": VARY}) if self.history.is_kept else state

    async def select_variant(self, exchange: Exchange) -> Resource:
        """Return the state at `?at=TIME` or Accept-Datetime, or the `?timemap`."""
        if asks_for_time_map(self.history, exchange):
            topics = _recorded_topics(self.history, await self._sources())
            return time_map_of(self.space, self.history, self.url, self._name, topics, exchange)
        asked = asked_time(self.history, self.url, exchange)
        return await super().select_variant(exchange) if asked is None else self._memento(*asked)

    @property
    def _name(self) -> str:
        raise NotImplementedError

    async def _sources(self) -> Sequence[Property]:
        """The properties whose topics tell what it was."""
        raise NotImplementedError

    def _memento(self, at_ns: int, text: str) -> Resource:
        raise NotImplementedError


class MemberTimeGate(_TimeGate, MemberResource):
    """A property or an action, which is the TimeGate of its mementos."""

    def __init__(
        self,
        session: Session,
        affordances: AffordanceService[State],
        limit_checks: LimitChecks,
        things: ThingDescriptions,
        states: VersionCache[State],
        history: History,
        name: str,
    ) -> None:
        MemberResource.__init__(self, session, affordances, limit_checks, things, states, name)
        self._set_history(history)

    @property
    def _name(self) -> str:
        return self.name

    async def _sources(self) -> Sequence[Property]:
        plan = (await self.affordances.tree()).property(self.name)
        return () if plan is None else (plan.source,)

    def _memento(self, at_ns: int, text: str) -> PastMember:
        return PastMember(self, self.history, at_ns, text)


class ComplexTimeGate(_TimeGate, ComplexResource):
    """A complex resource, which is the TimeGate of its mementos."""

    def __init__(
        self,
        session: Session,
        affordances: AffordanceService[State],
        limit_checks: LimitChecks,
        things: ThingDescriptions,
        history: History,
        path: str,
    ) -> None:
        ComplexResource.__init__(self, session, affordances, limit_checks, things, path)
        self._set_history(history)

    @property
    def _name(self) -> str:
        return self.path

    async def _sources(self) -> Sequence[Property]:
        _, plan = await self._plan()
        return [each.source for each in plan.members]

    def _memento(self, at_ns: int, text: str) -> PastComplex:
        return PastComplex(self, self.history, at_ns, text)


def asked_time(history: History, url: str, exchange: Exchange) -> tuple[int, str] | None:
    """Return the time that `?at=` asks for, and its text; None where nothing does. Raises Problems: 302, 400, 404."""
    wanted = exchange.headers.get("accept-datetime")
    if exchange.method not in ("GET", "HEAD") or ("at" not in exchange.query and wanted is None):
        return None
    if "at" not in exchange.query:
        if wanted is None or not history.is_kept:
            return None
        at_ns = min(parse_accept_datetime(wanted), time.time_ns() - SETTLED_NS)
        raise found(memento_url(url, at_ns), timegate_links(url))
    if not history.is_kept:
        raise Problem(404, _NOT_KEPT)
    text = exchange.query["at"]
    return read_time(text, time.time_ns()), text


def asks_for_time_map(history: History, exchange: Exchange) -> bool:
    """Whether a request is one for the mementos that there are. Raises a 404 Problem where there are none."""
    if exchange.method not in ("GET", "HEAD") or "timemap" not in exchange.query:
        return False
    if not history.is_kept:
        raise Problem(404, _NOT_KEPT)
    return True


def _recorded_topic(history: History, property: Property) -> str | None:
    """Return the recorded topic that tells the past of a property; None where nothing does."""
    topics = (each.name for each in property.readers if isinstance(each, TopicSource))
    return next((each for each in topics if is_recorded(history, each)), None)


def _recorded_topics(history: History, properties: Sequence[Property]) -> frozenset[str]:
    found = (_recorded_topic(history, each) for each in properties)
    return frozenset(each for each in found if each is not None)


def _settle(state: State, at_ns: int) -> State:
    """Return a state with the headers of a memento, once nothing can change it any more."""
    is_settled = at_ns < time.time_ns() - SETTLED_NS
    headers = {"memento-datetime": memento_datetime(at_ns)} if is_settled else {}
    return replace(
        state, headers={**headers, "vary": VARY}, received_ns=None, max_age=0, token=None, renderings={}, redactions={}
    )


def _unknown(property: Property) -> str:
    """Return the reason why the past of a property is unknown."""
    kinds = {Getter: "the service", ParameterSource: "the parameter", TopicSource: "the topic"}
    sources = [f"{kinds.get(type(each), 'the action')} {each.name}" for each in property.readers]
    return f"what it was then is not known: {' and '.join(sources) or 'its source'} is not recorded"
