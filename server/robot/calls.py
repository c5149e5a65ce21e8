"""Service calls: resources that outlive their requests, limited in number and age."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Sequence
from enum import Enum

from msgspec import Struct
from msgspec.structs import replace

from rosld.adapters.base import Adapter
from rosld.adapters.model import Message, Refused, RosError, Sent, ServiceSchema, TimedOut
from rosld.server.http.problem import one_line
from rosld.server.receipts.audit import Sender, new_identifier
from rosld.server.robot.limited_store import LimitedStore
from rosld.server.runtime.dry_run import is_dry_run
from rosld.server.runtime.tasks import end_tasks


class CallState(Enum):
    """State of a call; the values are terms of the vocabulary."""

    RUNNING = "Running"
    SUCCEEDED = "Succeeded"
    FAILED = "Failed"
    REFUSED = "Refused"
    UNKNOWN = "OutcomeUnknown"
    NOT_SENT = "NotSent"


class Call(Struct, frozen=True, eq=False):
    """A call: immutable, replaced by its next state. Times are wall-clock nanoseconds."""

    id: str
    service: str
    schema: ServiceSchema
    request: Message
    created_ns: int
    state: CallState = CallState.RUNNING
    response: Message | None = None
    answered_ns: int | None = None
    words: str | None = None
    sender: Sender | None = None


class CallOutcome(Struct, frozen=True):
    """The state of a call in the response to its caller, and the error if it failed."""

    call: Call
    error: RosError | None


class UnreadableResponse(RosError):
    """The node answered with bytes that are not a response of the service's type."""


LATE_SECONDS = 60.0
"""Seconds after its deadline during which a response is still accepted."""


class Calls(LimitedStore[Call]):
    """The calls made through rosld: each continues when its caller stops waiting, and accepts a late response.

    `on_ended` is called with the service when a call has ended, before its caller continues.
    """

    word = "call"

    def __init__(self, adapter: Adapter, on_ended: Callable[[str], None], *, limit: int, age: float) -> None:
        super().__init__(limit, age)
        self._adapter = adapter
        self._settled = on_ended
        self._running: set[asyncio.Task[RosError | None]] = set()

    def subjects(self, one: Call) -> Sequence[str]:
        return one.id, one.service

    def changed_ns(self, one: Call) -> int:
        return one.created_ns

    async def call(
        self,
        service: str,
        schema: ServiceSchema,
        request: Message,
        *,
        deadline: float,
        sender: Sender | None = None,
        once: tuple[str, bytes] | None = None,
    ) -> CallOutcome:
        """Call and wait until `deadline`; the call continues after that, and after its caller has disconnected.

        Raises as `send_once`, and ValueError, with nothing sent, if the request cannot be encoded. A dry run stores no
        call, and raises what the adapter raises.
        """
        outcome = await self.send_once(service, once, lambda: self._call(service, schema, request, deadline, sender))
        return CallOutcome(self.get(outcome.call.id) or outcome.call, outcome.error)

    async def _call(
        self, service: str, schema: ServiceSchema, request: Message, deadline: float, sender: Sender | None
    ) -> CallOutcome:
        data = schema.request.codec.encode(request, self._adapter.capabilities.encoding)
        if is_dry_run():
            await self._adapter.call(service, schema.ref, data, deadline=deadline)
        call = Call(new_identifier(), service, schema, request, time.time_ns(), sender=sender)
        self.keep(call)
        loop = asyncio.get_running_loop()
        settled = loop.create_task(self._settle(call, data, deadline + LATE_SECONDS))
        self._running.add(settled)
        settled.add_done_callback(self._running.discard)
        done, _ = await asyncio.wait({settled}, timeout=max(0.0, deadline - loop.time()))
        if done:
            return CallOutcome(call, settled.result())
        self._replace(call, CallState.UNKNOWN)
        self._settled(service)
        late = TimedOut(f"{service} has not responded yet; follow the call for its outcome.", sent=Sent.YES)
        return CallOutcome(call, late)

    async def stop(self) -> None:
        """Stop waiting; running calls are left to the robot."""
        await end_tasks(self._running)

    async def _settle(self, call: Call, data: bytes, deadline: float) -> RosError | None:
        """Wait for the response; return the error if the call failed."""
        try:
            return await self._answer(call, data, deadline)
        finally:
            self._settled(call.service)

    async def _answer(self, call: Call, data: bytes, deadline: float) -> RosError | None:
        try:
            answer = await self._adapter.call(call.service, call.schema.ref, data, deadline=deadline)
            response = call.schema.response.codec.decode(answer, self._adapter.capabilities.encoding)
        except RosError as error:
            self._replace(call, _state_of(error), words=error.words if error.words is not None else error.sentence)
            return error
        except ValueError as error:
            self._replace(call, CallState.UNKNOWN, words=f"the response cannot be read: {error}")
            return UnreadableResponse(f"the response of {call.service} cannot be read: {error}", sent=Sent.YES)
        failed = getattr(response, "success", True) is False
        words = getattr(response, "message", None) if failed else None
        self._replace(call, CallState.FAILED if failed else CallState.SUCCEEDED, response, words)
        return None

    def _replace(self, call: Call, state: CallState, response: Message | None = None, words: object = None) -> None:
        if call.id in self._stored:
            words = one_line(words) or None
            self.keep(replace(call, state=state, response=response, answered_ns=time.time_ns(), words=words))


def _state_of(error: RosError) -> CallState:
    if isinstance(error, Refused):
        return CallState.REFUSED
    if isinstance(error, TimedOut) or error.sent is not Sent.NO:
        return CallState.UNKNOWN
    return CallState.NOT_SENT
