"""Publishing of zero on velocity topics, repeatedly for a second, so that moving robots stop.

A base without a watchdog drives on after the last command, so a single lost message would matter; and a single zero
among the commands of another node would have no effect.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time

from msgspec import Struct

from rosld.adapters.base import Watch
from rosld.adapters.model import Kind, RosError, Topic, Unreachable
from rosld.server.robot.hold_store import HeldMessage, held_message
from rosld.server.robot.session import Session
from rosld.server.robot.velocity import commanded_topics, subscribers_of, zero_message
from rosld.server.robot.write_policy import type_conflict
from rosld.server.runtime.tasks import WokenTask, loop_time

RATE, FIRST_RATE = 20.0, 100.0
"""Rates in Hz at which zero is published, later and at first.

A base that discovers a new publisher loses the messages before that: the pauses must be short, because it drives on in
them.
"""
FIRST_SECONDS = 0.3
"""Seconds of publishing at the first rate."""
SECONDS = 1.0
"""Seconds of publishing after the first subscriber received zero."""
_PATIENCE = 2.0
"""Seconds that a response waits for a subscriber to connect, if rosld has not published to it before."""
_TRIES = 10.0
"""Seconds to go on trying to reach a subscriber after the response reported that none was reached.

On a busy machine ROS may take that long, and a late zero still stops the base.
"""
_ALL_SECONDS = 0.5
"""Seconds to wait for the other subscribers, once one received zero."""
_ABREAST = 2
"""Maximum number of concurrent publishes: the first waits for all subscribers, the second for those present."""


class Receivers(Struct, frozen=True):
    """Number of subscribers that received zero, and of all subscribers."""

    subscribers: int
    expected: int


class ZeroPublisher:
    """Publisher of zero on velocity topics; belongs to the server's loop."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._running: dict[str, Repetition] = {}
        self._advertised: set[str] = set()

    async def publish(self, topic: Topic) -> Receivers:
        """Start to publish zero on a topic; return when its subscribers received it.

        Raises Unreachable if none did, ValueError if the type has no zero, and what the adapter raises.
        """
        session, name = self._session, topic.name
        if topic.type is None:
            raise ValueError(type_conflict(topic) or f"the type of {name} is not known")
        schema = await session.schemas.message(topic.type)
        graph = session.graph
        message, encoding = zero_message(schema, session.lifting), session.adapter.capabilities.encoding
        zero = held_message(schema, message, encoding, restamp=True, clock=not graph.simulated_time)
        if name not in session.adapter.published:
            self._advertised.add(name)
        before = self._running.get(name)
        if before is not None and not before.is_received:
            return await before.wait_received()  # stopping the robot again does not make it faster
        if before is not None:
            before.cancel()
        repetition = self._running[name] = Repetition(session, name, zero, subscribers_of(topic, graph))
        return await repetition.wait_received()

    async def wait_received_late(self, topic: str) -> Receivers | None:
        """Wait until a subscriber receives zero after `publish` has failed; return None if none does."""
        repetition = self._running.get(topic)
        return None if repetition is None else await repetition.wait_received_late()

    async def over(self) -> None:
        """Wait until the publishing of zero has ended."""
        running, self._running = list(self._running.values()), {}
        await asyncio.gather(*(each.over() for each in running))

    async def withdraw(self) -> None:
        """Wait until zero was published for its second, and stop advertising the topics advertised only for that.

        A stop is never cut short: a message handed over may not have reached the base yet.
        """
        await self.over()
        if self._running:
            return  # the robot was stopped again meanwhile
        names, self._advertised = self._advertised & self._session.adapter.published, set()
        for name in sorted(names):
            with contextlib.suppress(RosError):
                await self._session.adapter.unadvertise_always(name)


class Repetition:
    """A message on one topic, published repeatedly until a second after a subscriber first received it."""

    def __init__(self, session: Session, topic: str, zero: HeldMessage, expected: int) -> None:
        self._session = session
        self._topic = topic
        self._zero = zero
        self._loop = asyncio.get_running_loop()
        self._until = 0.0
        self._patient_until = 0.0
        self._reached = Receivers(0, expected)
        self._received: asyncio.Future[None] = self._loop.create_future()
        self._received_by_all = asyncio.Event()
        self._error: Exception | None = None
        self._try_longer()
        self._task = self._loop.create_task(self._run())

    async def wait_received(self) -> Receivers:
        """Wait until the message is received; return by how many. Raises Unreachable, or the adapter's last error."""
        if not self._received.done():
            self._try_longer()
            await asyncio.wait([self._received], timeout=_PATIENCE)
        if not self._received.done():
            raise self._reception_error()
        self._received.result()
        with contextlib.suppress(asyncio.TimeoutError, TimeoutError):
            await asyncio.wait_for(self._received_by_all.wait(), _ALL_SECONDS)
        return self._reached

    async def wait_received_late(self) -> Receivers | None:
        """Wait until the message is received, without a time limit; return None if publishing ended before."""
        await asyncio.wait([self._received])
        return self._reached if self._received.exception() is None else None

    @property
    def is_received(self) -> bool:
        """Whether a subscriber received the message, or none is awaited any more."""
        return self._received.done()

    async def over(self) -> None:
        """Wait until the end of the publishing, or of the attempts to reach a subscriber."""
        if not self._received.done() and self._loop.time() >= self._patient_until:
            self.cancel()
        await asyncio.wait([self._task])

    def cancel(self) -> None:
        """Stop publishing."""
        self._task.cancel()

    def _try_longer(self) -> None:
        """Extend the time for a subscriber to connect."""
        now = self._loop.time()
        self._until, self._patient_until = now + _TRIES, now + _PATIENCE

    def _reception_error(self) -> Exception:
        return self._error or Unreachable(f"no subscriber of {self._topic} could be reached")

    async def _run(self) -> None:
        pending: set[asyncio.Task[None]] = set()
        try:
            begun = self._loop.time()
            while (now := self._loop.time()) < self._until:
                pending = {one for one in pending if not one.done()}
                if len(pending) < _ABREAST:
                    pending.add(self._loop.create_task(self._publish()))
                await asyncio.sleep(1 / (FIRST_RATE if now < begun + FIRST_SECONDS else RATE))
        finally:
            for one in pending:
                one.cancel()
            if not self._received.done():
                self._received.set_exception(self._reception_error())
                self._received.exception()  # retrieved, because there may be no waiter

    async def _publish(self) -> None:
        session, zero = self._session, self._zero
        data = zero.encode_at(time.time_ns(), session.adapter.capabilities.encoding)
        session.limiter.count(self._topic, self._loop.time())
        try:
            published = await session.adapter.publish_always(self._topic, zero.schema.ref, data, deadline=self._until)
        except (RosError, ValueError) as error:
            self._error = error
            return
        self._take(published.matched)

    def _take(self, matched: int) -> None:
        """Record the number of subscribers reached."""
        if not matched:
            return
        reached = self._reached
        self._reached = Receivers(max(matched, reached.subscribers), reached.expected)
        if matched >= reached.expected:
            self._received_by_all.set()
        if not self._received.done():
            self._until = self._loop.time() + SECONDS
            self._received.set_result(None)
            self._session.announce_write(Kind.TOPIC, self._topic)


_log = logging.getLogger("rosld")
_OPEN_SECONDS = 5.0
"""Seconds to wait for a subscriber of one topic before the next topic is advertised."""


class ReadyPublications:
    """Advertiser of a robot's velocity topics as they appear; belongs to the server's loop."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._advertising = WokenTask(self._advertise)
        self._watch: Watch | None = None
        self._failures: dict[str, str] = {}

    def start(self) -> None:
        """Advertise the present topics, and new ones as they appear."""
        self._watch = self._session.changes.watch(self._advertising.wake)
        self._advertising.start()

    async def stop(self) -> None:
        """Stop advertising more; closing the adapter withdraws the rest. Idempotent."""
        if self._watch is not None:
            self._watch.close()
        await self._advertising.stop()

    async def _advertise(self) -> None:
        session = self._session
        for topic in commanded_topics(session.graph, session.settings.stop_zero):
            if topic.type is None:
                continue
            try:
                await session.adapter.advertise(topic.name, topic.type, deadline=loop_time() + _OPEN_SECONDS)
            except (RosError, ValueError) as error:
                if self._failures.get(topic.name) != str(error):
                    _log.warning("cannot advertise %s for the stop: %s", topic.name, error)
                self._failures[topic.name] = str(error)
            else:
                self._failures.pop(topic.name, None)
