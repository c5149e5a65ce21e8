"""Actions: long-running tasks with a goal, feedback on the way and a result at the end."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from rosld.adapters.model.schema import TypeRef


class GoalStatus(Enum):
    """How a goal stands. The words are action_msgs/GoalStatus'; actionlib's states are told in them.

    actionlib: PENDING is ACCEPTED, ACTIVE is EXECUTING, PREEMPTING and RECALLING are CANCELING, PREEMPTED and RECALLED
    are CANCELED. LOST: the server is gone, or no longer knows the goal.
    """

    ACCEPTED = "accepted"
    EXECUTING = "executing"
    CANCELING = "canceling"
    SUCCEEDED = "succeeded"
    CANCELED = "canceled"
    ABORTED = "aborted"
    REJECTED = "rejected"
    LOST = "lost"

    @property
    def is_final(self) -> bool:
        """Whether nothing comes after it."""
        return self not in (GoalStatus.ACCEPTED, GoalStatus.EXECUTING, GoalStatus.CANCELING)

    @property
    def is_settled(self) -> bool:
        """Whether it has ended as its server says; a goal that is lost may be pursued still."""
        return self.is_final and self is not GoalStatus.LOST


@dataclass(frozen=True, slots=True)
class Action:
    """An action: its type, the nodes that serve it and those that send goals; `unusable` says why no goal can be sent.

    Its inner topics and services are in the graph as well: under hidden names in ROS 2, where none of them is called.
    """

    name: str
    type: TypeRef | None = None
    servers: tuple[str, ...] = ()
    clients: tuple[str, ...] = ()
    unusable: str | None = None


@dataclass(frozen=True, slots=True)
class GoalId:
    """A goal of an action: `id` is what the action server knows it by (ROS 1: any text; ROS 2: 32 hex digits)."""

    action: str
    id: str


@dataclass(frozen=True, slots=True)
class GoalEvent:
    """What became known of a goal: any of its status, the server's words, the latest feedback, the result.

    `feedback` and `result` are messages of the action's type in the adapter's encoding. `received_ns` is wall-clock
    time. `own`: it was sent by rosld.
    """

    received_ns: int
    status: GoalStatus | None = None
    words: str | None = None
    feedback: bytes | None = None
    result: bytes | None = None
    goal: bytes | None = None
    own: bool = False
