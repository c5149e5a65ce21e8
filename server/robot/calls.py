"""Service calls: resources that outlive their requests, limited in number and age."""

from __future__ import annotations

import asyncio
import hashlib
import time
from collections import OrderedDict
from collections.abc import Callable, Sequence
from enum import Enum

from msgspec import Struct
from msgspec.structs import replace

from rosld.adapters.base import Adapter
from rosld.adapters.model import Message, Refused, RosError, Sent, ServiceSchema, TimedOut
from rosld.server.http.problem import one_line
from rosld.server.receipts.audit import Sender, new_identifier, record_step
from rosld.server.runtime.dry_run import end_dry_run, is_dry_run
from rosld.server.runtime.tasks import Signal, end_tasks


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


class IdempotencyKeyReused(ValueError):
    """An Idempotency-Key was used again with another request."""


class Gone(LookupError):
    """The call existed but is no longer stored."""


_REMEMBERED_IDS = 10_000
LATE_SECONDS = 60.0
"""Seconds after its deadline during which a response is still accepted."""


class Calls:
    """The calls made through rosld: each continues when its caller stops waiting, and accepts a late response.

    `on_ended` is called with the service when a call has ended, before its caller continues.
    """

    def __init__(self, adapter: Adapter, on_ended: Callable[[str], None], *, limit: int, age: float) -> None:
        self._adapter = adapter
        self._settled = on_ended
        self._limit = limit
        self._age_ns = int(age * 1e9)
        self._calls: OrderedDict[str, Call] = OrderedDict()
        self._removed: OrderedDict[str, None] = OrderedDict()
        self._running: set[asyncio.Task[RosError | None]] = set()
        self._keyed: OrderedDict[tuple[str, str], tuple[bytes, asyncio.Task[CallOutcome]]] = OrderedDict()
        self.revision = 0
        self.changes = Signal()

    def all(self) -> Sequence[Call]:
        """Return the stored calls, oldest first."""
        self._forget_old()
        return list(self._calls.values())

    def find(self, id: str) -> Call:
        """Return a call by its id. Raises Gone for a deleted or expired call, KeyError for an unknown one."""
        self._forget_old()
        if id in self._removed:
            raise Gone(id)
        return self._calls[id]

    def service_of(self, id: str) -> str | None:
        """Return the service of a call, "" for a removed call, None for an unknown one (thread-safe)."""
        call = self._calls.get(id)
        return call.service if call is not None else "" if id in self._removed else None

    def delete(self, id: str) -> None:
        """Remove a call; the response of a running one is dropped. Raises as `find`."""
        record_step(f"forget the call {self.find(id).id}")
        end_dry_run()
        self._drop(id)

    async def call(
        self,
        service: str,
        schema: ServiceSchema,
        request: Message,
        *,
        deadline: float,
        sender: Sender | None = None,
    ) -> CallOutcome:
        """Call and wait until `deadline`; the call continues after that, and after its caller has disconnected.

        Raises ValueError, with nothing sent, if the request cannot be encoded. A dry run stores no call, and raises
        what the adapter raises.
        """
        data = schema.request.codec.encode(request, self._adapter.capabilities.encoding)
        if is_dry_run():
            await self._adapter.call(service, schema.ref, data, deadline=deadline)
        call = Call(new_identifier(), service, schema, request, time.time_ns(), sender=sender)
        self._keep(call)
        loop = asyncio.get_running_loop()
        settled = loop.create_task(self._settle(call, data, deadline + LATE_SECONDS))
        self._running.add(settled)
        settled.add_done_callback(self._running.discard)
        done, _ = await asyncio.wait({settled}, timeout=max(0.0, deadline - loop.time()))
        if done:
            return CallOutcome(self._calls.get(call.id, call), settled.result())
        self._replace(call, CallState.UNKNOWN)
        self._settled(service)
        late = TimedOut(f"{service} has not responded yet; follow the call for its outcome.", sent=Sent.YES)
        return CallOutcome(self._calls.get(call.id, call), late)

    async def call_idempotent(
        self,
        key: str,
        service: str,
        schema: ServiceSchema,
        request: Message,
        body: bytes,
        *,
        deadline: float,
        sender: Sender | None = None,
    ) -> CallOutcome:
        """Call as `call` does, but return the outcome of the first call for a second one with the same key.

        Raises IdempotencyKeyReused if the requests differ.
        """
        digest = hashlib.blake2b(body).digest()
        known = self._keyed.get((service, key))
        if known is not None and known[0] != digest:
            raise IdempotencyKeyReused(key)
        if known is None and is_dry_run():
            return await self.call(service, schema, request, deadline=deadline)
        if known is None:
            making = asyncio.get_running_loop().create_task(
                self.call(service, schema, request, deadline=deadline, sender=sender)
            )
            known = self._keyed[(service, key)] = (digest, making)
            while len(self._keyed) > self._limit:
                self._keyed.popitem(last=False)
        outcome = await asyncio.shield(known[1])
        return CallOutcome(self._calls.get(outcome.call.id, outcome.call), outcome.error)

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
        if call.id in self._calls:
            self._calls[call.id] = replace(
                call, state=state, response=response, answered_ns=time.time_ns(), words=one_line(words) or None
            )
            self._revise()

    def _keep(self, call: Call) -> None:
        self._calls[call.id] = call
        self._revise()
        while len(self._calls) > self._limit:
            self._drop(next(iter(self._calls)))

    def _revise(self) -> None:
        self.revision += 1
        self.changes.emit()

    def _drop(self, id: str) -> None:
        self._calls.pop(id, None)
        self._removed[id] = None
        self._revise()
        while len(self._removed) > _REMEMBERED_IDS:
            self._removed.popitem(last=False)

    def _forget_old(self) -> None:
        horizon = time.time_ns() - self._age_ns
        while self._calls and next(iter(self._calls.values())).created_ns < horizon:
            self._drop(next(iter(self._calls)))


def _state_of(error: RosError) -> CallState:
    if isinstance(error, Refused):
        return CallState.REFUSED
    if isinstance(error, TimedOut) or error.sent is not Sent.NO:
        return CallState.UNKNOWN
    return CallState.NOT_SENT
