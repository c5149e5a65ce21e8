"""Queries, updates, stops and permissions over all robots of a server."""

from __future__ import annotations

import asyncio
import logging
import re
import time
from collections import Counter
from collections.abc import AsyncIterator, Hashable, Iterable, Mapping, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from copy import copy
from typing import TYPE_CHECKING, Any

from starlette.responses import Response

from rosld.ontology.serialize import serialize
from rosld.ontology.syntax import Syntax
from rosld.server.auth.permissions import ALLOW_ALL, Permissions
from rosld.server.auth.rules import Agent
from rosld.server.http.problem import READ_ONLY, Problem
from rosld.server.receipts.audit import new_identifier
from rosld.server.resources.listings import ListingResource
from rosld.server.resources.past_messages import NoRecordings
from rosld.server.robot.interlock import StopState
from rosld.server.robot.software_stop import SoftwareStop, StepStatus, StopStep
from rosld.server.runtime.dry_run import end_dry_run, is_dry_run
from rosld.server.runtime.tasks import loop_time
from rosld.server.sparql.intervals import Interval
from rosld.server.sparql.materializer import GraphEntry, GraphSource, Materializer
from rosld.server.sparql.needs import Needs
from rosld.server.sparql.past import MAX_TEXT, PastDataset, PastQuery, PastSelection, PastSource, PastText
from rosld.server.sparql.process.client import QueryProcess
from rosld.server.sparql.protocol import UpdateRequest
from rosld.server.sparql.query_limits import MAX_PAST, Limits, too_much_past
from rosld.server.sparql.stored_sync import ChangeSource
from rosld.server.sparql.summaries import SummaryQuery
from rosld.server.sparql.update.base import UpdateRunner
from rosld.server.sparql.update.operations import Operation

if TYPE_CHECKING:
    from rosld.server.robots.robots import Robot, Robots

_NAMES = re.compile(r"[</]robots/([^/\s<>]+)/")
"""Names of robots in absolute and relative IRIs."""
_log = logging.getLogger("rosld")


class RobotsPermissions(Permissions):
    """Permissions at the base of a server of several robots: each judges the URLs below its own base."""

    def __init__(self, robots: Robots, agent: Agent, *others: Any) -> None:
        super().__init__(agent, *others)
        self._robots = robots

    def __reduce__(self) -> tuple[object, ...]:
        raise TypeError("only the server knows its robots")

    def within(self, url: str) -> Permissions:
        robot = self._robots.at_url(url)
        authenticator = None if robot is None or robot.app is None else robot.app.parts.authenticator
        return self if authenticator is None else authenticator.permissions(self.agent)

    def may(self, method: str, url: str) -> bool:
        own = self.within(url)
        return super().may(method, url) if own is self else own.may(method, url)


class BaseGraphs(GraphSource):
    """Source of the graph of `/robots/`, the only live one at the base."""

    def __init__(self, robots: Robots) -> None:
        self._robots = robots

    @property
    def revision(self) -> Hashable:
        """Revision of the graph."""
        return self._listing().outline()[0]

    def _listing(self) -> ListingResource:
        found = self._robots.base.parts.router.at("/robots/")
        assert isinstance(found, ListingResource)
        return found

    def descriptions(self) -> Mapping[str, GraphEntry]:
        """Return the graph."""
        listing = self._listing()
        version, describe = listing.outline()
        return {listing.url: GraphEntry(listing.url, version, lambda: serialize(describe(), Syntax.N_TRIPLES).decode())}


class RobotsMaterializer(Materializer):
    """Synchronisation of the union of all robots' datasets, and of the documents at the base."""

    def __init__(self, robots: Robots, target: QueryProcess, source: GraphSource, *sources: ChangeSource) -> None:
        super().__init__(target, BaseGraphs(robots), *sources)
        self._robots = robots

    @asynccontextmanager
    async def materialize(
        self,
        needs: Needs,
        permissions: Permissions = ALLOW_ALL,
        *,
        deadline: float,
        scope: frozenset[str] | None = None,
    ) -> AsyncIterator[Mapping[str, str]]:
        """Within the context the union holds what the needs require of each connected robot that the agent may know."""
        limits = Limits(max(0.1, deadline - loop_time()))
        until = time.monotonic() + limits.seconds
        running = [each for each in self._robots if each.app is not None and each.is_known_to(permissions)]
        async with AsyncExitStack() as stack:

            async def enter(materializer: Materializer, robot: Robot | None = None) -> Mapping[str, str]:
                manager = Materializer.materialize(materializer, needs, permissions, deadline=deadline, scope=scope)
                unread = await stack.enter_async_context(manager)
                if robot is not None:
                    await robot.union.catch_up(limits, until)
                return unread

            entering = [enter(self), *(enter(each.app.parts.sparql.materializer, each) for each in running if each.app)]
            found = await asyncio.gather(*entering, return_exceptions=True)
            unread: dict[str, str] = {}
            for robot, each in zip((None, *running), found, strict=True):
                if not isinstance(each, BaseException):
                    unread |= each
                elif robot is None or robot.app is not None:  # a robot that has gone takes nothing else with it
                    raise each
            yield unread


class RobotsPast:
    """Recorded messages of all connected robots for queries at the base."""

    def __init__(self, robots: Robots) -> None:
        self._robots = robots

    async def read(
        self, query: PastQuery, dataset: PastDataset, now: Interval, until: float, most: int | None = None
    ) -> PastText:
        """Return the messages that a query selects; all if they are of several robots, which have other newest ones."""
        asked = self._asked(query, query.selections(now), dataset.permissions)
        if len(asked) == 1:
            return await asked[0][0].read(asked[0][1], dataset, now, until, most)
        found, missing = list[PastText](), NoRecordings(400, "There are no recordings of a connected robot to query.")
        for past, own in asked:
            try:
                found.append(await past.read(own, dataset, now, until))
            except NoRecordings as error:
                missing = error
            messages = sum(sum(each.counts.values()) for each in found)
            if messages > MAX_PAST or sum(len(each.text) + len(each.stored) for each in found) > MAX_TEXT:
                raise too_much_past(f"More than {messages} recorded messages of several robots may match this query.")
        if not found:
            raise missing
        counts = sum((Counter(each.counts) for each in found), Counter[str]())
        times = [times for each in found for times in each.times]
        plain, stored = b"".join(each.text for each in found), b"".join(each.stored for each in found)
        return PastText(plain, stored, times=times, counts=counts)

    async def summarize(
        self, query: PastQuery, summary: SummaryQuery, dataset: PastDataset, until: float
    ) -> PastText | None:
        """Return the summaries of the messages of one robot; None for several, whose messages must be read."""
        asked = self._asked(query, query.selections(summary.time), dataset.permissions)
        return await asked[0][0].summarize(asked[0][1], summary, dataset, until) if len(asked) == 1 else None

    def _asked(
        self, query: PastQuery, selections: Sequence[PastSelection], permissions: Permissions
    ) -> Sequence[tuple[PastSource, PastQuery]]:
        """Return the robots that can have messages, each with the query for it. Raises Problem 400."""
        robots = [each for each in self._robots if each.app is not None and each.is_known_to(permissions)]
        owner_of, found = self._robots.at_url, list[tuple[PastSource, PastQuery]]()
        if unknown := sorted(url for url in query.recordings if owner_of(url) not in robots):
            raise Problem(400, f"There is no recording <{unknown[0]}> that can be read.")
        for robot in robots:
            past, own = None if robot.app is None else robot.app.parts.sparql.queries.past, copy(query)
            own.recordings = frozenset(url for url in query.recordings if owner_of(url) is robot)
            has_topics = any(each.urls is None or robot in map(owner_of, each.urls) for each in selections)
            if past is not None and has_topics and (own.recordings or query.asks_all or not query.recordings):
                found.append((past, own))
        return found


class RobotsUpdates:
    """Updates at the base: each reaches the one robot that it names, or else the documents at the base."""

    def __init__(self, robots: Robots, own: UpdateRunner) -> None:
        self._robots = robots
        self._own = own

    async def answer(self, request: UpdateRequest, *, permissions: Permissions = ALLOW_ALL) -> Response:
        """Carry out an update. Raises Problems: 400 for an update that names several robots."""
        texts = (request.text, *request.using_graphs, *request.using_named_graphs)
        named = {name for text in texts for name in _NAMES.findall(text)}
        robots = [each for each in self._robots if each.name in named and each.is_known_to(permissions)]
        if len(robots) > 1:
            names = ", ".join(each.name for each in robots)
            raise Problem(400, f"An update reaches one robot, but this one names {names}: send one for each.")
        if not robots:
            return await self._own.answer(request, permissions=permissions)
        app = robots[0].require()
        if app.parts.router.updates is None:
            raise Problem(403, READ_ONLY)
        authenticator = app.parts.authenticator
        own = permissions if authenticator is None else authenticator.permissions(permissions.agent)
        text = f"BASE <{self._robots.session.space.base}> {request.text}"
        absolute = UpdateRequest(text, request.using_graphs, request.using_named_graphs)
        return await app.parts.router.updates.answer(absolute, permissions=own)

    async def carry_out(self, operations: Sequence[Operation], *, permissions: Permissions = ALLOW_ALL) -> Response:
        """Carry out operations on documents at the base."""
        return await self._own.carry_out(operations, permissions=permissions)

    def is_stored(self, graph: str) -> bool:
        """Whether the graph of this name is, or may be, stored at the base."""
        return self._own.is_stored(graph)


class StopOfAll(SoftwareStop):
    """The stop of all robots: each of its steps is the stop of one. Each robot is released at its own stop."""

    def __init__(self, robots: Robots) -> None:
        self._robots = robots
        self.revision = 0
        self.changes = robots.changes

    @property
    def unusable_reason(self) -> str | None:
        if self._robots.settings.read_only:
            return "This server is read-only: it sends no commands to the robots, not even to stop."
        return None if self._movable() else "Nothing moves here: there is no robot."

    @property
    def is_running(self) -> bool:
        return any(each.is_running for each in self._stops())

    @property
    def stop_state(self) -> StopState | None:
        """The newest stop, if every robot is stopped; who and why only if that is the same for all."""
        states = [each.stop_state if stop is None else stop.stop_state for each, stop in self._movable()]
        known = [each for each in states if each is not None]
        if not states or len(known) < len(states):
            return None
        newest = max(known, key=lambda each: each.since_ns)
        is_same = len({(each.stopped_by, each.reason) for each in known}) == 1
        by, reason = (newest.stopped_by, newest.reason) if is_same else ("several agents", None)
        return StopState(by, newest.since_ns, reason, self._robots.session.space.stop, newest.id)

    @property
    def steps(self) -> tuple[StopStep, ...]:
        return tuple(_step(robot, stop) for robot, stop in self._movable())

    @property
    def warning(self) -> str | None:
        failed = any(_step(robot, stop).status is StepStatus.FAILED for robot, stop in self._movable())
        return "Some robots may still be moving: see the steps, and the robots' own stops." if failed else None

    def start(self) -> None:
        """Do nothing: each robot prepares its own stop."""

    async def wait_ended(self) -> None:
        """Do nothing: each robot waits for its own steps."""

    async def stop(self, by: Agent, reason: str | None) -> None:
        """Stop all robots at once; one that is not connected is stopped as soon as it is."""
        if is_dry_run():
            for each in self._stops():
                each.record_steps()
        end_dry_run(200)
        for robot, stop in self._movable():
            if stop is None:
                robot.stop_state = StopState(by.name, time.time_ns(), reason, id=new_identifier())
        found = await asyncio.gather(*(each.stop(by, reason) for each in self._stops()), return_exceptions=True)
        for error in found:
            if isinstance(error, BaseException):
                _log.error("a robot could not be stopped", exc_info=error)
        self._robots.changes.emit()

    def _movable(self) -> list[tuple[Robot, SoftwareStop | None]]:
        """Return the robots that a stop is for, with their own stops; None while they are not connected."""
        found = ((each, None if each.app is None else each.app.parts.services.software_stop) for each in self._robots)
        return [(robot, stop) for robot, stop in found if stop is None or stop.is_usable]

    def _stops(self) -> Iterable[SoftwareStop]:
        return [stop for _, stop in self._movable() if stop is not None]


def _step(robot: Robot, stop: SoftwareStop | None) -> StopStep:
    does, urls = f"stop {robot.name}", (f"{robot.url}stop",)
    if stop is None:
        status = StepStatus.PLANNED if robot.stop_state is None else StepStatus.FAILED
        return StopStep(does, urls, status, "it is not connected, and is stopped as soon as it is")
    if stop.stop_state is None:
        return StopStep(does, urls, StepStatus.PLANNED)
    failed = StepStatus.DONE if stop.warning is None else StepStatus.FAILED
    return StopStep(does, urls, StepStatus.RUNNING if stop.is_running else failed, stop.warning)
