"""Containers of calls, goals, holds and receipts, and each receipt."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from itertools import islice

import orjson
from msgspec import Struct
from msgspec.structs import replace
from pyoxigraph import NamedNode, Triple

from rosld.adapters.base import Watch
from rosld.adapters.model import GoalStatus
from rosld.ontology.describe_activities import Receipt, activity_document
from rosld.ontology.describe_graph import container_document
from rosld.ontology.describe_holds import HOLD_OUTLINE, HoldOutline
from rosld.ontology.describe_services import CALL_OUTLINE, GOAL_OUTLINE, CallOutline, GoalOutline
from rosld.ontology.document import Document
from rosld.ontology.literals import date_time
from rosld.ontology.triples import date_time_literal
from rosld.ontology.urls import Space
from rosld.server.events import query_params
from rosld.server.html.page import Cell, MemberColumns
from rosld.server.http.conditional import digest
from rosld.server.http.fields import Link
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import ANYTHING
from rosld.server.receipts.journal import JournalEntry, NoSuchReceipt
from rosld.server.resources.base import Services, SessionResource
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import OFFERS
from rosld.server.rest.paging import (
    LdpPage,
    PagedContainer,
    PagePosition,
    last_page_size,
    last_position,
    page_of,
    parse_position,
    require_page,
)
from rosld.server.rest.path_item import PathItem
from rosld.server.rest.resource import BASIC_CONTAINER, RDF_SOURCE, RESOURCE, Resource
from rosld.server.rest.state import State
from rosld.server.robot.calls import Call, CallState
from rosld.server.robot.goal_store import Goal
from rosld.server.robot.hold_store import Hold, InterruptedHold
from rosld.server.runtime.tasks import Signal
from rosld.server.sparql.receipt_graphs import TITLE

_OUTCOMES = {CallState.UNKNOWN: "outcome unknown", CallState.NOT_SENT: "not sent"}
"""Readable names of call states whose terms are not words."""
_FAILED_GOALS = frozenset({GoalStatus.ABORTED, GoalStatus.REJECTED, GoalStatus.LOST})


class ListedMember(Struct, frozen=True):
    """A member of a listing: its URL, label and cells, its RDF, and whether it failed."""

    url: str
    name: str
    cells: tuple[Cell, ...]
    outline: tuple[Triple, ...]
    is_failed: bool = False


class ListingResource(SessionResource):
    """`/NAME/`: a container of current members, newest first; `changes` announces changes of members."""

    shape = "Container"
    links: tuple[Link, ...] = (RESOURCE, RDF_SOURCE, BASIC_CONTAINER)
    links_offer = True

    def __init__(
        self,
        services: Services,
        name: str,
        summary: str,
        columns: tuple[str, ...],
        members: Callable[[], Iterable[ListedMember]],
        changes: Signal,
    ) -> None:
        super().__init__(services, services.space.container(name))
        self.kind = self.title = name.capitalize()
        self._columns = columns
        self.members = members
        self._changes = changes
        self.item = PathItem(summary)

    async def state(self) -> State:
        """Return the state, which changes with that of each member because the page shows it."""
        members = tuple(self.members())
        token = digest(repr(members).encode("utf-8", "replace"))
        return self.states.get_or_make(self.url, token, lambda: State(lambda: self._document(members), token=token))

    def outline(self) -> tuple[Hashable, Callable[[], Document]]:
        """Return a token that changes with the description, and a function for the description."""
        members = tuple(self.members())
        return members, lambda: self._document(members)

    def _document(self, members: Sequence[ListedMember]) -> Document:
        """Return the members with the outcome of each."""
        document = container_document(self.url, (member.url for member in members), self.kind)
        outlines = (triple for member in members for triple in member.outline)
        return replace(document, triples=(*document.triples, *outlines))

    def listing(self) -> MemberColumns:
        members = tuple(self.members())
        return MemberColumns(
            self._columns,
            {member.url: member.cells for member in members},
            names={member.url: member.name for member in members},
            failed=frozenset(member.url for member in members if member.is_failed),
        )

    async def watch(self, wake: Callable[[], None]) -> Watch:
        return self._changes.watch(wake)


def calls_listing(services: Services) -> ListingResource:
    """`/calls/`: the retained calls made through rosld."""
    space, calls = services.space, services.session.calls

    def listed(call: Call) -> ListedMember:
        outcome = _OUTCOMES.get(call.state, call.state.value.lower())
        cells = (outcome, time_cell(call.created_ns), time_cell(call.answered_ns), call.words or "")
        is_failed = call.state not in (CallState.RUNNING, CallState.SUCCEEDED)
        url = space.call(call.id)
        view = CallOutline(call.id, call.service, call.state.value, call.created_ns, call.answered_ns, call.words)
        outline = CALL_OUTLINE.triples(NamedNode(url), view, space)
        return ListedMember(url, call.service, cells, tuple(outline), is_failed)

    columns = ("outcome", "called", "answered", "words")
    return ListingResource(
        services, "calls", "The stored calls", columns, lambda: map(listed, reversed(calls.all())), calls.changes
    )


def goals_listing(services: Services) -> ListingResource:
    """`/goals/`: the known goals of rosld and of other clients."""
    space, goals = services.space, services.session.goals

    def listed(goal: Goal) -> ListedMember:
        cells = (goal.status.value, time_cell(goal.created_ns), time_cell(goal.ended_ns), goal.words or "")
        url = space.goal(goal.id)
        view = GoalOutline(goal.id, goal.action, goal.status, goal.created_ns, goal.ended_ns, goal.words)
        outline = GOAL_OUTLINE.triples(NamedNode(url), view, space)
        return ListedMember(url, goal.action, cells, tuple(outline), goal.status in _FAILED_GOALS)

    columns = ("status", "sent", "ended", "words")
    return ListingResource(
        services, "goals", "The stored goals", columns, lambda: map(listed, reversed(goals.all())), goals.changes
    )


def holds_listing(services: Services) -> ListingResource:
    """`/holds/`: the current holds, and the outcome of holds of a rosld process that was killed."""
    space, holds = services.space, services.holds

    def member(view: HoldOutline, cells: tuple[Cell, ...]) -> ListedMember:
        url = space.hold(view.id)
        outline = HOLD_OUTLINE.triples(NamedNode(url), view, space)
        return ListedMember(url, view.topic, cells, tuple(outline), view.last_error is not None)

    def interrupted(hold: InterruptedHold) -> ListedMember:
        note, words = hold
        cells = (note.holder, f"{note.rate:g} Hz", time_cell(note.created_ns), words)
        view = HoldOutline(note.id, note.topic, note.holder, note.rate, note.created_ns, words)
        return member(view, cells)

    def listed(hold: Hold) -> ListedMember:
        cells = (hold.holder.name, f"{hold.rate:g} Hz", time_cell(hold.created_ns), hold.last_error or "")
        view = HoldOutline(hold.id, hold.topic, hold.holder.name, hold.rate, hold.created_ns, hold.last_error)
        return member(view, cells)

    columns = ("holder", "rate", "since", "trouble")

    def members() -> Iterable[ListedMember]:
        return (*map(listed, reversed(holds.all())), *map(interrupted, holds.interrupted.values()))

    return ListingResource(services, "holds", "The holds of topics", columns, members, holds.changes)


def time_cell(nanoseconds: int | None) -> Cell:
    """Return a time for a table, empty for None."""
    return date_time_literal(nanoseconds) or ""


_NEWEST = 10**15
"""Minuend for page keys, which ascend: the key of a receipt is this minus its number, so the newest comes first."""


class ActivityResource(SessionResource):
    """The receipt of one write. It never changes."""

    kind = "Activity"
    is_found_by_state = True
    shape = "Write"
    item = PathItem("The receipt of a write", plain=ANYTHING)

    def __init__(self, services: Services, id: str) -> None:
        super().__init__(services, services.space.activity(id))
        self.id = self.title = id

    async def state(self) -> State:
        try:
            entry = self.services.receipts.find(self.id)
        except NoSuchReceipt as error:
            limit = self.session.settings.receipts_kept
            sentence = f"There is no receipt {self.id}: it never existed, or is older than the {limit} stored ones."
            raise Problem(404, sentence) from error
        return self.states.get_or_make(self.url, entry.number, lambda: _receipt_state(self.space, entry))

    async def watch(self, wake: Callable[[], None]) -> Watch:
        return self.services.receipts.changes.watch(wake)


class ActivityContainer(PagedContainer, SessionResource):
    """`/activity/`: the stored receipts; paged if there are many."""

    kind = "Activity"
    shape = "Container"
    title = TITLE
    item = PathItem("The receipts of writes, the newest first", plain=ANYTHING, is_paged=True)
    path = "activity/"

    async def select_variant(self, exchange: Exchange) -> Resource:
        """Return the page `?page=`, or the newest receipt for a stream; redirect to the first of many pages (303)."""
        if exchange.method not in ("GET", "HEAD"):
            return self
        if query_params.stream_is_preferred(exchange.accept, OFFERS):
            return NewestReceipt(self.services).variant(_permissions=exchange.permissions)
        token = exchange.query.get("page")
        if token is not None:
            return self.variant(_place=parse_position(token))
        require_page(exchange, self.url, len(self.services.receipts))
        return self

    async def state(self) -> State:
        version = self.services.receipts.version
        if self._place is None:
            entries = list(self.services.receipts.newest_first())
            return self.states.get_or_make(self.url, version, lambda: State(lambda: self._document(entries)))
        page, entries = self._page(self._place)

        return self.states.get_or_make(
            page.url,
            version,
            lambda: State(
                lambda: page.add_to(self._document(entries)), part=page.part, headers=page.headers(self.links)
            ),
        )

    def _document(self, entries: list[JournalEntry]) -> Document:
        return container_document(self.url, (self.space.activity(entry.id) for entry in entries), TITLE)

    def _page(self, place: PagePosition) -> tuple[LdpPage, list[JournalEntry]]:
        """Return a page and its receipts."""
        entries = list(self.services.receipts.newest_first())
        keys = [_NEWEST - entry.number for entry in entries]
        after = place.after if isinstance(place.after, int) else 0
        start = next((at for at, key in enumerate(keys) if key > after), len(keys))
        limit = place.limit
        last = last_position(limit, len(keys), keys[: -last_page_size(len(keys), limit) - 2 : -1])
        before = keys[max(0, start - limit - 1) : start][::-1]
        page = page_of(self.url, place, keys[start : start + limit + 1], before, last)
        return page, entries[start : start + limit]

    def ldp_page(self, place: PagePosition) -> LdpPage:
        return self._page(place)[0]

    def listing(self) -> MemberColumns:
        """Return the columns: action, time, agent and outcome."""
        space = self.space
        receipts = self.services.receipts
        entries = islice(receipts.newest_first(), 1000) if self._place is None else self._page(self._place)[1]
        by_url = {space.activity(entry.id): entry.receipt for entry in entries}
        return MemberColumns(
            ("when", "who", "answer", "words"),
            {url: _cells(receipt) for url, receipt in by_url.items()},
            len(receipts),
            {url: f"{receipt.method} {receipt.url.removeprefix(space.base[:-1])}" for url, receipt in by_url.items()},
            frozenset(url for url, receipt in by_url.items() if receipt.status >= 400),
        )

    async def watch(self, wake: Callable[[], None]) -> Watch:
        return self.services.receipts.changes.watch(wake)


class NewestReceipt(SessionResource):
    """`/activity/` as a stream: each new write whose receipt the agent may read.

    Writes that occur faster than the client reads are omitted.
    """

    kind = "Activity"
    shape = "Write"
    links: tuple[Link, ...] = (RESOURCE, RDF_SOURCE, BASIC_CONTAINER)
    path = "activity/"

    async def state(self) -> State:
        entries, may_read = self.services.receipts.newest_first(), self._permissions.may_read
        entry = next((each for each in entries if may_read(self.space.activity(each.id))), None)
        if entry is None:
            return State(lambda: container_document(self.url, (), TITLE), lambda: b"null", "nothing")
        return _receipt_state(self.space, entry)

    async def watch(self, wake: Callable[[], None]) -> Watch:
        return self.services.receipts.changes.watch(wake)


def _receipt_state(space: Space, entry: JournalEntry) -> State:
    receipt = entry.receipt
    return State(lambda: activity_document(receipt, space), lambda: _json(receipt), receipt.id)


def _json(receipt: Receipt) -> bytes:
    """Return a receipt as plain JSON without missing values."""
    members = receipt._asdict()
    times = {"started": date_time(0, receipt.started_ns), "ended": date_time(0, receipt.ended_ns)}
    kept = {
        name: value
        for name, value in members.items()
        if name not in ("number", "started_ns", "ended_ns") and value not in (None, (), "", False)
    }
    return orjson.dumps({**kept, **times, "seconds": receipt.seconds})


def _cells(receipt: Receipt) -> tuple[Cell, ...]:
    return (time_cell(receipt.ended_ns), receipt.agent, str(receipt.status), receipt.words or "")
