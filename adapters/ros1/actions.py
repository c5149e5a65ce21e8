"""ROS 1 actions: goals are sent and followed with the five topics of actionlib, without its client.

Our own goals are followed until they have ended and their result was received, those of others while there are
followers. Following registers nothing: only senders and cancelers publish, and are therefore visible to the master.
"""

from __future__ import annotations

import asyncio
import dataclasses
import itertools
import time
from collections import OrderedDict
from collections.abc import Callable, Collection
from functools import partial

from msgspec import Struct, field
from msgspec.structs import replace

from rosld.adapters.base import Sink
from rosld.adapters.model import (
    ActionSchema,
    GoalEvent,
    GoalId,
    GoalStatus,
    NotFound,
    Refused,
    Sent,
    TimedOut,
    TypeRef,
    UnknownType,
    Unreachable,
)
from rosld.adapters.model.library import SEPARATOR
from rosld.adapters.ros1.graph import (
    Status,
    SystemState,
    actions_of,
    cancel_message,
    goal_message,
    read_feedback_or_result,
    read_goal,
    read_statuses,
)
from rosld.adapters.ros1.publication import Publication, SubscriberConnection
from rosld.adapters.ros1.publications import Publications
from rosld.adapters.ros1.sources import Nodes, TopicReader
from rosld.adapters.ros1.subscription import MessageFeed
from rosld.adapters.ros1.types import Types
from rosld.adapters.thread import wait_event

_DEPTH = 256
_TICK = 0.25
_LOST_AFTER = 2.0
"""Seconds after which a goal is lost if its server is disconnected or no longer lists it."""
_RESULT = 5.0
"""Maximum seconds between the status and the result of a goal."""
_RESULT_SOON = 0.5
"""Seconds that the end of a goal is delayed for its result, which is read as soon as the end is reported."""
_DECISION = 0.3
"""Seconds for a server that has just accepted a goal to reject it."""
_CANCELLATIONS, _CANCELLATION_PAUSE = 4, 0.5
"""Number of times that an ignored cancellation is sent, and the seconds between."""
_UNHEEDED = (GoalStatus.ACCEPTED, GoalStatus.EXECUTING)
_MAX_GOALS = 1000
_CANCEL = TypeRef("actionlib_msgs/msg/GoalID")
_PARTS = ("status", "result", "feedback", "goal")


class _SentGoal(Struct, frozen=True):
    """A goal's message, its publication, and the connections to servers that it was sent on."""

    message: bytes
    publication: Publication
    links: frozenset[SubscriberConnection]


class _Goal(Struct):
    """A known goal with its latest status. `listed_at` is when its server last listed it."""

    listed_at: float
    latest: Status | None = None
    ended_at: float | None = None
    has_result: bool = False
    goal: bytes | None = None
    decided: asyncio.Future[Status] | None = None
    is_own: bool = False
    is_refused: bool = False
    sending: _SentGoal | None = None
    pending: list[GoalEvent] = field(default_factory=list)
    ending: GoalEvent | None = None
    """The pending event of its end, while the result is awaited: they use two connections and arrive in any order."""

    @property
    def is_undecided(self) -> bool:
        """Whether its sender still waits for its acceptance."""
        return self.decided is not None and not self.decided.done()

    @property
    def is_final(self) -> bool:
        """Whether the last status is final."""
        return self.ended_at is not None


class _FollowedAction(Struct):
    """A followed action, with its readers and number of followers."""

    readers: dict[str, TopicReader] = field(default_factory=dict)
    followers: int = 0
    status_event: asyncio.Event = field(default_factory=asyncio.Event)
    connected_at: float = 0.0
    statuses_at: float = 0.0

    @property
    def is_ready(self) -> bool:
        """Whether events of the server can be received now."""
        return all(self.readers[part].is_connected for part in ("status", "result", "feedback"))


class Actions:
    """Actions of a ROS system, and the followed goals. All methods run on the reading thread."""

    def __init__(
        self,
        caller: str,
        nodes: Nodes,
        types: Types,
        publications: Publications,
        system: Callable[[], SystemState],
        sink: Sink,
    ) -> None:
        self._caller = caller
        self._nodes = nodes
        self._types = types
        self._publications = publications
        self._system = system
        self._sink = sink
        self._followed: dict[str, _FollowedAction] = {}
        self._by_action: dict[str, OrderedDict[str, _Goal]] = {}
        self._numbers = itertools.count(1)
        self._ticking: asyncio.TimerHandle | None = None

    def update(self, system: SystemState) -> None:
        """Update the publishers of the followed actions."""
        for action, followed in self._followed.items():
            for part, reader in followed.readers.items():
                reader.follow(system.publishers.get(f"{action}/{part}", ()))

    def close(self) -> None:
        """Stop following all actions."""
        for action in list(self._followed):
            self._stop(action)

    async def follow(self, action: str, until: float) -> Callable[[], None]:
        """Report all goals of an action until the returned function is called; wait for its server. Raises NotFound."""
        self._require(action)
        followed = self._begin(action)
        followed.followers += 1
        await wait_event(followed.status_event, until - asyncio.get_running_loop().time())
        return partial(self._unfollow, action)

    def _unfollow(self, action: str) -> None:
        if (followed := self._followed.get(action)) is not None:
            followed.followers -= 1
            self._stop_if_idle(action)

    async def send(self, action: str, type: TypeRef, goal: bytes, until: float) -> GoalId:
        """Send a goal and wait until its server has accepted it. Raises what `Adapter.send_goal` raises."""
        schema = await self._schema(action, type)
        now = asyncio.get_running_loop().time
        stamp = time.time_ns()
        id = f"{self._caller}-{next(self._numbers)}-{stamp // 1_000_000_000}.{stamp % 1_000_000_000:09d}"
        entry = _Goal(now(), goal=goal, decided=asyncio.get_running_loop().create_future(), is_own=True)
        # Before sending, so that early events of the goal are held until it is accepted or rejected.
        self._goals(action)[id] = entry
        followed = self._begin(action)
        try:
            publication = await self._publication(action, schema, followed, until)
            message = goal_message(id, stamp, goal)
            entry.sending = _SentGoal(message, publication, publication.links_to(self._servers(action)))
            publication.send(message, False)
        except BaseException:
            del self._goals(action)[id]
            self._stop_if_idle(action)
            raise
        entry.listed_at = now()
        assert entry.decided is not None
        try:
            status = await asyncio.wait_for(asyncio.shield(entry.decided), max(until - now(), 0.0))
        except asyncio.TimeoutError as error:
            entry.decided = None
            self._flush(action, id, entry)
            raise TimedOut(f"{action} has neither accepted nor rejected the goal", sent=Sent.YES) from error
        if status.status is GoalStatus.REJECTED:
            words = status.words or None
            raise Refused(f"{action} rejected the goal", words=words, sent=Sent.YES)
        self._flush(action, id, entry)
        return GoalId(action, id)

    async def cancel(self, goal: GoalId, until: float) -> None:
        """Request the cancellation of a goal, repeatedly if it is ignored. Raises NotFound, Unreachable."""
        self._require(goal.action)
        if not goal.id:  # actionlib cancels all goals for an empty id
            raise NotFound(f"{goal.action} has no goal without an id")
        self._request_cancellation(goal, await self._cancellation(goal.action, until), _CANCELLATIONS)

    async def cancel_all(self, action: str, until: float) -> None:
        """Request the cancellation of all goals of an action, with an empty id. Raises NotFound, Unreachable."""
        self._require(action)
        publication = await self._cancellation(action, until)
        for seconds in (0.0, _CANCELLATION_PAUSE):  # repeated once, as for one goal; more would cancel later goals
            asyncio.get_running_loop().call_later(seconds, publication.send, cancel_message(""), False)

    async def _cancellation(self, action: str, until: float) -> Publication:
        """Return the publication of an action's cancellations, with its server connected. Raises Unreachable."""
        publication = await self._publications.advertise(f"{action}/cancel", _CANCEL, until)
        if not await publication.connected_to(self._servers(action), until):
            raise Unreachable(f"no goal was canceled: no server of {action} is connected")
        return publication

    def _request_cancellation(self, goal: GoalId, publication: Publication, times: int) -> None:
        """Send a cancellation repeatedly: a server that reconnects to its publishers loses messages."""
        if times and publication.matched:
            publication.send(cancel_message(goal.id), False)
            asyncio.get_running_loop().call_later(
                _CANCELLATION_PAUSE, self._repeat_cancellation, goal, publication, times - 1
            )

    def _repeat_cancellation(self, goal: GoalId, publication: Publication, times: int) -> None:
        entry = self._goals(goal.action).get(goal.id) if goal.action in self._followed else None
        if entry is not None and entry.latest is not None and entry.latest.status in _UNHEEDED:
            self._request_cancellation(goal, publication, times)

    # Sending

    def _require(self, action: str) -> TypeRef:
        system = self._system()
        found = actions_of(system.publishers, system.subscribers, system.topic_types).get(action)
        if found is None or found.type is None:
            raise NotFound(f"there is no action {action}")
        if not found.servers:
            raise Unreachable(f"{action} has no server: {found.unusable}")
        return found.type

    def _servers(self, action: str) -> Collection[str]:
        """Return the nodes that receive an action's goals: its servers, or the nodes that relay the goals."""
        system = self._system()
        takers = system.subscribers.get(f"{action}/goal", ())
        return set(takers).intersection(system.publishers.get(f"{action}/status", ())) or takers

    async def _schema(self, action: str, type: TypeRef) -> ActionSchema:
        used = self._require(action)
        if used.name != type.name:
            raise Refused(f"the action {action} is a {used.name}, not this {type.name}")
        schema = await self._types.schema(type)
        if not isinstance(schema, ActionSchema):
            raise UnknownType(f"{type.name} is not an action type")
        return schema

    async def _publication(
        self, action: str, schema: ActionSchema, followed: _FollowedAction, until: float
    ) -> Publication:
        """Return the publication of goals, with its server connected both ways, so that no message is missed."""
        learn = self._types.library.learn_message
        name, definition = goal_definition(schema)
        message = await asyncio.get_running_loop().run_in_executor(None, learn, name, definition)
        publication = await self._publications.advertise(f"{action}/goal", message.ref, until)
        if not await publication.connected_to(self._servers(action), until):
            raise Unreachable(f"no goal was sent: the server of {action} did not connect in time")
        now = asyncio.get_running_loop().time
        while not followed.is_ready and now() < until:  # noqa: ASYNC110 - connections have no events
            await asyncio.sleep(0.02)
        if not followed.is_ready:
            raise Unreachable(f"no goal was sent: the server of {action} cannot be read from")
        return publication

    # Following

    def _goals(self, action: str) -> OrderedDict[str, _Goal]:
        return self._by_action.setdefault(action, OrderedDict())

    def _begin(self, action: str) -> _FollowedAction:
        followed = self._followed.get(action)
        if followed is None:
            followed = self._followed[action] = _FollowedAction(connected_at=asyncio.get_running_loop().time())
            for entry in self._goals(action).values():
                entry.listed_at = followed.connected_at
            takes = (self._take_statuses, self._take_result, self._take_feedback, self._take_goal)
            for part, take in zip(_PARTS, takes, strict=True):
                feed = MessageFeed(f"{action}/{part}", partial(take, action), _DEPTH)
                followed.readers[part] = TopicReader(feed, self._nodes, self._types, 0)
            self.update(self._system())
        if self._ticking is None:
            self._ticking = asyncio.get_running_loop().call_later(_TICK, self._tick)
        return followed

    def _stop_if_idle(self, action: str) -> None:
        followed = self._followed.get(action)
        if followed is None or followed.followers > 0:
            return
        if not any(entry.is_own and not _is_over(entry) for entry in self._goals(action).values()):
            self._stop(action)

    def _stop(self, action: str) -> None:
        for reader in self._followed.pop(action).readers.values():
            reader.close()

    def _take_statuses(self, action: str, data: bytes) -> None:
        now = asyncio.get_running_loop().time()
        for status in read_statuses(data):
            self._note(action, status, now, waits_for_result=True)
        if (followed := self._followed.get(action)) is not None:
            followed.statuses_at = now
            followed.status_event.set()

    def _take_result(self, action: str, data: bytes) -> None:
        status, result = read_feedback_or_result(data)
        entry = self._note(action, status, asyncio.get_running_loop().time())
        if entry is not None:
            entry.has_result = True
            ending, entry.ending = entry.ending, None
            event = (
                GoalEvent(time.time_ns(), result=result)
                if ending is None
                else dataclasses.replace(ending, result=result)
            )
            self._report(action, status.id, entry, event)

    def _take_feedback(self, action: str, data: bytes) -> None:
        status, feedback = read_feedback_or_result(data)
        entry = self._note(action, status, asyncio.get_running_loop().time())
        if entry is not None:
            self._report(action, status.id, entry, GoalEvent(time.time_ns(), feedback=feedback))

    def _take_goal(self, action: str, data: bytes) -> None:
        id, goal = read_goal(data)
        if not id:
            return
        entry = self._goals(action).get(id)
        if entry is None:
            entry = self._goals(action)[id] = _Goal(asyncio.get_running_loop().time())
            self._limit_goals(action)
        if entry.goal is None:
            entry.goal = goal
            if entry.latest is not None:
                self._report(action, id, entry, GoalEvent(time.time_ns(), goal=goal))

    def _note(self, action: str, status: Status, now: float, *, waits_for_result: bool = False) -> _Goal | None:
        """Record and report the status of a goal; return None for an unknown status."""
        if not status.id or status.status is None:
            return None
        entry = self._goals(action).get(status.id)
        if entry is None:
            entry = self._goals(action)[status.id] = _Goal(now)
            self._limit_goals(action)
        entry.listed_at = now
        if entry.latest is not None and (entry.latest == status or (entry.is_final and not status.status.is_final)):
            return entry
        is_first = entry.latest is None
        entry.latest = status
        if status.status.is_final and entry.ended_at is None:
            entry.ended_at = now
        self._decide(entry, status)
        event = GoalEvent(time.time_ns(), status.status, status.words, goal=entry.goal if is_first else None)
        if waits_for_result and status.status.is_final and not entry.has_result:
            entry.ending = event
            asyncio.get_running_loop().call_later(_RESULT_SOON, self._end, action, status.id, entry)
        else:
            self._report(action, status.id, entry, event)
        return entry

    def _end(self, action: str, id: str, entry: _Goal) -> None:
        """Report the end of a goal, unless it was reported with its result."""
        if entry.ending is not None:
            event, entry.ending = entry.ending, None
            self._report(action, id, entry, event)

    def _decide(self, entry: _Goal, status: Status) -> None:
        """Resolve the sender's wait: at once, or after `_DECISION` if the goal may still be rejected."""
        if entry.decided is None or entry.decided.done():
            return
        if status.status is GoalStatus.ACCEPTED:
            asyncio.get_running_loop().call_later(_DECISION, _settle, entry.decided, status)
        else:
            entry.is_refused = status.status is GoalStatus.REJECTED
            entry.decided.set_result(status)

    def _report(self, action: str, id: str, entry: _Goal, event: GoalEvent) -> None:
        """Report an event of an accepted goal. A rejection is returned to the sender instead."""
        if entry.is_refused:
            return
        if entry.is_undecided:
            entry.pending.append(event)
            return
        self._flush(action, id, entry)
        self._sink.goal_changed(GoalId(action, id), dataclasses.replace(event, own=entry.is_own))

    def _flush(self, action: str, id: str, entry: _Goal) -> None:
        events, entry.pending = entry.pending, []
        for event in events:
            self._report(action, id, entry, event)

    def _tick(self) -> None:
        """Detect lost goals, and stop following actions without followers."""
        self._ticking = None
        now = asyncio.get_running_loop().time()
        for action, followed in list(self._followed.items()):
            if followed.readers["status"].is_connected:
                followed.connected_at = now
            is_disconnected = now - followed.connected_at > _LOST_AFTER
            for id, entry in list(self._goals(action).items()):
                self._send_again(action, entry)
                self._check_goal(action, id, entry, now, is_disconnected=is_disconnected)
            self._stop_if_idle(action)
        if self._followed:
            self._ticking = asyncio.get_running_loop().call_later(_TICK, self._tick)

    def _send_again(self, action: str, entry: _Goal) -> None:
        """Send a goal again that its server does not list, once all connections that it was sent on are closed.

        rospy may connect twice and drop the first connection with its unread messages. A server that did read the goal
        ignores a second one with the same id.
        """
        sending = entry.sending
        if sending is None or entry.latest is not None or not entry.is_undecided:
            return
        links = sending.publication.links_to(self._servers(action))
        if links and not links & sending.links:
            entry.sending = replace(sending, links=links)
            sending.publication.send(sending.message, False)

    def _check_goal(self, action: str, id: str, entry: _Goal, now: float, *, is_disconnected: bool) -> None:
        """Report a goal that is lost, and forget one that is over."""
        if entry.is_final:
            if _is_over(entry) and now - entry.listed_at > _RESULT:
                del self._goals(action)[id]
            return
        if is_disconnected:
            self._mark_lost(action, id, entry, now, f"the server of {action} is gone")
        elif self._followed[action].statuses_at - entry.listed_at > _LOST_AFTER and not entry.is_undecided:
            self._mark_lost(action, id, entry, now, f"the server of {action} no longer knows the goal")

    def _mark_lost(self, action: str, id: str, entry: _Goal, now: float, words: str) -> None:
        entry.ended_at, entry.has_result = now, True
        entry.latest = Status(id, 9, words)
        if entry.decided is not None and not entry.decided.done():
            entry.is_refused = True
            entry.decided.set_exception(Unreachable(f"the goal was sent, but {words}", sent=Sent.MAYBE))
        self._report(action, id, entry, GoalEvent(time.time_ns(), GoalStatus.LOST, words))

    def _limit_goals(self, action: str) -> None:
        """Forget the oldest goals of others above the limit."""
        goals = self._goals(action)
        while len(goals) > _MAX_GOALS:
            oldest = next((id for id, entry in goals.items() if not entry.is_own or _is_over(entry)), None)
            if oldest is None:
                return
            del goals[oldest]


def goal_definition(schema: ActionSchema) -> tuple[str, str]:
    """Return the name and definition of the message with a goal of this type, as generated by actionlib."""
    package, _, short = schema.ref.name.partition("/action/")
    own, *nested = schema.goal.definition.split(SEPARATOR)
    parts = [
        f"Header header\nactionlib_msgs/GoalID goal_id\n{short}Goal goal\n",
        f"\nMSG: {package}/{short}Goal\n{own}",
        *nested,
    ]
    return f"{package}/msg/{short}ActionGoal", SEPARATOR.join(parts)


def _settle(decided: asyncio.Future[Status], status: Status) -> None:
    if not decided.done():
        decided.set_result(status)


def _is_over(entry: _Goal) -> bool:
    """Whether a goal has ended, and its result was received or did not arrive in time."""
    if entry.ended_at is None:
        return False
    return entry.has_result or asyncio.get_running_loop().time() - entry.ended_at > _RESULT
