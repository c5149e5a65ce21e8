"""Goals of actions: resources that outlive their requests, limited in number and age, and updated while read."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence

from msgspec import Struct
from msgspec.structs import replace

from rosld.adapters.base import Adapter, Watch
from rosld.adapters.model import (
    ActionSchema,
    Encoding,
    GoalEvent,
    GoalId,
    GoalStatus,
    Message,
    MessageSchema,
    Refused,
    RosError,
)
from rosld.server.http.problem import one_line
from rosld.server.receipts.audit import Sender, new_identifier
from rosld.server.robot.goal_store import Feedback, Goal, GoalStore
from rosld.server.robot.limited_store import MAX_REMEMBERED
from rosld.server.runtime.tasks import Background, call_on_close, combine_watches, loop_time

_SWEEP = 1.0


class GoalFollower(Background):
    """Follower of actions while clients read them, and for `idle` seconds after that. Belongs to one loop."""

    def __init__(self, adapter: Adapter, idle: float) -> None:
        self._adapter = adapter
        self._idle = idle
        self._followed: dict[str, _FollowedAction] = {}

    async def stop(self) -> None:
        """Stop following."""
        await super().stop()
        for action in list(self._followed):
            self._unfollow(action)

    async def follow(self, action: str, *, deadline: float) -> bool:
        """Follow all goals of an action; return whether this succeeded. The first call waits."""
        following = self._followed.get(action)
        if following is None:
            opening = asyncio.ensure_future(self._adapter.follow_goals(action, deadline=deadline))
            following = self._followed[action] = _FollowedAction(opening, 0.0)
        following.read_at = loop_time()
        try:
            await asyncio.shield(following.opening)
        except RosError:
            if self._followed.get(action) is following:
                del self._followed[action]
            return False
        return True

    def is_followed(self, action: str) -> bool:
        """Whether all goals of an action are currently followed."""
        following = self._followed.get(action)
        opening = None if following is None else following.opening
        return opening is not None and opening.done() and not opening.cancelled() and opening.exception() is None

    def keep_following(self, action: str, watch: Watch) -> Watch:
        """Return a watch that keeps its action followed, if it is followed, until it is closed."""
        following = self._followed.get(action)
        if following is None:
            return watch
        following.watches += 1

        def end() -> None:
            following.watches -= 1
            following.read_at = loop_time()

        return combine_watches(watch, call_on_close(end))

    async def _run(self) -> None:
        while True:
            await asyncio.sleep(_SWEEP)
            horizon = loop_time() - self._idle
            for action, following in list(self._followed.items()):
                if not following.watches and following.read_at < horizon:
                    self._unfollow(action)

    def _unfollow(self, action: str) -> None:
        opening = self._followed.pop(action).opening
        if not opening.done():
            opening.cancel()
        elif not opening.cancelled() and opening.exception() is None:
            opening.result().close()


class _FollowedAction(Struct):
    """A followed action: the watch of its goals, the time of the last read (loop time), and the number of watches."""

    opening: asyncio.Future[Watch]
    read_at: float
    watches: int = 0


_log = logging.getLogger("rosld")
_ORDER: Mapping[GoalStatus, int] = {GoalStatus.ACCEPTED: 0, GoalStatus.EXECUTING: 1, GoalStatus.CANCELING: 2}
_ENDED = 3


_MESSAGES = frozenset({"goal", "feedback", "result"})
_FIELDS = Goal.__struct_fields__


class GoalSubmission(Struct, frozen=True):
    """The state of a goal in the response to its sender, and the error if it was not accepted."""

    goal: Goal | None
    error: RosError | None


class Goals(GoalStore):
    """The goals of one robot. `on_event` is thread-safe, everything else belongs to the server's loop.

    Feedback that arrives faster than the loop runs is merged.
    """

    def __init__(
        self, adapter: Adapter, schemas: Callable[[str], ActionSchema | None], *, limit: int, age: float, idle: float
    ) -> None:
        """Initialize; `schemas` returns the cached schema of an action by its name."""
        super().__init__(limit=limit, age=age)
        self._adapter = adapter
        self._schemas = schemas
        self._follower = GoalFollower(adapter, idle)
        self._pending: OrderedDict[GoalId, tuple[GoalEvent, int]] = OrderedDict()
        self._lock = threading.Lock()
        self._loop: asyncio.AbstractEventLoop | None = None

    def of_action(self, action: str) -> Sequence[Goal]:
        """Return the stored goals of one action, oldest first."""
        return [goal for goal in self.all() if goal.action == action]

    def is_followed(self, action: str) -> bool:
        """Whether all goals of an action are currently followed."""
        return self._follower.is_followed(action)

    # Sending and canceling

    async def send(
        self,
        action: str,
        schema: ActionSchema,
        message: Message,
        *,
        deadline: float,
        sender: Sender | None = None,
        once: tuple[str, bytes] | None = None,
    ) -> GoalSubmission:
        """Send a goal, and store it even if it is rejected.

        Raises as `send_once`, and ValueError if the goal cannot be encoded.
        """
        sent = await self.send_once(action, once, lambda: self._send(action, schema, message, deadline, sender))
        return sent if sent.goal is None else GoalSubmission(self.get(sent.goal.id) or sent.goal, sent.error)

    async def _send(
        self, action: str, schema: ActionSchema, message: Message, deadline: float, sender: Sender | None
    ) -> GoalSubmission:
        data = schema.goal.codec.encode(message, self._adapter.capabilities.encoding)
        now = time.time_ns()
        try:
            key = await self._adapter.send_goal(action, schema.ref, data, deadline=deadline)
        except RosError as error:
            if not isinstance(error, Refused):
                return GoalSubmission(None, error)
            words = one_line(error.words or error.sentence)
            goal = Goal(
                new_identifier(), action, None, now, now, GoalStatus.REJECTED, schema, message, words=words,
                ended_ns=time.time_ns(), is_own=True, sender=sender,
            )  # fmt: skip
            self.keep(goal)
            return GoalSubmission(goal, error)
        self._drain()
        known = self.of_key(key)
        if known is None:
            known = Goal(self.new_id(key), action, key, now, now, GoalStatus.ACCEPTED)
        self.keep(
            replace(
                known, schema=schema, goal=message, created_ns=min(now, known.created_ns), is_own=True, sender=sender
            )
        )
        return GoalSubmission(self.get(known.id), None)

    async def cancel(self, goal: Goal, *, deadline: float) -> None:
        """Request the cancellation of a goal. Raises what the adapter raises."""
        if goal.key is not None:
            await self._adapter.cancel_goal(goal.key, deadline=deadline)

    async def wait_ended(self, id: str, *, seconds: float) -> bool:
        """Wait up to `seconds` until a goal has ended; return whether it has."""
        return await self._wait_true(id, lambda: (goal := self.get(id)) is not None and goal.status.is_settled, seconds)

    async def wait_all_ended(self, action: str, *, seconds: float) -> bool:
        """Wait until all goals of an action have ended; return whether at least one is known and all have."""

        def have_ended() -> bool:
            goals = self.of_action(action)
            return bool(goals) and all(goal.status.is_settled for goal in goals)

        await self.follow(action, deadline=asyncio.get_running_loop().time() + seconds)
        return self.is_followed(action) and await self._wait_true(action, have_ended, seconds)

    async def _wait_true(self, about: str, is_true: Callable[[], bool], seconds: float) -> bool:
        """Wait until a condition on the goals of an action, or on one goal, is true; return whether it is."""
        deadline = asyncio.get_running_loop().time() + seconds
        changed = asyncio.Event()
        watch = self.changes.watch(changed.set, lambda changed: changed == about)
        try:
            while not is_true():
                await asyncio.wait_for(changed.wait(), deadline - asyncio.get_running_loop().time())
                changed.clear()
            return True
        except (asyncio.TimeoutError, TimeoutError):
            return False
        finally:
            watch.close()

    # Updates

    def on_event(self, key: GoalId, event: GoalEvent) -> None:
        """Queue an update about a goal (thread-safe). Pending updates are delivered in one batch."""
        with self._lock:
            before = self._pending.get(key)
            count = (1 if event.feedback is not None else 0) + (before[1] if before else 0)
            self._pending[key] = (event if before is None else _merge(before[0], event), count)
            while len(self._pending) > MAX_REMEMBERED:
                self._pending.popitem(last=False)
            is_first = len(self._pending) == 1 and before is None
        if is_first and self._loop is not None and not self._loop.is_closed():
            with contextlib.suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self._drain)

    def _drain(self) -> None:
        with self._lock:
            pending, self._pending = self._pending, OrderedDict()
        for key, (event, count) in pending.items():
            try:
                self._take(key, event, count)
            except Exception:  # the events of other goals are still processed
                _log.exception("failed to process an update about goal %.100r of %s", key.id, key.action)

    def _take(self, key: GoalId, event: GoalEvent, count: int) -> None:
        if key in self._dropped:
            return
        known = self.of_key(key)
        if known is None:
            known = Goal(
                self.new_id(key), key.action, key, event.received_ns, event.received_ns, GoalStatus.ACCEPTED,
                self._schemas(key.action),
            )  # fmt: skip
        goal = self._after(known, event, count)
        if goal is not known or self.get(known.id) is None:
            self.keep(goal)

    def _after(self, goal: Goal, event: GoalEvent, count: int) -> Goal:
        """Return the goal after an event: a final status does not change, except that of a goal thought lost."""
        status = goal.status
        if event.status is not None and (_rank(event.status) >= _rank(status) and not status.is_settled):
            status = event.status
        schema = goal.schema or self._schemas(goal.action)
        changed = replace(goal, status=status, schema=schema, is_own=goal.is_own or event.own)
        if event.words is not None and (status is event.status or event.status is None):
            changed = replace(changed, words=one_line(event.words) or None)
        if schema is not None:
            changed = self._with_messages(changed, schema, event, count)
        if status is not goal.status and status.is_final:
            changed = replace(changed, ended_ns=event.received_ns)
        return goal if _is_same(goal, changed) else replace(changed, updated_ns=max(goal.updated_ns, event.received_ns))

    def _with_messages(self, goal: Goal, schema: ActionSchema, event: GoalEvent, count: int) -> Goal:
        encoding = self._adapter.capabilities.encoding
        try:
            if event.goal is not None and goal.goal is None:
                goal = replace(goal, goal=_decode(schema.goal, event.goal, encoding))
            if event.feedback is not None:
                before = goal.feedback.count if goal.feedback else 0
                message = _decode(schema.feedback, event.feedback, encoding)
                goal = replace(goal, feedback=Feedback(message, event.received_ns, before + max(1, count)))
            if event.result is not None and goal.result is None:
                goal = replace(goal, result=_decode(schema.result, event.result, encoding))
        except ValueError as error:
            return replace(goal, unreadable=str(error))
        return goal

    # Following

    async def follow(self, action: str, *, deadline: float) -> None:
        """Follow all goals of an action until they have not been read for a while. The first call waits."""
        if await self._follower.follow(action, deadline=deadline):
            self._drain()

    def watch(self, action: str, wake: Callable[[], None], id: str | None = None) -> Watch:
        """Call `wake` after each update about a goal of an action, or about one goal; it is followed meanwhile."""
        wanted = {action} if id is None else {id}
        return self._follower.keep_following(action, self.changes.watch(wake, lambda about: about in wanted))

    def start(self) -> None:
        """Start following; requires a running loop."""
        self._loop = asyncio.get_running_loop()
        self._follower.start()
        self._loop.call_soon(self._drain)

    async def stop(self) -> None:
        """Stop following; pursued goals are left to the robot."""
        await self._follower.stop()


def _is_same(before: Goal, after: Goal) -> bool:
    """Whether two states of a goal are equal; messages are compared by identity, because they may contain arrays."""
    return all(
        (one is other) if name in _MESSAGES else (one == other)
        for name, one, other in ((name, getattr(before, name), getattr(after, name)) for name in _FIELDS)
    )


def _rank(status: GoalStatus) -> int:
    return _ORDER.get(status, _ENDED)


def _merge(first: GoalEvent, second: GoalEvent) -> GoalEvent:
    """Merge two events: the latest value of each field, and the later status."""
    status, words = second.status, second.words
    if first.status is not None and (status is None or first.status.is_settled):
        status, words = first.status, first.words if first.words is not None else words
    return GoalEvent(
        second.received_ns,
        status,
        words if words is not None else first.words,
        second.feedback if second.feedback is not None else first.feedback,
        second.result if second.result is not None else first.result,
        second.goal if second.goal is not None else first.goal,
        first.own or second.own,
    )


def _decode(schema: MessageSchema, data: bytes, encoding: Encoding) -> Message:
    return schema.codec.decode(data, encoding)
