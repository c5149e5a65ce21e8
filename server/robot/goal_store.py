"""Storage of goals, limited in number and age, and their ids in URLs."""

from __future__ import annotations

import hashlib
import re
import time
from collections import OrderedDict
from collections.abc import Sequence

from msgspec import Struct

from rosld.adapters.model import ActionSchema, GoalId, GoalStatus, Message
from rosld.server.receipts.audit import Sender
from rosld.server.robot.calls import Gone
from rosld.server.runtime.tasks import Signal

MAX_REMEMBERED = 10_000
"""Maximum number of removed goals that are remembered as such."""
_PLAIN = re.compile(r"[A-Za-z0-9_-]{1,64}")
_NOT_PLAIN = re.compile(r"[^A-Za-z0-9_-]+")
_MAX_ID_LENGTH = 48


class Feedback(Struct, frozen=True, eq=False):
    """The latest feedback message of an action server, and its time of receipt."""

    message: Message
    received_ns: int
    count: int = 1


class Goal(Struct, frozen=True, eq=False):
    """A goal: immutable, replaced by its next state, compared by identity.

    `key` is None for a goal that was rejected when sent. Times are wall-clock nanoseconds. Undecodable messages are
    left out, with the reason in `unreadable`.
    """

    id: str
    action: str
    key: GoalId | None
    created_ns: int
    updated_ns: int
    status: GoalStatus
    schema: ActionSchema | None = None
    goal: Message | None = None
    feedback: Feedback | None = None
    result: Message | None = None
    ended_ns: int | None = None
    words: str | None = None
    unreadable: str | None = None
    is_own: bool = False
    sender: Sender | None = None

    @property
    def is_cancelable(self) -> bool:
        """Whether a request to cancel it may still have an effect."""
        return self.status in (GoalStatus.ACCEPTED, GoalStatus.EXECUTING)


class GoalStore:
    """Goals by id; above the limit, ended goals are removed first.

    Deleted and expired goals are not added again by later events. `changes` is emitted with the action and the id of
    each changed goal, `revision` counts the changes.
    """

    def __init__(self, *, limit: int, age: float) -> None:
        self._limit = limit
        self._age_ns = int(age * 1e9)
        self._goals: OrderedDict[str, Goal] = OrderedDict()
        self._ids: dict[GoalId, str] = {}
        self._removed: OrderedDict[str, GoalId | None] = OrderedDict()
        self._dropped: set[GoalId] = set()
        self.revision = 0
        self.changes = Signal()

    def all(self) -> Sequence[Goal]:
        """Return the stored goals, oldest first."""
        self._forget_old()
        return list(self._goals.values())

    def find(self, id: str) -> Goal:
        """Return a goal by its id. Raises Gone for a deleted or expired goal, KeyError for an unknown one."""
        self._forget_old()
        if id in self._removed:
            raise Gone(id)
        return self._goals[id]

    def current(self, action: str) -> Goal | None:
        """Return the newest goal of an action that has not ended, or else the last goal."""
        newest = [goal for goal in reversed(self._goals.values()) if goal.action == action]
        return next((goal for goal in newest if not goal.status.is_final), newest[0] if newest else None)

    def get(self, id: str) -> Goal | None:
        """Return a stored goal, whatever its age."""
        return self._goals.get(id)

    def action_of(self, id: str) -> str | None:
        """Return the action of a goal, "" for a removed goal, None for an unknown one (thread-safe)."""
        goal = self._goals.get(id)
        return goal.action if goal is not None else "" if id in self._removed else None

    def of_key(self, key: GoalId) -> Goal | None:
        """Return the goal with this key."""
        return self._goals.get(self._ids.get(key, ""))

    def is_dropped(self, key: GoalId) -> bool:
        """Whether the goal was removed, so that later events are ignored."""
        return key in self._dropped

    def delete(self, id: str) -> None:
        """Remove a goal; raises as `find`."""
        self.find(id)
        self._drop(id)

    def keep(self, goal: Goal) -> None:
        """Store a goal, or its next state."""
        self._goals[goal.id] = goal
        if goal.key is not None:
            self._ids[goal.key] = goal.id
        self._revise(goal)
        while len(self._goals) > self._limit:
            ended = (each.id for each in self._goals.values() if each.status.is_final and each.id != goal.id)
            self._drop(next(ended, None) or next(iter(self._goals)))

    def _drop(self, id: str) -> None:
        goal = self._goals.pop(id)
        if goal.key is not None:
            self._ids.pop(goal.key, None)
            self._dropped.add(goal.key)
        self._removed[id] = goal.key
        while len(self._removed) > MAX_REMEMBERED:
            _, key = self._removed.popitem(last=False)
            if key is not None:
                self._dropped.discard(key)
        self._revise(goal)

    def _forget_old(self) -> None:
        horizon = time.time_ns() - self._age_ns
        for goal in [each for each in self._goals.values() if each.updated_ns < horizon]:
            self._drop(goal.id)

    def _revise(self, goal: Goal) -> None:
        self.revision += 1
        self.changes.emit(goal.action)
        self.changes.emit(goal.id)

    def new_id(self, key: GoalId) -> str:
        """Return the id of a goal in URLs: its own if that is safe and unused, else one derived from it."""
        if _PLAIN.fullmatch(key.id) and key.id not in self._goals and key.id not in self._removed:
            return key.id
        whole = f"{key.action}\0{key.id}".encode("utf-8", "surrogatepass")
        begin = _NOT_PLAIN.sub("-", key.id)[:_MAX_ID_LENGTH].strip("-")
        return f"{begin}-{hashlib.blake2b(whole, digest_size=8).hexdigest()}".lstrip("-")
