"""Diagnostics at `/diagnostics`: the states of parts, the worst first; `?name=` selects one, with its recent states."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from urllib.parse import quote

import orjson

from rosld.adapters.base import MessageFilter, Watch
from rosld.adapters.model import Graph, MessageSchema, RosError, TypeRef
from rosld.ontology.describe_views import PartState, diagnostics_document
from rosld.ontology.literals import date_time
from rosld.server.auth.permissions import Permissions
from rosld.server.html.forms import Form
from rosld.server.html.page import Csrf, DiagnosticsPage, Notice
from rosld.server.html.render import render_diagnostics
from rosld.server.html.site import Site
from rosld.server.http.conditional import digest
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import TEXT, URI, JsonSchema, json_array, json_object
from rosld.server.resources.base import SessionResource
from rosld.server.resources.memento import is_recorded
from rosld.server.resources.messages import decode
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.path_item import FORMAT, PathItem, QueryParameter
from rosld.server.rest.resource import RDF_SOURCE, RESOURCE, Resource
from rosld.server.rest.state import State
from rosld.server.robot.diagnostic_states import (
    DIAGNOSTIC_ARRAY,
    DiagnosticState,
    Level,
    LevelChange,
    changes_of,
    read_states,
    state_at,
    worst_first,
)
from rosld.server.runtime.tasks import call_every, combine_watches

_LOOK_SECONDS = 2.0
"""Seconds between checks for parts that stopped reporting."""
_PAST_NS = 3600 * 1_000_000_000
_MAX_MESSAGES = 4000
_MAX_CHANGES = 100
_MAX_NAME = 500
_NAME = QueryParameter("name", "The name of a part: only that part, with its recorded history.")
_STATE: JsonSchema = json_object(
    {"topic": URI, "name": TEXT, "level": {"type": "string", "enum": [level.name for level in Level]}, "message": TEXT},
    {"hardware": TEXT, "values": {"type": "object", "additionalProperties": TEXT}, "received": TEXT, "since": TEXT},
)
_CHANGE: JsonSchema = json_object({"time": TEXT, "level": TEXT, "message": TEXT})
_PLAIN: JsonSchema = json_object({"states": json_array(_STATE)}, {"changes": json_array(_CHANGE)})


class DiagnosticsResource(SessionResource):
    """The states of all reporting parts, or of those with one name, with the permissions of one agent."""

    kind = "Diagnostics"
    shape = "Source"
    title = "Diagnostics"
    path = "diagnostics"
    item = PathItem("What the parts of the robot report", plain=_PLAIN, query=(_NAME, FORMAT))
    links = (RESOURCE, RDF_SOURCE)

    name = ""
    part_states: Sequence[DiagnosticState] = ()
    _changes: Sequence[LevelChange] = ()

    async def select_variant(self, exchange: Exchange) -> Resource:
        """Return the requested part, as the agent may see it."""
        return self.select(exchange.query.get("name", "")[:_MAX_NAME], exchange.permissions)

    def select(self, name: str, permissions: Permissions) -> DiagnosticsResource:
        """Return the part of a name, or the whole without one, as an agent may see it."""
        url = f"{self.url}?name={quote(name, safe='')}" if name else self.url
        return self.variant(url=url, name=name, _permissions=permissions)

    def _topics(self, graph: Graph) -> Sequence[str]:
        """Return the topics of diagnostics that the agent may read."""
        permissions = self._permissions
        return sorted(
            name
            for name, topic in graph.topics.items()
            if any(ref.name == DIAGNOSTIC_ARRAY for ref in topic.types) and permissions.may_read(self.space.topic(name))
        )

    async def watch(self, wake: Callable[[], None]) -> Watch | None:
        """Return a watch of the topics that also checks periodically for parts that stopped reporting."""
        watches = [await self.session.topics.watch(topic, wake) for topic in self._topics(self.session.graph)]
        return combine_watches(*watches, call_every(_LOOK_SECONDS, wake))

    async def state(self) -> State:
        graph = self.session.graph
        found = [state for topic in self._topics(graph) for state in await self._read(topic)]
        self.part_states = worst_first(found)
        if self.name:
            self.part_states = [each for each in self.part_states if each.name == self.name]
            if not self.part_states:
                raise Problem(404, f"No part called {self.name[:80]!r} has reported diagnostics.")
            self._changes = await self._past(graph, self.part_states[0].topic)
        states = [_part(each, self.space.topic(each.topic)) for each in self.part_states]
        plain = _plain(states, self._changes)
        return State(partial(diagnostics_document, self.url, states, self.space.types), lambda: plain, digest(plain))

    async def _read(self, topic: str) -> Sequence[DiagnosticState]:
        view = await self.session.topics.read(topic)
        if view.newest is None:
            return ()
        decoded = await decode(self.session.schemas, view.newest)
        if decoded.message is None or decoded.schema is None or decoded.schema.ref.name != DIAGNOSTIC_ARRAY:
            return ()
        now = max(view.times.values(), default=0) if self.session.adapter.recordings else time.time_ns()
        period = 1.0 / view.rate if view.rate else 0.0
        states = read_states(topic, decoded.message, view.times, view.newest.received_ns)
        return [self.services.level_times.note(state_at(each, now, period), now) for each in states]

    async def _past(self, graph: Graph, topic: str) -> Sequence[LevelChange]:
        """Return the recorded states of a part in the last hour, if any."""
        if not is_recorded(self.services.history, topic):
            return ()
        try:
            schemas = {ref: await self.session.schemas.message(ref) for ref in graph.topics[topic].types}
            return await asyncio.to_thread(self._read_past, topic, schemas)
        except (OSError, ValueError, KeyError, RosError):
            return ()

    def _read_past(self, topic: str, schemas: Mapping[TypeRef, MessageSchema]) -> Sequence[LevelChange]:
        recording = self.services.history.recording
        wanted = MessageFilter(frozenset({topic}), time.time_ns() - _PAST_NS)
        past: list[tuple[int, DiagnosticState]] = []
        for message in recording.select(wanted, _MAX_MESSAGES).messages:
            sample, schema = message.sample, schemas.get(message.sample.schema)
            if schema is not None:
                found = read_states(topic, schema.codec.decode(sample.data, sample.encoding), {}, sample.received_ns)
                past += [(sample.received_ns, each) for each in found if each.name == self.name]
        return changes_of(past)[:_MAX_CHANGES]

    def page(self, site: Site, state: State, forms: Sequence[Form], csrf: Csrf, notices: Sequence[Notice]) -> bytes:
        topics = {each.topic for each in self.part_states}
        return render_diagnostics(
            DiagnosticsPage(
                site,
                self.url,
                self.name,
                tuple(self.part_states),
                tuple(self._changes),
                tuple(self.space.topic(each) for each in sorted(topics or self._topics(self.session.graph))),
                tuple(notices),
            )
        )


def _part(state: DiagnosticState, topic: str) -> PartState:
    fingerprint = (
        state.name,
        state.hardware,
        state.level.name,
        int(state.reported_level),
        state.message,
        dict(state.values),
    )
    return PartState(topic, *fingerprint, state.received_ns, state.since_ns)


def _plain(states: Sequence[PartState], changes: Sequence[LevelChange]) -> bytes:
    members: dict[str, object] = {
        "states": [
            {
                "topic": each.topic,
                "name": _text(each.name),
                "hardware": _text(each.hardware),
                "level": each.level,
                "message": _text(each.message),
                "values": {_text(key): _text(value) for key, value in each.values.items()},
                "received": date_time(0, each.received_ns),
                "since": date_time(0, each.since_ns),
            }
            for each in states
        ]
    }
    if changes:
        members["changes"] = [
            {"time": date_time(0, each.time_ns), "level": each.level.name, "message": _text(each.message)}
            for each in changes
        ]
    return orjson.dumps(members)


def _text(text: str) -> str:
    """Text without what UTF-8 cannot hold: strings of ROS 1 may be any bytes."""
    return text.encode("utf-8", "replace").decode()
