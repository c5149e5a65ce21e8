"""Actions: goals are sent, followed and canceled with the services and topics of an action.

Results are requested by the id of a goal, so those of other clients' goals are available, too, as long as the server
stores them. Everything here runs on the ROS thread.
"""

from __future__ import annotations

import asyncio
import math
import secrets
import time
from collections.abc import Callable
from functools import partial
from typing import Any, cast

from msgspec import Struct, field

from rosld.adapters.base import Sink
from rosld.adapters.model import (
    GOAL_STATUSES,
    Action,
    GoalEvent,
    GoalId,
    GoalStatus,
    Graph,
    NotFound,
    Qos,
    Refused,
    RosError,
    Sent,
    TypeRef,
)
from rosld.adapters.ros2.calls import Calls
from rosld.adapters.ros2.middleware import Participant, Reader
from rosld.adapters.ros2.wait_set import Waiter
from rosld.adapters.thread import Tasks

_STATUS = "action_msgs/msg/GoalStatusArray"
_CANCEL = "action_msgs/srv/CancelGoal"
_CANCELED_NOT = {1: "the server refuses to cancel it", 2: "the server does not know it", 3: "it has ended already"}
_HEAD, _UUID = 4, 16
_FEEDBACK_DEPTH = 32
_RESULT = 5.0
_MATCH_WAIT = 0.5
_STATUS_WAIT = 0.2
_PAUSE = 0.005
_MAX_REMEMBERED = 1000


class _Goal(Struct):
    """A known goal: its status, and whether the request for its result is pending.

    `pending` are events of our own goal from before its acceptance; None after it.
    """

    own: bool
    status: GoalStatus | None = None
    ending: bool = False
    pending: list[GoalEvent] | None = None


class _ActionState(Struct):
    """An action that has followers, or pending goals of ours."""

    name: str
    type: str
    status: Reader
    feedback: Reader
    followers: int = 0
    has_status: bool = False
    goals: dict[str, _Goal] = field(default_factory=dict)

    @property
    def is_needed(self) -> bool:
        """Whether the action has followers or a pending goal of ours."""
        return self.followers > 0 or any(goal.own and not _is_over(goal) for goal in self.goals.values())


class Actions:
    """Actions of a system with the current `graph`; events of their goals are reported to the sink."""

    def __init__(
        self, participant: Participant, calls: Calls, waiter: Waiter, graph: Callable[[], Graph], sink: Sink
    ) -> None:
        self._participant = participant
        self._calls = calls
        self._messages = calls.messages
        self._waiter = waiter
        self._graph = graph
        self._sink = sink
        self._loop = asyncio.get_running_loop()
        self._states: dict[str, _ActionState] = {}
        self._tasks = Tasks()

    async def send(self, action: str, type: TypeRef, goal: bytes, until: float) -> GoalId:
        """Send a goal. Raises Refused if it is rejected, TimedOut, Unreachable, UnknownType, NotFound."""
        existing = self._action(action)
        if existing.type is not None and existing.type.name != type.name:
            raise Refused(f"{action} has the type {existing.type.name}, not {type.name}")
        kind = _type_of(existing)
        try:
            message = self._messages.deserialize(f"{kind}_Goal", goal)
        except ValueError as error:
            raise Refused(f"no goal was sent to {action}: {error}") from error
        state = self._listen(action, kind)
        id = secrets.token_bytes(_UUID)
        state.goals[id.hex()] = entry = _Goal(own=True, pending=[])
        try:
            await self._wait_for_server(state, min(until, self._loop.time() + _MATCH_WAIT))
            fields: dict[str, object] = {"goal_id": self._uuid(id), "goal": message}
            request = self._messages.make_message(f"{kind}_SendGoal", fields, "Request")
            answer = cast(
                Any, await self._calls.call(f"{action}/_action/send_goal", f"{kind}_SendGoal", request, until)
            )
            if not answer.accepted:
                raise Refused(f"{action} rejected the goal; ROS 2 does not provide a reason", sent=Sent.YES)
        except BaseException:
            state.goals.pop(id.hex(), None)
            self._leave(state)
            raise
        entry.status = entry.status or GoalStatus.ACCEPTED
        events, entry.pending = entry.pending or [], None
        for event in (GoalEvent(time.time_ns(), GoalStatus.ACCEPTED, goal=goal, own=True), *events):
            self._event(state, id.hex(), event)
        self._tasks.begin(self._end(state, id.hex(), entry, math.inf))
        return GoalId(action, id.hex())

    async def cancel(self, goal: GoalId, until: float) -> None:
        """Request the cancellation of a goal. Raises Refused, NotFound, TimedOut, Unreachable."""
        self._action(goal.action)
        try:
            id = bytes.fromhex(goal.id)
        except ValueError:
            id = b""
        if len(id) != _UUID or not any(id):  # a zero id cancels all goals (action_msgs/srv/CancelGoal)
            raise NotFound(
                f"{goal.action} has no goal {goal.id!r}: a goal's id is {2 * _UUID} hex digits, not all zero"
            )
        answer = await self._request_cancellation(goal.action, id, until)
        if answer.return_code == 2:
            raise NotFound(f"{goal.action} knows no goal {goal.id}")
        if answer.return_code != 0 or not answer.goals_canceling:
            words = _CANCELED_NOT.get(answer.return_code, "the server refuses to cancel it")
            raise Refused(f"the goal {goal.id} of {goal.action} is not canceled: {words}", sent=Sent.YES)

    async def cancel_all(self, action: str, until: float) -> None:
        """Request the cancellation of all goals of an action, with a zero id and no time (CancelGoal.srv).

        Raises Refused, TimedOut, Unreachable, NotFound.
        """
        self._action(action)
        answer = await self._request_cancellation(action, bytes(_UUID), until)
        if answer.return_code == 1:
            words = _CANCELED_NOT[1]
            raise Refused(f"the goals of {action} are not canceled: {words}", sent=Sent.YES)

    async def _request_cancellation(self, action: str, id: bytes, until: float) -> Any:
        info = self._messages.make_message("action_msgs/msg/GoalInfo", {"goal_id": self._uuid(id)})
        request = self._messages.make_message(_CANCEL, {"goal_info": info}, "Request")
        return await self._calls.call(f"{action}/_action/cancel_goal", _CANCEL, request, until)

    async def follow(self, action: str, until: float) -> Callable[[], None]:
        """Report all goals of an action until the returned function is called. Waits for their current status."""
        state = self._listen(action, _type_of(self._action(action)))
        state.followers += 1
        await self._wait_for_server(state, until)
        enough = min(until, self._loop.time() + _STATUS_WAIT)
        while self._loop.time() < (until if state.has_status else enough):
            if state.has_status and not any(goal.ending for goal in state.goals.values()):
                break
            await asyncio.sleep(_PAUSE)

        def stop() -> None:
            state.followers -= 1
            self._leave(state)

        return stop

    def drop_missing_servers(self) -> None:
        """End the goals of servers that have disappeared."""
        actions = self._graph().actions
        for state in list(self._states.values()):
            action = actions.get(state.name)
            if action is None or not action.servers:
                for id, goal in state.goals.items():
                    if not goal.own and not _is_over(goal) and not goal.ending:
                        goal.status = GoalStatus.LOST
                        words = "its action server went away"
                        self._event(state, id, GoalEvent(time.time_ns(), GoalStatus.LOST, words))
                state.has_status = False

    def close(self) -> None:
        """Stop following all actions."""
        self._tasks.cancel()
        for state in list(self._states.values()):
            self._close(state)
        self._states.clear()

    def _action(self, name: str) -> Action:
        action = self._graph().actions.get(name)
        if action is None:
            raise NotFound(f"there is no action {name}")
        return action

    def _listen(self, name: str, type: str) -> _ActionState:
        state = self._states.get(name)
        if state is None:
            latched = Qos("reliable", "transient_local", "keep_last", 1)
            volatile = Qos("best_effort", "volatile", "keep_last", _FEEDBACK_DEPTH)
            status = self._participant.reader(f"{name}/_action/status", _STATUS, latched)
            feedback = self._participant.reader(f"{name}/_action/feedback", f"{type}_FeedbackMessage", volatile)
            state = self._states[name] = _ActionState(name, type, status, feedback)
            self._arm(state, status, self._take_status)
            self._arm(state, feedback, self._take_feedback)
        return state

    def _leave(self, state: _ActionState) -> None:
        if not state.is_needed and self._states.get(state.name) is state:
            del self._states[state.name]
            self._close(state)

    def _close(self, state: _ActionState) -> None:
        for reader in (state.status, state.feedback):
            self._waiter.disarm(reader.handle)
            reader.close()

    async def _wait_for_server(self, state: _ActionState, until: float) -> None:
        """Wait for the server's topics, so that no message about a goal is missed."""
        while not (state.status.publishers() and state.feedback.publishers()) and self._loop.time() < until:  # noqa: ASYNC110
            await asyncio.sleep(_PAUSE)

    def _arm(self, state: _ActionState, reader: Reader, take: Callable[[_ActionState], None]) -> None:
        self._waiter.arm(reader.handle, "reader", partial(self._take_and_rearm, state, reader, take))

    def _take_and_rearm(self, state: _ActionState, reader: Reader, take: Callable[[_ActionState], None]) -> None:
        if self._states.get(state.name) is state:
            take(state)
            self._arm(state, reader, take)

    def _take_status(self, state: _ActionState) -> None:
        message = None
        while (newer := state.status.take()) is not None:
            message = newer
        if message is None:
            return
        state.has_status = True
        for each in cast(Any, self._messages.deserialize(_STATUS, message.data)).status_list:
            status = GOAL_STATUSES.get(each.status)
            if status is not None:
                self._note_status(state, bytes(each.goal_info.goal_id.uuid).hex(), status)

    def _note_status(self, state: _ActionState, id: str, status: GoalStatus) -> None:
        goal = state.goals.get(id)
        if goal is None:
            if not state.followers:
                return
            if len(state.goals) >= _MAX_REMEMBERED:
                del state.goals[next(iter(state.goals))]
            goal = state.goals[id] = _Goal(own=False)
        if _is_over(goal) or goal.ending or goal.status is status:
            return
        if not status.is_final:
            goal.status = status
            self._event(state, id, GoalEvent(time.time_ns(), status, own=goal.own))
        elif not goal.own:  # the result of our own goal is requested on its acceptance
            self._tasks.begin(self._end(state, id, goal, self._loop.time() + _RESULT, status))

    def _take_feedback(self, state: _ActionState) -> None:
        while (message := state.feedback.take()) is not None:
            id = message.data[_HEAD : _HEAD + _UUID].hex()
            goal = state.goals.get(id)
            if goal is not None and not _is_over(goal):
                # Removing 16 bytes preserves the alignment.
                feedback = message.data[:_HEAD] + message.data[_HEAD + _UUID :]
                self._event(state, id, GoalEvent(message.received_ns, feedback=feedback, own=goal.own))

    async def _end(
        self, state: _ActionState, id: str, goal: _Goal, until: float, final: GoalStatus | None = None
    ) -> None:
        """Report the end of a goal, with its result if the server returns it."""
        goal.ending = final is not None
        words = result = None
        status = final or GoalStatus.LOST
        try:
            fields = {"goal_id": self._uuid(bytes.fromhex(id))}
            request = self._messages.make_message(f"{state.type}_GetResult", fields, "Request")
            name = f"{state.name}/_action/get_result"
            answer = cast(Any, await self._calls.call(name, f"{state.type}_GetResult", request, until))
            if answer.status in GOAL_STATUSES:
                status = GOAL_STATUSES[answer.status]
                result = self._messages.serialize(answer.result, f"{state.type}_Result")
            elif final is None:
                words = "its action server no longer knows it"
        except (RosError, ValueError) as error:
            words = f"its result is not known: {error}" if final else f"its action server went away: {error}"
        goal.ending, goal.status = False, status
        self._event(state, id, GoalEvent(time.time_ns(), status, words, result=result, own=goal.own))
        self._leave(state)

    def _uuid(self, id: bytes) -> object:
        return self._messages.make_message("unique_identifier_msgs/msg/UUID", {"uuid": list(id)})

    def _event(self, state: _ActionState, id: str, event: GoalEvent) -> None:
        goal = state.goals.get(id)
        if goal is not None and goal.pending is not None:
            goal.pending.append(event)
            return
        self._sink.goal_changed(GoalId(state.name, id), event)


def _is_over(goal: _Goal) -> bool:
    return goal.status is not None and goal.status.is_final


def _type_of(action: Action) -> str:
    if action.type is None or action.unusable is not None:
        raise Refused(f"the action {action.name} cannot be used: {action.unusable or 'its type is not known'}")
    return action.type.name
