"""Goals of actions, ours and others': each is a resource that outlives its request, kept within a number and an age."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import logging
import re
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace

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
from rosld.server.robot.calls import Gone, KeyReused
from rosld.server.runtime.identifiers import new_identifier
from rosld.server.runtime.loop_time import loop_time
from rosld.server.runtime.signals import Signal

_log = logging.getLogger("rosld")
_PLAIN = re.compile(r"[A-Za-z0-9_-]{1,64}")
_NOT_PLAIN = re.compile(r"[^A-Za-z0-9_-]+")
_LONGEST = 48
_REMEMBERED = 10_000
_SWEEP = 1.0
_ORDER: Mapping[GoalStatus, int] = {GoalStatus.ACCEPTED: 0, GoalStatus.EXECUTING: 1, GoalStatus.CANCELING: 2}
_ENDED = 3


@dataclass(frozen=True, slots=True, eq=False)
class Told:
    """A message that a server of an action sent, and when it came."""

    message: Message
    received_ns: int
    count: int = 1


@dataclass(frozen=True, slots=True, eq=False)
class Goal:
    """One goal: immutable, replaced by its next state, compared by identity.

    `key` is None for a goal that was rejected when it was sent. Times are wall-clock nanoseconds. What cannot be read
    of what is told is left out, and `unreadable` says why.
    """

    id: str
    action: str
    key: GoalId | None
    created_ns: int
    heard_ns: int
    status: GoalStatus
    schema: ActionSchema | None = None
    goal: Message | None = None
    feedback: Told | None = None
    result: Message | None = None
    ended_ns: int | None = None
    words: str | None = None
    unreadable: str | None = None
    own: bool = False

    @property
    def is_cancelable(self) -> bool:
        """Whether asking for it to be canceled may still change anything."""
        return self.status in (GoalStatus.ACCEPTED, GoalStatus.EXECUTING)


_MESSAGES = frozenset({"goal", "feedback", "result"})
_FIELDS = tuple(field.name for field in fields(Goal))


@dataclass(frozen=True, slots=True)
class Sending:
    """A goal as it stands when its sender is answered, and the error where it was not taken."""

    goal: Goal | None
    error: RosError | None


class Goals:
    """The goals of one robot. `hear` is for any thread, all else for the server's loop.

    Feedback that comes faster than the loop takes it is told as one. What was deleted, or has become too old, is not
    learnt again from who still tells of it. Those that have ended go first where there are too many.
    """

    def __init__(
        self, adapter: Adapter, schemas: Callable[[str], ActionSchema | None], *, most: int, age: float, idle: float
    ) -> None:
        """`schemas` gives the schema of an action by the action's name, as far as it is at hand."""
        self._adapter = adapter
        self._schemas = schemas
        self._most = most
        self._age_ns = int(age * 1e9)
        self._idle = idle
        self._goals: OrderedDict[str, Goal] = OrderedDict()
        self._ids: dict[GoalId, str] = {}
        self._gone: OrderedDict[str, GoalId | None] = OrderedDict()
        self._dropped: set[GoalId] = set()
        self._keyed: OrderedDict[tuple[str, str], tuple[bytes, asyncio.Task[Sending]]] = OrderedDict()
        self._heard: OrderedDict[GoalId, tuple[GoalEvent, int]] = OrderedDict()
        self._lock = threading.Lock()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._followed: dict[str, _Following] = {}
        self._sweeper: asyncio.Task[None] | None = None
        self.revision = 0
        self.changes = Signal()

    # All goals

    def all(self) -> Sequence[Goal]:
        """The goals kept, oldest first."""
        self._forget_old()
        return list(self._goals.values())

    def of(self, action: str) -> Sequence[Goal]:
        """The goals kept of one action, oldest first."""
        return [goal for goal in self.all() if goal.action == action]

    def find(self, id: str) -> Goal:
        """A goal by its id; raises Gone for one that was deleted or is too old, KeyError for one that never was."""
        self._forget_old()
        if id in self._gone:
            raise Gone(id)
        return self._goals[id]

    def delete(self, id: str) -> None:
        """Forget a goal; raises as `find`."""
        self.find(id)
        self._drop(id)

    # Sending and canceling

    async def send(self, action: str, schema: ActionSchema, message: Message, *, deadline: float) -> Sending:
        """Send a goal; the one that was rejected is kept as well. Raises ValueError where it cannot be encoded."""
        data = schema.goal.codec.encode(message, self._adapter.capabilities.encoding)
        now = time.time_ns()
        try:
            key = await self._adapter.send_goal(action, schema.ref, data, deadline=deadline)
        except RosError as error:
            if not isinstance(error, Refused):
                return Sending(None, error)
            words = error.words or error.sentence
            goal = Goal(
                new_identifier(), action, None, now, now, GoalStatus.REJECTED, schema, message, words=words,
                ended_ns=time.time_ns(), own=True,
            )  # fmt: skip
            self._keep(goal)
            return Sending(goal, error)
        self._drain()
        known = self._goals.get(self._ids.get(key, ""))
        if known is None:
            known = Goal(self._new_id(key), action, key, now, now, GoalStatus.ACCEPTED)
        self._keep(replace(known, schema=schema, goal=message, created_ns=min(now, known.created_ns), own=True))
        return Sending(self._goals[known.id], None)

    async def once(
        self, key: str, action: str, schema: ActionSchema, message: Message, body: bytes, *, deadline: float
    ) -> Sending:
        """As `send`, but a second goal with the same key is the first; KeyReused where it differs."""
        digest = hashlib.blake2b(body).digest()
        known = self._keyed.get((action, key))
        if known is not None and known[0] != digest:
            raise KeyReused(key)
        if known is None:
            sending = asyncio.get_running_loop().create_task(self.send(action, schema, message, deadline=deadline))
            known = self._keyed[(action, key)] = (digest, sending)
            while len(self._keyed) > self._most:
                self._keyed.popitem(last=False)
        sent = await asyncio.shield(known[1])
        return sent if sent.goal is None else Sending(self._goals.get(sent.goal.id, sent.goal), sent.error)

    async def cancel(self, goal: Goal, *, deadline: float) -> None:
        """Ask for a goal to be canceled; raises what the adapter raises."""
        if goal.key is not None:
            await self._adapter.cancel_goal(goal.key, deadline=deadline)

    # Hearing of goals

    def hear(self, key: GoalId, event: GoalEvent) -> None:
        """Take what became known of a goal; from any thread. What nobody has taken yet is told together."""
        with self._lock:
            before = self._heard.get(key)
            count = (1 if event.feedback is not None else 0) + (before[1] if before else 0)
            self._heard[key] = (event if before is None else _merged(before[0], event), count)
            while len(self._heard) > _REMEMBERED:
                self._heard.popitem(last=False)
            is_first = len(self._heard) == 1 and before is None
        if is_first and self._loop is not None and not self._loop.is_closed():
            with contextlib.suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self._drain)

    def _drain(self) -> None:
        with self._lock:
            heard, self._heard = self._heard, OrderedDict()
        for key, (event, count) in heard.items():
            try:
                self._take(key, event, count)
            except Exception:  # the events of the other goals are taken all the same
                _log.exception("what became known of goal %.100r of %s was not taken", key.id, key.action)

    def _take(self, key: GoalId, event: GoalEvent, count: int) -> None:
        if key in self._dropped:
            return
        known = self._goals.get(self._ids.get(key, ""))
        if known is None:
            known = Goal(
                self._new_id(key), key.action, key, event.received_ns, event.received_ns, GoalStatus.ACCEPTED,
                self._schemas(key.action),
            )  # fmt: skip
        goal = self._after(known, event, count)
        if goal is not known or known.id not in self._goals:
            self._keep(goal)

    def _after(self, goal: Goal, event: GoalEvent, count: int) -> Goal:
        """The goal after an event: no status comes after one that is final, but that of a goal thought lost."""
        status = goal.status
        if event.status is not None and (_rank(event.status) >= _rank(status) and not _is_settled(status)):
            status = event.status
        schema = goal.schema or self._schemas(goal.action)
        changed = replace(goal, status=status, schema=schema, own=goal.own or event.own)
        if event.words is not None and (status is event.status or event.status is None):
            changed = replace(changed, words=event.words or None)
        if schema is not None:
            changed = self._with_messages(changed, schema, event, count)
        if status is not goal.status and status.is_final:
            changed = replace(changed, ended_ns=event.received_ns)
        return goal if _is_same(goal, changed) else replace(changed, heard_ns=max(goal.heard_ns, event.received_ns))

    def _with_messages(self, goal: Goal, schema: ActionSchema, event: GoalEvent, count: int) -> Goal:
        encoding = self._adapter.capabilities.encoding
        try:
            if event.goal is not None and goal.goal is None:
                goal = replace(goal, goal=_decoded(schema.goal, event.goal, encoding))
            if event.feedback is not None:
                before = goal.feedback.count if goal.feedback else 0
                message = _decoded(schema.feedback, event.feedback, encoding)
                goal = replace(goal, feedback=Told(message, event.received_ns, before + max(1, count)))
            if event.result is not None and goal.result is None:
                goal = replace(goal, result=_decoded(schema.result, event.result, encoding))
        except ValueError as error:
            return replace(goal, unreadable=str(error))
        return goal

    # Looking at what others do

    async def look(self, action: str, *, deadline: float) -> None:
        """Hear of all goals of an action from now on, until nobody has looked for a while. The first look waits."""
        following = self._followed.get(action)
        if following is None:
            opening = asyncio.ensure_future(self._adapter.follow_goals(action, deadline=deadline))
            following = self._followed[action] = _Following(opening, 0.0)
        following.looked_at = loop_time()
        try:
            await asyncio.shield(following.opening)
        except RosError:
            if self._followed.get(action) is following:
                del self._followed[action]
            return
        self._drain()

    def watch(self, action: str, wake: Callable[[], None], id: str | None = None) -> Watch:
        """Call `wake` when something became known of a goal of an action, or of one goal; it is followed meanwhile."""
        following = self._followed.get(action)
        wanted = {action} if id is None else {id}
        return _GoalWatch(following, self.changes.watch(wake, lambda about: about in wanted))

    def start(self) -> None:
        """Begin; needs a running loop."""
        self._loop = asyncio.get_running_loop()
        self._sweeper = self._loop.create_task(self._sweep_for_ever())
        self._loop.call_soon(self._drain)

    async def stop(self) -> None:
        """Follow nothing more; goals that are pursued are left to the robot."""
        if self._sweeper is not None:
            self._sweeper.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._sweeper
        for action in list(self._followed):
            self._unfollow(action)

    async def _sweep_for_ever(self) -> None:
        while True:
            await asyncio.sleep(_SWEEP)
            horizon = loop_time() - self._idle
            for action, following in list(self._followed.items()):
                if not following.watches and following.looked_at < horizon:
                    self._unfollow(action)

    def _unfollow(self, action: str) -> None:
        opening = self._followed.pop(action).opening
        if not opening.done():
            opening.cancel()
        elif not opening.cancelled() and opening.exception() is None:
            opening.result().close()

    # Keeping them

    def _keep(self, goal: Goal) -> None:
        self._goals[goal.id] = goal
        if goal.key is not None:
            self._ids[goal.key] = goal.id
        self._revise(goal)
        while len(self._goals) > self._most:
            ended = (each.id for each in self._goals.values() if each.status.is_final and each.id != goal.id)
            self._drop(next(ended, None) or next(iter(self._goals)))

    def _drop(self, id: str) -> None:
        goal = self._goals.pop(id)
        if goal.key is not None:
            self._ids.pop(goal.key, None)
            self._dropped.add(goal.key)
        self._gone[id] = goal.key
        while len(self._gone) > _REMEMBERED:
            _, key = self._gone.popitem(last=False)
            if key is not None:
                self._dropped.discard(key)
        self._revise(goal)

    def _forget_old(self) -> None:
        horizon = time.time_ns() - self._age_ns
        for goal in [each for each in self._goals.values() if each.heard_ns < horizon]:
            self._drop(goal.id)

    def _revise(self, goal: Goal) -> None:
        self.revision += 1
        self.changes.emit(goal.action)
        self.changes.emit(goal.id)

    def _new_id(self, key: GoalId) -> str:
        """What a goal is called in URLs: its own id where that is safe and nobody else's, else made of it."""
        if _PLAIN.fullmatch(key.id) and key.id not in self._goals and key.id not in self._gone:
            return key.id
        whole = f"{key.action}\0{key.id}".encode("utf-8", "surrogatepass")
        begin = _NOT_PLAIN.sub("-", key.id)[:_LONGEST].strip("-")
        return f"{begin}-{hashlib.blake2b(whole, digest_size=8).hexdigest()}".lstrip("-")


@dataclass(slots=True)
class _Following:
    """An action whose goals are told: since whom, when somebody looked last, and how many watch it."""

    opening: asyncio.Future[Watch]
    looked_at: float
    watches: int = 0


class _GoalWatch:
    """A watch that keeps its action followed."""

    def __init__(self, following: _Following | None, watch: Watch) -> None:
        self._following = following
        self._watch = watch
        if following is not None:
            following.watches += 1

    def close(self) -> None:
        """Stop waking. Idempotent."""
        following, self._following = self._following, None
        if following is not None:
            following.watches -= 1
            following.looked_at = loop_time()
        self._watch.close()


def _is_same(before: Goal, after: Goal) -> bool:
    """Whether two states of a goal say the same; messages are compared by identity, for they may hold arrays."""
    return all(
        (one is other) if name in _MESSAGES else (one == other)
        for name, one, other in ((name, getattr(before, name), getattr(after, name)) for name in _FIELDS)
    )


def _rank(status: GoalStatus) -> int:
    return _ORDER.get(status, _ENDED)


def _is_settled(status: GoalStatus) -> bool:
    return status.is_final and status is not GoalStatus.LOST


def _merged(first: GoalEvent, second: GoalEvent) -> GoalEvent:
    """Two events as one: of each thing what was told last, of the status what is further on."""
    status, words = second.status, second.words
    if first.status is not None and (status is None or _is_settled(first.status)):
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


def _decoded(schema: MessageSchema, data: bytes, encoding: Encoding) -> Message:
    return schema.codec.decode(data, encoding)
