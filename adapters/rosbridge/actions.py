"""Actions of ROS 2 behind rosbridge: goals are sent with the protocol's operations, and followed by status.

The protocol reports feedback and result of rosld's goals by an id of rosld, but neither their acceptance nor
servers' ids: both are read from the status of the action. Results of others' goals are not available.
"""

from __future__ import annotations

import asyncio
import secrets
import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, cast

from msgspec import Struct, field

from rosld.adapters.model import (
    GOAL_STATUSES,
    Action,
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
from rosld.adapters.model.plain import message_of
from rosld.adapters.thread import wait_event

if TYPE_CHECKING:
    from rosld.adapters.rosbridge.system import System

_STATUS = "action_msgs/msg/GoalStatusArray"
_CANCEL = "action_msgs/srv/CancelGoal"
_MAX_REMEMBERED = 1000
_FIRST_STATUS = 0.3


class _Goal(Struct, eq=False):
    """A goal: its id at the action server, once it is known, and its status. `accepted` is for goals of rosld."""

    schema: ActionSchema | None = None
    accepted: asyncio.Future[None] | None = None
    server_id: str | None = None
    status: GoalStatus | None = None

    @property
    def is_over(self) -> bool:
        return self.status is not None and self.status.is_final


class _ActionState(Struct, eq=False):
    """An action that has followers, or pending goals of rosld."""

    name: str
    reader: Any = None
    followers: int = 0
    has_status: asyncio.Event = field(default_factory=asyncio.Event)
    goals: dict[str, _Goal] = field(default_factory=dict)


class Actions:
    """Actions of a system: what `LiveActions` promises."""

    def __init__(self, system: System) -> None:
        self._system = system
        self._client = system.client
        self._states: dict[str, _ActionState] = {}

    async def send(self, action: str, type: TypeRef, goal: bytes, until: float) -> GoalId:
        """Send a goal. Raises Refused if it is rejected, TimedOut, Unreachable, UnknownType, NotFound."""
        existing = self._action(action)
        if existing.type is None or existing.type.name != type.name:
            raise Refused(f"{action} has the type {existing.type and existing.type.name}, not {type.name}")
        schema = await self._client.types.schema(TypeRef(type.name), until)
        if not isinstance(schema, ActionSchema):
            raise UnknownType(f"{type.name} is not an action type")
        try:
            args = self._client.plain(schema.goal, schema.goal.codec.decode(goal, self._client.encoding))
        except ValueError as error:
            raise Refused(f"no goal was sent to {action}: {error}") from error
        loop = asyncio.get_running_loop()
        state = self._listen(action)
        # What is listed by now is not ours. A server that never had a goal lists nothing.
        await wait_event(state.has_status, _FIRST_STATUS)
        state.has_status.set()
        id = secrets.token_hex(16)
        entry = state.goals[id] = _Goal(schema, loop.create_future())
        message = {"op": "send_action_goal", "id": id, "action": action, "action_type": type.name, "args": args}
        try:
            self._client.send({**message, "feedback": True})
            await asyncio.wait_for(cast("asyncio.Future[None]", entry.accepted), max(until - loop.time(), 0.0))
        except BaseException as error:
            state.goals.pop(id, None)
            self._leave(state)
            if isinstance(error, asyncio.TimeoutError):
                raise TimedOut(f"{action} did not accept the goal in time", sent=Sent.MAYBE) from error
            raise
        self._report(state, id, GoalEvent(time.time_ns(), GoalStatus.ACCEPTED, goal=goal, own=True))
        return GoalId(action, id)

    async def cancel(self, goal: GoalId, until: float) -> None:
        """Request the cancellation of a goal. Raises Refused, NotFound, TimedOut, Unreachable."""
        self._action(goal.action)
        state = self._states.get(goal.action)
        entry = state.goals.get(goal.id) if state else None
        if entry is None:
            raise NotFound(f"{goal.action} knows no goal {goal.id!r}")
        if entry.is_over:
            raise Refused(f"the goal {goal.id} of {goal.action} is not canceled: it has ended already")
        if entry.accepted is not None:
            self._client.send({"op": "cancel_action_goal", "id": goal.id, "action": goal.action})
            return
        answer = await self._request_cancellation(goal.action, entry.server_id or goal.id, until)
        if answer.return_code != 0:
            raise Refused(f"the goal {goal.id} of {goal.action} is not canceled", sent=Sent.YES)

    async def cancel_all(self, action: str, until: float) -> None:
        """Request the cancellation of all goals of an action. Raises Refused, TimedOut, Unreachable, NotFound."""
        self._action(action)
        answer = await self._request_cancellation(action, "0" * 32, until)
        if answer.return_code == 1:
            raise Refused(f"the goals of {action} are not canceled: the server refuses it", sent=Sent.YES)

    async def follow(self, action: str, until: float) -> Callable[[], None]:
        """Report all goals of an action until the returned function is called."""
        self._action(action)
        state = self._listen(action)
        state.followers += 1
        await wait_event(state.has_status, min(until - time.monotonic(), _FIRST_STATUS))

        def stop() -> None:
            state.followers -= 1
            self._leave(state)

        return stop

    def end(self) -> None:
        """End the goals of rosld, whose results a lost connection does not bring."""
        for state in list(self._states.values()):
            for id, goal in state.goals.items():
                if goal.accepted is not None and not goal.is_over:
                    self._fail(state, id, goal, Unreachable("the connection was lost", sent=Sent.MAYBE))
            self._leave(state)

    def receive(self, message: Mapping[str, Any]) -> None:
        """Process feedback or the result of a goal of rosld."""
        state = self._states.get(str(message.get("action")))
        id = str(message.get("id"))
        goal = state.goals.get(id) if state else None
        if state is None or goal is None or goal.schema is None or goal.is_over:
            return
        if message["op"] == "action_feedback":
            self._accept(goal)
            feedback = self._bytes(goal.schema.feedback, message.get("values"))
            self._report(state, id, GoalEvent(time.time_ns(), feedback=feedback, own=True))
        elif message.get("result") is False and not isinstance(message.get("values"), Mapping):  # else it has a result
            words = str(message.get("values") or "") or None
            error = Refused(f"{state.name} rejected the goal", words=words, sent=Sent.YES)
            self._fail(state, id, goal, error)
        else:
            self._accept(goal)
            goal.status = GOAL_STATUSES.get(int(message.get("status") or 0), GoalStatus.LOST)
            result = self._bytes(goal.schema.result, message.get("values"))
            event = GoalEvent(time.time_ns(), goal.status, result=result, own=True)
            # The sender learns of the acceptance first, in the next turn of the loop.
            asyncio.get_running_loop().call_soon(self._report, state, id, event)
            asyncio.get_running_loop().call_soon(self._leave, state)

    def _accept(self, goal: _Goal) -> None:
        if goal.accepted is not None and not goal.accepted.done():
            goal.accepted.set_result(None)

    def _fail(self, state: _ActionState, id: str, goal: _Goal, error: Refused | Unreachable) -> None:
        """End a goal that was refused or lost."""
        if goal.accepted is not None and not goal.accepted.done():
            goal.accepted.set_exception(error)
            return
        goal.status = GoalStatus.ABORTED if isinstance(error, Refused) else GoalStatus.LOST
        self._report(state, id, GoalEvent(time.time_ns(), goal.status, error.words or error.sentence, own=True))

    def _bytes(self, schema: Any, values: Any) -> bytes | None:
        try:
            return cast(bytes, schema.codec.encode(message_of(schema, values or {}), self._client.encoding))
        except (ValueError, AttributeError):
            return None

    def _action(self, name: str) -> Action:
        action = self._system.graph.actions.get(name)
        if action is None:
            raise NotFound(f"there is no action {name}")
        if action.unusable is not None:
            raise Refused(f"the action {name} cannot be used: {action.unusable}")
        return action

    async def _request_cancellation(self, action: str, id: str, until: float) -> Any:
        fields = {"goal_info": {"goal_id": {"uuid": list(bytes.fromhex(id))}}}
        request = self._client.messages.make_message(_CANCEL, fields, "Request")
        return await self._client.call(f"{action}/_action/cancel_goal", _CANCEL, request, until)

    def _listen(self, name: str) -> _ActionState:
        state = self._states.get(name)
        if state is None:
            state = self._states[name] = _ActionState(name)
            schema = self._client.messages.schema(_STATUS)
            state.reader = self._system.readers.listen(
                f"{name}/_action/status", lambda data, _: self._take_status(state, schema, data), lambda _: _STATUS
            )
        return state

    def _leave(self, state: _ActionState) -> None:
        is_pursued = any(goal.accepted is not None and not goal.is_over for goal in state.goals.values())
        if not state.followers and not is_pursued and self._states.get(state.name) is state:
            del self._states[state.name]
            self._system.readers.leave(state.reader)

    def _take_status(self, state: _ActionState, schema: Any, data: bytes) -> None:
        try:
            listed = schema.codec.decode(data, self._client.encoding).status_list
        except ValueError:
            return
        by_server_id = {goal.server_id: id for id, goal in state.goals.items() if goal.server_id}
        for each in listed:
            server_id = bytes(each.goal_info.goal_id.uuid).hex()
            status = GOAL_STATUSES.get(each.status)
            if status is None:
                continue
            id = by_server_id.get(server_id) or self._identify(state, server_id)
            self._note_status(state, id, state.goals[id], status)
        state.has_status.set()

    def _identify(self, state: _ActionState, server_id: str) -> str:
        """Return the id of a newly listed goal: that of rosld's oldest goal without one, else the server's."""
        if state.has_status.is_set():
            own = [(id, goal) for id, goal in state.goals.items() if goal.accepted and goal.server_id is None]
            for id, goal in sorted(own, key=lambda each: each[1].is_over):
                goal.server_id = server_id
                self._accept(goal)
                return id
        if len(state.goals) >= _MAX_REMEMBERED:
            del state.goals[next(iter(state.goals))]
        state.goals[server_id] = _Goal(server_id=server_id)
        return server_id

    def _note_status(self, state: _ActionState, id: str, goal: _Goal, status: GoalStatus) -> None:
        is_own = goal.accepted is not None
        if goal.is_over or goal.status is status or (is_own and status.is_final):
            return  # the end of a goal of rosld comes with its result
        is_new = goal.status is None
        goal.status = status
        if is_own and is_new and status is GoalStatus.ACCEPTED:
            return
        event = GoalEvent(time.time_ns(), status, own=is_own)
        if is_own or state.followers:
            asyncio.get_running_loop().call_soon(self._report, state, id, event)

    def _report(self, state: _ActionState, id: str, event: GoalEvent) -> None:
        self._system.sink.goal_changed(GoalId(state.name, id), event)
