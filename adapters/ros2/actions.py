"""Actions: goals are sent, followed and canceled with the services and topics of an action.

Results are requested by the id of a goal, so those of other clients' goals are available, too, as long as the server
stores them. Everything here runs on the ROS thread.
"""

from __future__ import annotations

import asyncio
import math
import secrets
import time
from collections.abc import Callable, Coroutine, Mapping
from functools import partial
from typing import Any, cast

from msgspec import Struct, field

from rosld.adapters.model import Action, GoalEvent, GoalId, GoalStatus, NotFound, Qos, Refused, RosError, Sent
from rosld.adapters.ros2.calls import Calls
from rosld.adapters.ros2.message_classes import deserialize, make_message, serialize
from rosld.adapters.ros2.middleware import Participant, Reader
from rosld.adapters.ros2.wait_set import Waiter

_STATUS = "action_msgs/msg/GoalStatusArray"
_CANCEL = "action_msgs/srv/CancelGoal"
_STATUSES = {
    1: GoalStatus.ACCEPTED,
    2: GoalStatus.EXECUTING,
    3: GoalStatus.CANCELING,
    4: GoalStatus.SUCCEEDED,
    5: GoalStatus.CANCELED,
    6: GoalStatus.ABORTED,
}
_CANCELED_NOT = {
    1: "the server refuses to cancel it",
    2: "the server does not know it",
    3: "it has ended already",
}
_HEAD, _UUID = 4, 16
_FEEDBACK_DEPTH = 32
_RESULT = 5.0
_MATCHED = 0.5
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


class _Line(Struct):
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
    """Actions of a system; `report` is called with events of their goals."""

    def __init__(
        self, participant: Participant, calls: Calls, waiter: Waiter, report: Callable[[GoalId, GoalEvent], None]
    ) -> None:
        self._participant = participant
        self._calls = calls
        self._waiter = waiter
        self._report = report
        self._loop = asyncio.get_running_loop()
        self._lines: dict[str, _Line] = {}
        self._tasks: set[asyncio.Task[None]] = set()

    async def send(self, action: Action, goal: bytes, until: float) -> GoalId:
        """Send a goal. Raises Refused if it is rejected, TimedOut, Unreachable, UnknownType."""
        type = _type_of(action)
        try:
            message = deserialize(f"{type}_Goal", goal)
        except ValueError as error:
            raise Refused(f"no goal was sent to {action.name}: {error}") from error
        line = self._listen(action.name, type)
        id = secrets.token_bytes(_UUID)
        line.goals[id.hex()] = entry = _Goal(own=True, pending=[])
        try:
            await self._wait_for_server(line, min(until, self._loop.time() + _MATCHED))
            fields: dict[str, object] = {"goal_id": _uuid(id), "goal": message}
            request = make_message(f"{type}_SendGoal", fields, "Request")
            answer = cast(
                Any, await self._calls.call(f"{action.name}/_action/send_goal", f"{type}_SendGoal", request, until)
            )
            if not answer.accepted:
                raise Refused(f"{action.name} rejected the goal; ROS 2 gives no reason", sent=Sent.YES)
        except BaseException:
            line.goals.pop(id.hex(), None)
            self._leave(line)
            raise
        entry.status = entry.status or GoalStatus.ACCEPTED
        events, entry.pending = entry.pending or [], None
        for event in (GoalEvent(time.time_ns(), GoalStatus.ACCEPTED, goal=goal, own=True), *events):
            self._event(line, id.hex(), event)
        self._begin(self._end(line, id.hex(), entry, math.inf))
        return GoalId(action.name, id.hex())

    async def cancel(self, goal: GoalId, until: float) -> None:
        """Request the cancellation of a goal. Raises Refused, NotFound, TimedOut, Unreachable."""
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

        Raises Refused, TimedOut, Unreachable.
        """
        answer = await self._request_cancellation(action, bytes(_UUID), until)
        if answer.return_code == 1:
            words = _CANCELED_NOT[1]
            raise Refused(f"the goals of {action} are not canceled: {words}", sent=Sent.YES)

    async def _request_cancellation(self, action: str, id: bytes, until: float) -> Any:
        info = make_message("action_msgs/msg/GoalInfo", {"goal_id": _uuid(id)})
        request = make_message(_CANCEL, {"goal_info": info}, "Request")
        return await self._calls.call(f"{action}/_action/cancel_goal", _CANCEL, request, until)

    async def follow(self, action: Action, until: float) -> Callable[[], None]:
        """Report all goals of an action until the returned function is called. Waits for their current status."""
        line = self._listen(action.name, _type_of(action))
        line.followers += 1
        await self._wait_for_server(line, until)
        enough = min(until, self._loop.time() + _STATUS_WAIT)
        while self._loop.time() < (until if line.has_status else enough):
            if line.has_status and not any(goal.ending for goal in line.goals.values()):
                break
            await asyncio.sleep(_PAUSE)

        def stop() -> None:
            line.followers -= 1
            self._leave(line)

        return stop

    def drop_missing_servers(self, actions: Mapping[str, Action]) -> None:
        """End the goals of servers that have disappeared."""
        for line in list(self._lines.values()):
            action = actions.get(line.name)
            if action is None or not action.servers:
                for id, goal in line.goals.items():
                    if not goal.own and not _is_over(goal) and not goal.ending:
                        goal.status = GoalStatus.LOST
                        words = "its action server went away"
                        self._event(line, id, GoalEvent(time.time_ns(), GoalStatus.LOST, words))
                line.has_status = False

    def close(self) -> None:
        """Stop following all actions."""
        for task in self._tasks:
            task.cancel()
        for line in list(self._lines.values()):
            self._close(line)
        self._lines.clear()

    def _listen(self, name: str, type: str) -> _Line:
        line = self._lines.get(name)
        if line is None:
            latched = Qos("reliable", "transient_local", "keep_last", 1)
            volatile = Qos("best_effort", "volatile", "keep_last", _FEEDBACK_DEPTH)
            status = self._participant.reader(f"{name}/_action/status", _STATUS, latched)
            feedback = self._participant.reader(f"{name}/_action/feedback", f"{type}_FeedbackMessage", volatile)
            line = self._lines[name] = _Line(name, type, status, feedback)
            self._arm(line, status, self._take_status)
            self._arm(line, feedback, self._take_feedback)
        return line

    def _leave(self, line: _Line) -> None:
        if not line.is_needed and self._lines.get(line.name) is line:
            del self._lines[line.name]
            self._close(line)

    def _close(self, line: _Line) -> None:
        for reader in (line.status, line.feedback):
            self._waiter.disarm(reader.handle)
            reader.close()

    async def _wait_for_server(self, line: _Line, until: float) -> None:
        """Wait for the server's topics, so that no message about a goal is missed."""
        while not (line.status.publishers() and line.feedback.publishers()) and self._loop.time() < until:  # noqa: ASYNC110
            await asyncio.sleep(_PAUSE)

    def _arm(self, line: _Line, reader: Reader, take: Callable[[_Line], None]) -> None:
        self._waiter.arm(reader.handle, "reader", partial(self._ready, line, reader, take))

    def _ready(self, line: _Line, reader: Reader, take: Callable[[_Line], None]) -> None:
        try:
            self._loop.call_soon_threadsafe(self._take_and_rearm, line, reader, take)
        except RuntimeError:
            pass  # the thread's event loop has ended

    def _take_and_rearm(self, line: _Line, reader: Reader, take: Callable[[_Line], None]) -> None:
        if self._lines.get(line.name) is line:
            take(line)
            self._arm(line, reader, take)

    def _take_status(self, line: _Line) -> None:
        message = None
        while (newer := line.status.take()) is not None:
            message = newer
        if message is None:
            return
        line.has_status = True
        for each in cast(Any, deserialize(_STATUS, message.data)).status_list:
            status = _STATUSES.get(each.status)
            if status is not None:
                self._note_status(line, bytes(each.goal_info.goal_id.uuid).hex(), status)

    def _note_status(self, line: _Line, id: str, status: GoalStatus) -> None:
        goal = line.goals.get(id)
        if goal is None:
            if not line.followers:
                return
            if len(line.goals) >= _MAX_REMEMBERED:
                del line.goals[next(iter(line.goals))]
            goal = line.goals[id] = _Goal(own=False)
        if _is_over(goal) or goal.ending or goal.status is status:
            return
        if not status.is_final:
            goal.status = status
            self._event(line, id, GoalEvent(time.time_ns(), status, own=goal.own))
        elif not goal.own:  # the result of our own goal is requested on its acceptance
            self._begin(self._end(line, id, goal, self._loop.time() + _RESULT, status))

    def _take_feedback(self, line: _Line) -> None:
        while (message := line.feedback.take()) is not None:
            id = message.data[_HEAD : _HEAD + _UUID].hex()
            goal = line.goals.get(id)
            if goal is not None and not _is_over(goal):
                # Removing 16 bytes preserves the alignment.
                feedback = message.data[:_HEAD] + message.data[_HEAD + _UUID :]
                self._event(line, id, GoalEvent(message.received_ns, feedback=feedback, own=goal.own))

    async def _end(self, line: _Line, id: str, goal: _Goal, until: float, final: GoalStatus | None = None) -> None:
        """Report the end of a goal, with its result if the server returns it."""
        goal.ending = final is not None
        words = result = None
        status = final or GoalStatus.LOST
        try:
            request = make_message(f"{line.type}_GetResult", {"goal_id": _uuid(bytes.fromhex(id))}, "Request")
            name = f"{line.name}/_action/get_result"
            answer = cast(Any, await self._calls.call(name, f"{line.type}_GetResult", request, until))
            if answer.status in _STATUSES:
                status, result = _STATUSES[answer.status], serialize(answer.result)
            elif final is None:
                words = "its action server no longer knows it"
        except (RosError, ValueError) as error:
            words = f"its result is not known: {error}" if final else f"its action server went away: {error}"
        goal.ending, goal.status = False, status
        self._event(line, id, GoalEvent(time.time_ns(), status, words, result=result, own=goal.own))
        self._leave(line)

    def _event(self, line: _Line, id: str, event: GoalEvent) -> None:
        goal = line.goals.get(id)
        if goal is not None and goal.pending is not None:
            goal.pending.append(event)
            return
        self._report(GoalId(line.name, id), event)

    def _begin(self, coroutine: Coroutine[Any, Any, None]) -> None:
        task = self._loop.create_task(coroutine)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)


def _is_over(goal: _Goal) -> bool:
    return goal.status is not None and goal.status.is_final


def _type_of(action: Action) -> str:
    if action.type is None or action.unusable is not None:
        raise Refused(f"the action {action.name} cannot be used: {action.unusable or 'its type is not known'}")
    return action.type.name


def _uuid(id: bytes) -> object:
    return make_message("unique_identifier_msgs/msg/UUID", {"uuid": list(id)})
