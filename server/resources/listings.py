"""The containers of what comes and goes as the robot is used: calls, goals, holds."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, replace

from pyoxigraph import Triple

from rosld.adapters.base import Watch
from rosld.adapters.model import GoalStatus
from rosld.ontology.describe_graph import container_document
from rosld.ontology.describe_holds import hold_outline
from rosld.ontology.describe_services import call_outline, goal_outline
from rosld.ontology.document import Document
from rosld.ontology.triples import date_time_literal
from rosld.ontology.urls import Space
from rosld.server.html.page import Cell, MemberColumns
from rosld.server.http.conditional import digest
from rosld.server.rest.path_item import PathItem
from rosld.server.rest.resource import BASIC_CONTAINER, RDF_SOURCE, RESOURCE, Resource
from rosld.server.rest.state import State
from rosld.server.robot.calls import Call, Calls, CallState
from rosld.server.robot.goal_store import Goal
from rosld.server.robot.goals import Goals
from rosld.server.robot.hold_store import Hold, Holds, InterruptedHold
from rosld.server.runtime.tasks import Signal
from rosld.server.runtime.version_cache import VersionCache

_OUTCOMES = {CallState.UNKNOWN: "outcome unknown", CallState.NOT_SENT: "not sent"}
"""Words for states of calls whose terms are no words."""
_FAILED_GOALS = frozenset({GoalStatus.ABORTED, GoalStatus.REJECTED, GoalStatus.LOST})


@dataclass(frozen=True, slots=True)
class ListedMember:
    """A member of a listing: its URL, label and cells, its RDF, and whether it failed."""

    url: str
    name: str
    cells: tuple[Cell, ...]
    outline: tuple[Triple, ...]
    is_failed: bool = False


class ListingResource(Resource):
    """`/NAME/`: a container of current members, the newest first; `changes` announces others."""

    shape = "Container"

    links = (RESOURCE, RDF_SOURCE, BASIC_CONTAINER)

    def __init__(
        self,
        space: Space,
        states: VersionCache[State],
        name: str,
        summary: str,
        columns: tuple[str, ...],
        members: Callable[[], Iterable[ListedMember]],
        changes: Signal,
    ) -> None:
        super().__init__(space, space.container(name))
        self.kind = name.capitalize()
        self.title = self.kind
        self._states = states
        self._columns = columns
        self._members = members
        self._changes = changes
        self.item = PathItem(summary)

    async def state(self) -> State:
        """Return the state, which changes with that of each member because the page shows it."""
        members = tuple(self._members())
        token = digest(repr(members).encode("utf-8", "replace"))
        return self._states.get_or_make(self.url, token, lambda: State(lambda: self._document(members), token=token))

    def outline(self) -> tuple[Hashable, Callable[[], Document]]:
        """Return the description, after a token that changes with it."""
        members = tuple(self._members())
        return members, lambda: self._document(members)

    def _document(self, members: Sequence[ListedMember]) -> Document:
        """Return the members, and in brief what became of each."""
        document = container_document(self.url, (member.url for member in members), self.kind)
        outlines = (triple for member in members for triple in member.outline)
        return replace(document, triples=(*document.triples, *outlines))

    def listing(self) -> MemberColumns:
        members = tuple(self._members())
        return MemberColumns(
            self._columns,
            {member.url: member.cells for member in members},
            names={member.url: member.name for member in members},
            failed=frozenset(member.url for member in members if member.is_failed),
        )

    async def watch(self, wake: Callable[[], None]) -> Watch:
        return self._changes.watch(wake)


def calls_listing(space: Space, calls: Calls, states: VersionCache[State]) -> ListingResource:
    """`/calls/`: the calls made through rosld and kept."""
    known = calls

    def listed(call: Call) -> ListedMember:
        outcome = _OUTCOMES.get(call.state, call.state.value.lower())
        cells = (outcome, time_cell(call.created_ns), time_cell(call.answered_ns), call.words or "")
        is_failed = call.state not in (CallState.RUNNING, CallState.SUCCEEDED)
        times = call.created_ns, call.answered_ns
        outline = call_outline(call.id, call.service, call.state.value, times, call.words, space)
        return ListedMember(space.call(call.id), call.service, cells, tuple(outline), is_failed)

    columns = ("outcome", "called", "answered", "words")
    return ListingResource(
        space,
        states,
        "calls",
        "The calls that are kept",
        columns,
        lambda: map(listed, reversed(known.all())),
        known.changes,
    )


def goals_listing(space: Space, goals: Goals, states: VersionCache[State]) -> ListingResource:
    """`/goals/`: the goals known and kept, ours and others'."""
    known = goals

    def listed(goal: Goal) -> ListedMember:
        cells = (goal.status.value, time_cell(goal.created_ns), time_cell(goal.ended_ns), goal.words or "")
        times = goal.created_ns, goal.ended_ns
        outline = tuple(goal_outline(goal.id, goal.action, goal.status, times, goal.words, space))
        return ListedMember(space.goal(goal.id), goal.action, cells, outline, goal.status in _FAILED_GOALS)

    columns = ("status", "sent", "ended", "words")
    return ListingResource(
        space,
        states,
        "goals",
        "The goals that are kept",
        columns,
        lambda: map(listed, reversed(known.all())),
        known.changes,
    )


def holds_listing(space: Space, states: VersionCache[State], holds: Holds) -> ListingResource:
    """`/holds/`: the holds that there are, and what became of those of a rosld that was killed."""
    known = holds

    def interrupted(hold: InterruptedHold) -> ListedMember:
        note, words = hold
        cells = (note.holder, f"{note.rate:g} Hz", time_cell(note.created_ns), words)
        outline = hold_outline(note.id, note.topic, note.holder, note.rate, note.created_ns, words, space)
        return ListedMember(space.hold(note.id), note.topic, cells, tuple(outline), is_failed=True)

    def listed(hold: Hold) -> ListedMember:
        cells = (hold.holder.name, f"{hold.rate:g} Hz", time_cell(hold.created_ns), hold.last_error or "")
        outline = hold_outline(
            hold.id, hold.topic, hold.holder.name, hold.rate, hold.created_ns, hold.last_error, space
        )
        return ListedMember(space.hold(hold.id), hold.topic, cells, tuple(outline), hold.last_error is not None)

    columns = ("holder", "rate", "since", "trouble")
    return ListingResource(
        space,
        states,
        "holds",
        "The holds of topics",
        columns,
        lambda: (*map(listed, reversed(known.all())), *map(interrupted, known.interrupted.values())),
        known.changes,
    )


def time_cell(nanoseconds: int | None) -> Cell:
    """Return a time in a table, nothing where there is none."""
    return date_time_literal(nanoseconds) or ""
