"""Storage of goals, limited in number and age, and their ids in URLs."""

from __future__ import annotations

import hashlib
import re
from collections import OrderedDict
from collections.abc import Sequence

from msgspec import Struct

from rosld.adapters.model import ActionSchema, GoalId, GoalStatus, Message
from rosld.server.receipts.audit import Sender
from rosld.server.robot.limited_store import MAX_REMEMBERED, LimitedStore

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


class GoalStore(LimitedStore[Goal]):
    """Goals by id and key. Deleted and expired goals are not added again by later events."""

    word = "goal"

    def __init__(self, *, limit: int, age: float) -> None:
        super().__init__(limit, age)
        self._ids: dict[GoalId, str] = {}
        self._dropped: OrderedDict[GoalId, None] = OrderedDict()
        """Keys of removed goals, whose later events are ignored."""

    def subjects(self, one: Goal) -> Sequence[str]:
        return one.id, one.action

    def may_go(self, one: Goal) -> bool:
        return one.status.is_final

    def changed_ns(self, one: Goal) -> int:
        return one.updated_ns

    def current(self, action: str) -> Goal | None:
        """Return the goal that an action pursues, the newest of several; if none, the last one."""
        newest = [goal for goal in reversed(self._stored.values()) if goal.action == action]
        return next((goal for goal in newest if not goal.status.is_final), newest[0] if newest else None)

    def of_key(self, key: GoalId) -> Goal | None:
        """Return the goal with this key."""
        return self._stored.get(self._ids.get(key, ""))

    def keep(self, one: Goal) -> None:
        if one.key is not None:
            self._ids[one.key] = one.id
        super().keep(one)

    def _drop(self, id: str) -> None:
        key = self._stored[id].key
        if key is not None:
            self._ids.pop(key, None)
            self._dropped[key] = None
            while len(self._dropped) > MAX_REMEMBERED:
                self._dropped.popitem(last=False)
        super()._drop(id)

    def new_id(self, key: GoalId) -> str:
        """Return the id of a goal in URLs: its own if that is safe and unused, else one derived from it."""
        if _PLAIN.fullmatch(key.id) and key.id not in self._stored and key.id not in self._removed:
            return key.id
        whole = f"{key.action}\0{key.id}".encode("utf-8", "surrogatepass")
        begin = _NOT_PLAIN.sub("-", key.id)[:_MAX_ID_LENGTH].strip("-")
        return f"{begin}-{hashlib.blake2b(whole, digest_size=8).hexdigest()}".lstrip("-")
