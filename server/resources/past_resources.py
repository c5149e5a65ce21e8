"""`/resources/...?at=TIME`: former states of resources, from the history of their topics.

What getters and parameters said then nobody recorded: that is told in place of a value. Nothing is on offer
then, and whether a mapping had it on offer is not judged.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial

from msgspec.structs import replace
from starlette.responses import Response

from rosld.adapters.model import RosError
from rosld.server.history.history import History
from rosld.server.http.fields import Link
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.affordance_service import AffordanceService, Snapshot
from rosld.server.hypermedia.catalogue import Getter, ParameterSource, Property, TopicSource, source_url
from rosld.server.hypermedia.conditions import url_of
from rosld.server.hypermedia.source_reader import decode_value
from rosld.server.hypermedia.value import Reading
from rosld.server.resources.accepted_shape import CommandResource
from rosld.server.resources.limit_checks import LimitChecks
from rosld.server.resources.memento import (
    SETTLED_NS,
    VARY,
    Memento,
    found,
    is_recorded,
    memento_datetime,
    memento_url,
    parse_accept_datetime,
    read_history,
    time_map_of,
    timegate_links,
)
from rosld.server.resources.series import read_time
from rosld.server.resources.things import ThingDescriptions
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.resource import Resource
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


class TimeGate(CommandResource):
    """Base of properties and complex resources, which are the TimeGates of their mementos (RFC 7089)."""

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
        super().__init__(session.space, url_of(name, session.space))
        self.name = name
        self.title = name if name != "/" else "Resources"
        self.session = session
        self.affordances = affordances
        self.limit_checks = limit_checks
        self.things = things
        self.states = states
        self.history = history
        self.links = (*self._own_links(), *(timegate_links(self.url) if history.is_kept else ()))
        self._headers = {"vary": VARY} if history.is_kept else {}
        """Headers of the current state, against caching for requests of other times."""

    def _own_links(self) -> tuple[Link, ...]:
        return type(self).links

    async def past_state(self, readings: PastReadings) -> State:
        """Return the state that follows from former readings. Raises a 404 Problem if it has no past."""
        raise NotImplementedError

    async def recorded_properties(self) -> Sequence[Property]:
        """Return the properties whose topics tell what it was."""
        raise NotImplementedError

    async def get_part(self, resource: Resource, exchange: Exchange) -> Response | None:
        """Return a requested part of the state of this resource, or of a memento."""
        return None

    async def select_variant(self, exchange: Exchange) -> Resource:
        """Return the state at `?at=TIME` or Accept-Datetime, or the `?timemap`."""
        if asks_for_time_map(self.history, exchange):
            topics = _recorded_topics(self.history, await self.recorded_properties())
            return time_map_of(self.space, self.history, self.url, self.name, topics, exchange)
        asked = asked_time(self.history, self.url, exchange)
        if asked is None:
            return await super().select_variant(exchange)
        at_ns, text = asked
        await self.prepare()
        return Memento(self, "Resource as it was", text, partial(self._state_at, at_ns), self.get_part)

    async def _state_at(self, at_ns: int) -> State:
        """Return a former state with the headers of a memento, once nothing can change it any more."""
        state = await self.past_state(PastReadings(self.session, self.affordances, self.history, at_ns))
        is_settled = at_ns < time.time_ns() - SETTLED_NS
        headers = {"memento-datetime": memento_datetime(at_ns)} if is_settled else {}
        return replace(
            state,
            headers={**headers, "vary": VARY},
            received_ns=None,
            max_age=0,
            token=None,
            renderings={},
            redactions={},
        )


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


def _unknown(property: Property) -> str:
    """Return the reason why the past of a property is unknown."""
    kinds = {Getter: "the service", ParameterSource: "the parameter", TopicSource: "the topic"}
    sources = [f"{kinds.get(type(each), 'the action')} {each.name}" for each in property.readers]
    return f"what it was then is not known: {' and '.join(sources) or 'its source'} is not recorded"
