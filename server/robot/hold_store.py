"""Holds: a message published periodically while its holder renews the lease, and a final message after that.

`schedule.py` computes the times. If a publish is still running when the next one is due, that one is skipped, so that
nothing ever queues up.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import time
from collections import OrderedDict
from collections.abc import Container, Iterator, Sequence
from typing import NamedTuple

from msgspec import Struct
from msgspec.structs import replace

from rosld.adapters.model import Encoding, Kind, Message, MessageSchema, RosError
from rosld.ontology.neutral_message import is_unstamped, with_stamp
from rosld.server.auth.rules import Agent
from rosld.server.http.problem import Problem, one_line
from rosld.server.receipts.audit import new_identifier
from rosld.server.robot.audited_adapter import AuditedAdapter
from rosld.server.robot.hold_notes import HoldNote, HoldNotes
from rosld.server.robot.interlock import Holder
from rosld.server.robot.publication import require_rate
from rosld.server.robot.schedule import LeaseExpired, Publish, Schedule, Wait
from rosld.server.robot.session import Session
from rosld.server.robot.write_policy import PublishLimiter, denied_reason
from rosld.server.runtime.dry_run import end_dry_run
from rosld.server.runtime.tasks import Signal, loop_time

_REMEMBERED = 1000
_LAST_SECONDS = 1.0
"""Seconds to retry the publish of the final message."""
_RETRY_SECONDS = 0.1
_LONGEST_PUBLISH = 0.5

_log = logging.getLogger("rosld")


class HeldMessage(Struct, frozen=True, eq=False):
    """A message to publish, encoded in advance unless it is stamped with the time of each publish.

    `passes_stop`: it is published even while the robot is stopped.
    """

    schema: MessageSchema
    message: Message
    data: bytes
    is_stamped: bool = False
    passes_stop: bool = False

    def encode_at(self, now_ns: int, encoding: Encoding) -> bytes:
        """Return the bytes to publish at a time, in nanoseconds after the epoch."""
        if not self.is_stamped:
            return self.data
        return self.schema.codec.encode(with_stamp(self.schema, self.message, now_ns), encoding)


def held_message(
    schema: MessageSchema, message: Message, encoding: Encoding, *, restamp: bool, clock: bool
) -> HeldMessage:
    """Return a message to hold. Raises ValueError if it cannot be encoded.

    Each publish stamps its header if it has no stamp, or if `restamp`; never without a `clock`, because wall-clock time
    is meaningless under simulated time.
    """
    is_stamped = clock and (restamp or is_unstamped(schema, message))
    return HeldMessage(schema, message, schema.codec.encode(message, encoding), is_stamped)


class Hold(Struct, frozen=True, eq=False):
    """A hold: immutable, replaced by its next state. `rate` is in Hz, `lease` in seconds; times are wall-clock ns.

    `is_timed`: the lease lasts as long as the requested duration, so that it needs no renewal. `release_message` is
    published at the end, None for none; `release_requested` is its description in the request: zero, none, or a URL.
    `until_ns` is the end of the lease, None while a stream keeps it alive. `last_error` is the error of the latest
    publish.
    """

    id: str
    topic: str
    holder: Agent
    rate: float
    lease: float
    message: HeldMessage
    release_message: HeldMessage | None
    release_requested: str
    created_ns: int
    until_ns: int | None
    is_timed: bool = False
    last_error: str | None = None


class InterruptedHold(NamedTuple):
    """A hold of a killed rosld, and its outcome in words."""

    note: HoldNote
    words: str


class HoldEnded(LookupError):
    """The hold has ended; the text is the reason."""


class Holds:
    """The holds of one robot; belongs to the server's loop."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._running: dict[str, _RunningHold] = {}
        self._ended: OrderedDict[str, str] = OrderedDict()
        self._closed: str | None = None
        self.notes = HoldNotes(session.settings.data)
        self.interrupted: dict[str, InterruptedHold] = {}
        """Holds of a killed rosld, by their ids."""
        self.revision = 0
        self.changes = Signal()
        session.changes.watch(self.end_refused)

    def all(self) -> Sequence[Hold]:
        """Return the holds, oldest first."""
        return [each.hold for each in self._running.values()]

    def find_by_topic(self, topic: str) -> Hold | None:
        """Return the hold on a topic, or None."""
        return next((each.hold for each in self._running.values() if each.hold.topic == topic), None)

    def find(self, id: str) -> Hold:
        """Return a hold by its id. Raises HoldEnded with the reason for an ended hold, KeyError for an unknown one."""
        if id in self._ended:
            raise HoldEnded(self._ended[id])
        return self._running[id].hold

    def topic_of(self, id: str) -> str | None:
        """Return the topic of a hold, "" for an ended hold, None for an unknown one (thread-safe)."""
        running = self._running.get(id)
        return running.hold.topic if running is not None else "" if id in self._ended else None

    async def start(self, hold: Hold) -> Hold:
        """Publish the message of a new hold for the first time, and start the hold.

        Raises, without a hold, TopicHeld, Stopped, a 429 Problem if the topic is published to too often, and what the
        adapter raises.
        """
        session, interlock = self._session, self._session.interlock
        self._require_passage(hold.message)
        interlock.require_free(hold.topic)
        if self._closed is not None:
            raise Problem(503, f"No hold can be started: {self._closed}.")
        require_rate(session.limiter, hold.topic)
        end_dry_run()
        holder = interlock.held[hold.topic] = Holder(hold.holder.name, session.space.hold(hold.id))
        running = _RunningHold(self, session.adapter, session.limiter, hold)
        try:
            await self.notes.begin(self._note(hold))
            await running.publish(loop_time() + session.settings.publish_wait)
            self._require_passage(hold.message)
            if self._closed is not None:
                raise Problem(503, f"No hold can be started: {self._closed}.")
        except BaseException:
            if interlock.held.get(hold.topic) is holder:
                del interlock.held[hold.topic]
            self.notes.remove(hold.id)
            raise
        finally:
            session.announce_write(Kind.TOPIC, hold.topic)
        self._running[hold.id] = running
        running.begin()
        self.on_changed(hold)
        self.end_refused()
        return running.hold

    def _require_passage(self, message: HeldMessage) -> None:
        """Raise Stopped while the robot is stopped, except for a message that stops it."""
        if not message.passes_stop:
            self._session.interlock.require_open()

    def renew(self, id: str, changed: Hold) -> Hold:
        """Renew the lease, and continue with the message and settings of `changed`. Raises as `find`, and Stopped."""
        self.find(id)
        self._require_passage(changed.message)
        end_dry_run()
        running = self._running[id]
        running.change(changed)
        self.notes.change(self._note(changed))
        self.on_changed(running.hold)
        return running.hold

    @contextlib.contextmanager
    def keep_alive(self, id: str) -> Iterator[None]:
        """Suspend the lease within the context; the hold ends with the last of these contexts."""
        running = self._running.get(id)
        if running is None:
            yield
            return
        running.keep()
        self.on_changed(running.hold)
        try:
            yield
        finally:
            if running.let_go():
                self.end(id, "its holder's stream ended")

    def end(self, id: str, why: str) -> asyncio.Task[None] | None:
        """End a hold at once; return the task that publishes its final message, None if the hold had ended before."""
        end_dry_run()
        running = self._running.get(id)
        return None if running is None else running.end(why)

    def end_all(self, why: str, silent: Container[str] = ()) -> Sequence[tuple[Hold, asyncio.Task[None]]]:
        """End every hold at once; those on the topics `silent` without their final message."""
        running = list(self._running.values())
        return [(each.hold, each.end(why, is_silent=each.hold.topic in silent)) for each in running]

    def end_refused(self) -> None:
        """End the holds that could not start in the current graph, because another node publishes on their topic."""
        graph, permitted = self._session.graph, self._session.settings.allow_publish
        for hold in self.all():
            topic = graph.topics.get(hold.topic)
            why = None if topic is None else denied_reason(topic, graph, permitted, needs_subscriber=False)
            if why is not None:
                _log.warning("the hold on %s ends: %s", hold.topic, why)
                self._running[hold.id].end(f"it is no longer permitted. {why.removesuffix('.')}")

    def close(self, why: str) -> None:
        """End every hold at once, and refuse new ones."""
        self._closed = why
        self.end_all(why)

    async def wait_closed(self) -> None:
        """Wait until the holds ended by `close` have published their final messages."""
        await asyncio.gather(*(task for _, task in self.end_all("rosld ended")), return_exceptions=True)
        await self.notes.close()

    def on_ended(self, hold: Hold, why: str) -> None:
        """Remove a hold after its final message, and remember the reason of its end."""
        self._running.pop(hold.id, None)
        self._session.interlock.held.pop(hold.topic, None)
        self.notes.remove(hold.id)
        self._remember_end(hold.id, why)
        self._session.announce_write(Kind.TOPIC, hold.topic)
        self.on_changed(hold)

    def on_changed(self, hold: Hold) -> None:
        """Report a change of a hold."""
        self._announce(hold.id, hold.topic)

    def set_interrupted(self, note: HoldNote, words: str) -> None:
        """Record the outcome of a hold of a killed rosld."""
        self.interrupted[note.id] = InterruptedHold(note, words)
        self._remember_end(note.id, words)
        self._announce(note.id, note.topic)

    def _announce(self, id: str, topic: str) -> None:
        self.revision += 1
        self.changes.emit(id)
        self.changes.emit(topic)

    def _remember_end(self, id: str, why: str) -> None:
        self._ended[id] = why
        while len(self._ended) > _REMEMBERED:
            self._ended.popitem(last=False)

    def _note(self, hold: Hold) -> HoldNote:
        last = hold.release_message
        return HoldNote(
            hold.id,
            hold.topic,
            hold.message.schema.ref.name,
            self._session.graph.own_node,
            hold.holder.name,
            hold.rate,
            hold.created_ns,
            hold.release_requested,
            None if last is None else last.data,
        )


def new_hold(
    topic: str,
    holder: Agent,
    rate: float,
    lease: float,
    message: HeldMessage,
    release_message: HeldMessage | None,
    release_requested: str,
    *,
    is_timed: bool = False,
) -> Hold:
    """Return a hold that has not begun."""
    now = time.time_ns()
    return Hold(
        new_identifier(),
        topic,
        holder,
        rate,
        lease,
        message,
        release_message,
        release_requested,
        now,
        now + int(lease * 1e9),
        is_timed,
    )


class _RunningHold:
    """An active hold, with one timer and at most one publish under way."""

    def __init__(self, holds: Holds, adapter: AuditedAdapter, limiter: PublishLimiter, hold: Hold) -> None:
        self.hold = hold
        self._holds = holds
        self._adapter = adapter
        self._limiter = limiter
        self._loop = asyncio.get_running_loop()
        self._schedule = Schedule(1 / hold.rate, self._loop.time(), math.inf)
        self._timer: asyncio.TimerHandle | None = None
        self._publishing: asyncio.Task[None] | None = None
        self._ending: asyncio.Task[None] | None = None
        self._keepers = 0

    async def publish(self, deadline: float) -> None:
        """Publish the message once. Raises what the interlock and the adapter raise."""
        topic, message = self.hold.topic, self.hold.message
        data = message.encode_at(time.time_ns(), self._adapter.capabilities.encoding)
        await self._adapter.publish_for_hold(
            topic, message.schema.ref, data, deadline=deadline, passes_stop=message.passes_stop
        )

    def begin(self) -> None:
        """Continue after the first publish."""
        now = self._loop.time()
        self._schedule = Schedule(1 / self.hold.rate, now, now + self.hold.lease, tick=1)
        self._renew()

    def change(self, changed: Hold) -> None:
        """Continue as another hold with the same id, and renew the lease; the next message is due as before."""
        self.hold = replace(changed, last_error=self.hold.last_error)
        self._schedule = self._schedule.with_period(1 / changed.rate)
        self._renew()

    def keep(self) -> None:
        """Suspend the lease."""
        self._keepers += 1
        self._renew()

    def let_go(self) -> bool:
        """Undo one `keep`; return whether it was the last."""
        self._keepers -= 1
        return self._keepers == 0

    def _renew(self) -> None:
        lease = self.hold.lease
        expires = math.inf if self._keepers else self._loop.time() + lease
        until = None if self._keepers else time.time_ns() + int(lease * 1e9)
        self.hold = replace(self.hold, until_ns=until)
        self._schedule = self._schedule.with_lease(expires)
        self._tick()

    def _tick(self) -> None:
        """Perform the due step, and schedule the next."""
        if self._ending is not None:
            return
        if self._timer is not None:
            self._timer.cancel()
        step = self._schedule.step(self._loop.time())
        match step:
            case LeaseExpired():
                self.end(f"its {self.hold.lease:g} s elapsed" if self.hold.is_timed else "its lease expired")
                return
            case Publish(after=after):
                self._schedule = after
                # A publish still under way is not joined by another one: this tick is skipped.
                if self._publishing is None or self._publishing.done():
                    self._publishing = self._loop.create_task(self._publish_once())
                until = min(after.due, after.expires)
            case Wait(until=until):
                pass
        self._timer = self._loop.call_at(until, self._tick)

    async def _publish_once(self) -> None:
        failure: str | None = None
        self._limiter.count(self.hold.topic, self._loop.time())
        try:
            await self.publish(self._loop.time() + min(self._schedule.period, _LONGEST_PUBLISH))
        except (RosError, ValueError) as error:
            failure = one_line(str(error))
        except Exception:
            _log.exception("the message of a hold on %s was not published", self.hold.topic)
            failure = "The server failed to publish; see its log."
        if failure != self.hold.last_error:
            self.hold = replace(self.hold, last_error=failure)
            self._holds.on_changed(self.hold)

    def end(self, why: str, *, is_silent: bool = False) -> asyncio.Task[None]:
        """Stop publishing, except for the final message unless `is_silent`. Idempotent."""
        if self._ending is None:
            if self._timer is not None:
                self._timer.cancel()
            if self._publishing is not None:
                self._publishing.cancel()
            self._ending = self._loop.create_task(self._end(why, is_silent=is_silent))
        return self._ending

    async def _end(self, why: str, *, is_silent: bool) -> None:
        try:
            if not is_silent:
                await self._publish_release(why)
        finally:
            self._holds.on_ended(self.hold, why)

    async def _publish_release(self, why: str) -> None:
        then, topic = self.hold.release_message, self.hold.topic
        if then is None:
            return
        encoding = self._adapter.capabilities.encoding
        self._limiter.count(topic, self._loop.time())  # published regardless of the rate; later ones wait instead
        deadline = self._loop.time() + _LAST_SECONDS
        while True:
            try:
                data = then.encode_at(time.time_ns(), encoding)
                await self._adapter.publish_always(topic, then.schema.ref, data, deadline=deadline)
                return
            except (RosError, ValueError) as error:
                if self._loop.time() + _RETRY_SECONDS >= deadline:
                    _log.error(
                        "the hold on %s ended (%s), but its final message was not published: %s", topic, why, error
                    )
                    raise
            await asyncio.sleep(_RETRY_SECONDS)
