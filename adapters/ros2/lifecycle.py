"""Lifecycles: managed nodes, queried with their own services, and followed by their transition events.

A node is queried when it appears, when it reports a transition, and periodically, because events may get lost.
Everything here runs on the ROS thread.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, cast

from msgspec import Struct, field

from rosld.adapters.model import (
    Lifecycle,
    LifecycleState,
    Qos,
    Refused,
    RosError,
    Sent,
    Transition,
    UnknownType,
    freeze,
)
from rosld.adapters.model.plain import MessageFactory
from rosld.adapters.ros2.calls import Calls
from rosld.adapters.ros2.middleware import Names, Participant, Reader
from rosld.adapters.ros2.wait_set import Waiter
from rosld.adapters.thread import Tasks

_STATE = "lifecycle_msgs/srv/GetState"
_TRANSITIONS = "lifecycle_msgs/srv/GetAvailableTransitions"
_CHANGE = "lifecycle_msgs/srv/ChangeState"
_TRANSITION = "lifecycle_msgs/msg/Transition"
_EVENT = "lifecycle_msgs/msg/TransitionEvent"
_EVENTS_QOS = Qos("best_effort", "volatile", "keep_last", 10)
_PATIENCE = 2.0
_SHORT_PATIENCE = 0.5
_FIRST_RETRY = 2.0
_AGAIN = 10.0
_AT_ONCE = 16
_TRIES = 4
"""Maximum number of queries until a node's state is the same before and after."""
_MAX_TRANSITIONS = 64


class _ManagedNode(Struct, eq=False):
    """A managed node: its known lifecycle, and the time of its next query."""

    lifecycle: Lifecycle
    reader: Reader | None = None
    query_at: float = 0.0
    wait: float = _FIRST_RETRY
    is_querying: bool = False

    @property
    def is_underway(self) -> bool:
        """Whether a transition is in progress."""
        return self.lifecycle.state is not None and self.lifecycle.state.is_underway


class Lifecycles(Struct):
    """Lifecycles of all nodes except ours. `changed` is called after changes."""

    participant: Participant
    calls: Calls
    waiter: Waiter
    changed: Callable[[], None]
    by_node: Mapping[str, Lifecycle] = field(default_factory=dict)
    """Lifecycles by node; the same object until one changes."""
    _managed: dict[str, _ManagedNode] = field(default_factory=dict)
    queries: Tasks = field(default_factory=Tasks)
    """Pending queries of nodes."""
    _few: asyncio.Semaphore = field(default_factory=lambda: asyncio.Semaphore(_AT_ONCE))
    _loop: asyncio.AbstractEventLoop = field(default_factory=asyncio.get_running_loop)

    def follow(self, providers: Mapping[str, Names], ours: Iterable[str]) -> None:
        """Set the present nodes (with their services); query those that are new, did not respond, or are due."""
        present = {node for node, services in providers.items() if _is_managed(node, services)} - set(ours)
        for former in self._managed.keys() - present:
            self._leave(self._managed.pop(former))
        now = self._loop.time()
        for node in present:
            entry = self._managed.get(node)
            if entry is None:
                entry = self._managed[node] = self._begin_following(node)
            if not entry.is_querying and now >= entry.query_at:
                self._query_soon(node, entry)
        self._refresh_list()

    async def change(self, node: str, label: str, until: float) -> None:
        """Request a transition of a node; its new state is known when this returns or raises.

        Raises Refused, TimedOut, Unreachable, UnknownType.
        """
        entry = self._managed.get(node)
        if entry is None:
            raise Refused(f"{node} is not a managed node: it has no lifecycle")
        if _available_transition(entry, label) is None:
            await self._refresh(node, entry, until)
        transition = _available_transition(entry, label)
        if transition is None:
            raise Refused(f"{label!r} is not a valid transition of {node} now")
        fields = {"id": transition.id, "label": transition.label}
        transition_message = self.calls.messages.make_message(_TRANSITION, fields)
        try:
            answer = await self._call(node, "change_state", _CHANGE, {"transition": transition_message}, until)
        finally:
            entry.query_at = 0.0
        try:
            await self._learn(node, entry, until)
        except RosError as error:  # the transition may have been made nevertheless
            self._note_silence(entry, error)
        if not answer.success:
            raise Refused(f"{node} did not make the transition {label!r}", sent=Sent.YES)

    async def _refresh(self, node: str, entry: _ManagedNode, until: float) -> None:
        """Query a node's state, without waiting for a node in transition, which may not respond."""
        if not entry.is_underway:
            await self._learn(node, entry, until)
            return
        try:
            await self._learn(node, entry, min(until, self._loop.time() + _SHORT_PATIENCE))
        except RosError:
            pass  # its state is known from events

    def close(self) -> None:
        """Stop querying and following nodes."""
        self.queries.cancel()
        for entry in self._managed.values():
            self._leave(entry)
        self._managed.clear()

    # Events

    def _begin_following(self, node: str) -> _ManagedNode:
        """Return a new managed node, followed from now on if its types are known here."""
        problem = self.calls.messages.class_problem(_STATE)
        if problem is not None:
            return _ManagedNode(Lifecycle(f"{node}/change_state", unknown=problem), query_at=float("inf"))
        entry = _ManagedNode(Lifecycle(f"{node}/change_state"))
        try:
            entry.reader = self.participant.reader(f"{node}/transition_event", _EVENT, _EVENTS_QOS)
        except Exception:  # any error of the middleware about the name: the node is only queried
            return entry
        self._arm(node, entry)
        return entry

    def _arm(self, node: str, entry: _ManagedNode) -> None:
        if entry.reader is not None:
            self.waiter.arm(entry.reader.handle, "reader", partial(self._take, node, entry))

    def _take(self, node: str, entry: _ManagedNode) -> None:
        """Process events. A transition is shown at once, because the node may not respond during it."""
        if _take_events(entry, self.calls.messages):
            if entry.is_underway:
                self._refresh_list()
            if not entry.is_querying:
                self._query_soon(node, entry)
        self._arm(node, entry)

    def _leave(self, entry: _ManagedNode) -> None:
        reader, entry.reader = entry.reader, None
        if reader is not None:
            self.waiter.disarm(reader.handle)
            reader.close()

    # Queries

    def _query_soon(self, node: str, entry: _ManagedNode) -> None:
        entry.is_querying = True
        self.queries.begin(self._query(node, entry))

    async def _query(self, node: str, entry: _ManagedNode) -> None:
        try:
            async with self._few:
                await self._learn(node, entry, self._loop.time() + _PATIENCE)
        except (RosError, ValueError) as error:
            entry.query_at = self._loop.time() + entry.wait
            entry.wait = min(2 * entry.wait, _AGAIN)
            self._note_silence(entry, error)
        else:
            entry.query_at, entry.wait = self._loop.time() + _AGAIN, _FIRST_RETRY
        finally:
            entry.is_querying = False
        self._refresh_list()

    def _note_silence(self, entry: _ManagedNode, error: Exception) -> None:
        """Record that a node does not respond, unless it is in transition."""
        if not entry.is_underway:
            why = error.sentence if isinstance(error, RosError) else error
            words = f"it does not report the state of its lifecycle: {why}"
            entry.lifecycle = replace(entry.lifecycle, transitions=(), unknown=words)

    async def _learn(self, node: str, entry: _ManagedNode, until: float) -> None:
        """Query a node's state and its transitions consistently. Raises what calls raise."""
        for _ in range(_TRIES):
            _take_events(entry, self.calls.messages)
            now, possible = await asyncio.gather(
                self._call(node, "get_state", _STATE, {}, until),
                self._call(node, "get_available_transitions", _TRANSITIONS, {}, until),
            )
            state = _state(now.current_state)
            offered = list(possible.available_transitions)[:_MAX_TRANSITIONS]
            is_same = all(each.start_state.id == state.id for each in offered)
            if not _take_events(entry, self.calls.messages) and is_same:
                break
        legal = {} if state.is_underway else {each.transition.label: each for each in reversed(offered)}
        transitions = tuple(
            Transition(each.transition.label, each.transition.id, _state(each.goal_state))
            for each in sorted(legal.values(), key=lambda each: (each.transition.id, each.transition.label))
            if each.transition.label and each.start_state.id == state.id
        )
        entry.lifecycle = Lifecycle(entry.lifecycle.service, state, transitions)
        self._refresh_list()

    async def _call(self, node: str, service: str, type: str, fields: dict[str, object], until: float) -> Any:
        request = self.calls.messages.make_message(type, fields, "Request")
        return cast(Any, await self.calls.call(f"{node}/{service}", type, request, until))

    def _refresh_list(self) -> None:
        lifecycles = {node: entry.lifecycle for node, entry in sorted(self._managed.items())}
        if lifecycles != self.by_node:
            self.by_node = freeze(lifecycles)
            self.changed()


def _is_managed(node: str, services: Names) -> bool:
    return _STATE in services.get(f"{node}/get_state", ()) and _TRANSITIONS in services.get(
        f"{node}/get_available_transitions", ()
    )


def _take_events(entry: _ManagedNode, messages: MessageFactory) -> bool:
    """Process transition events of a node; return whether there were any."""
    has_events = False
    while entry.reader is not None and (message := entry.reader.take()) is not None:
        try:
            event = cast(Any, messages.deserialize(_EVENT, message.data))
        except (ValueError, UnknownType):
            continue
        has_events = True
        entry.lifecycle = replace(entry.lifecycle, state=_state(event.goal_state), transitions=(), unknown=None)
    return has_events


def _state(message: Any) -> LifecycleState:
    return LifecycleState(message.label, message.id)


def _available_transition(entry: _ManagedNode, label: str) -> Transition | None:
    return next((each for each in entry.lifecycle.transitions if each.label == label), None)
