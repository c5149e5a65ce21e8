"""Holds that were interrupted because their rosld was killed: another rosld publishes their final message.

This is the next rosld that starts with the same `--data`, or `rosld guard`, which watches it.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections.abc import Callable
from typing import NamedTuple

from rosld.adapters.model import Graph, Kind, Live, RosError, Topic
from rosld.ontology.neutral_message import COMMANDS
from rosld.server.auth.rules import Agent
from rosld.server.receipts.audit import AuditEntry
from rosld.server.robot.hold_notes import HoldNote
from rosld.server.robot.hold_store import Holds, held_message
from rosld.server.robot.interlock import Holder
from rosld.server.robot.session import Session
from rosld.server.robot.velocity import subscribers_of
from rosld.server.robot.zero_publisher import Repetition
from rosld.server.runtime.tasks import loop_time

SUBSCRIBER_SECONDS = 60.0
"""Seconds to wait for a subscriber of the topic, once the robot is visible."""
_PUBLISH_SECONDS = 10.0
_LOOK_SECONDS = 0.5
_SELF = Agent("rosld")

_log = logging.getLogger("rosld")


class Outcome(NamedTuple):
    """Outcome of an interrupted hold as a sentence; `subscribers` is None if nothing was published.

    `is_final`: do not retry.
    """

    words: str
    subscribers: int | None = None
    is_final: bool = True


class InterruptedHolds:
    """The holds interrupted before this rosld started; ends them and leaves receipts."""

    def __init__(self, session: Session, holds: Holds, note_write: Callable[[AuditEntry], object]) -> None:
        self._session = session
        self._holds = holds
        self._note_write = note_write

    async def run(self) -> None:
        """Report the interrupted holds before any new hold begins, and end them once the robot is visible."""
        found = self._holds.notes.read()
        for note in found:
            self._holds.set_interrupted(note, f"{_story(note)}: {_THEN_WAITS if note.data else _NO_THEN}")
            _log.warning("the interrupted hold %s on %s could not be ended: %s", note.id, note.topic, _story(note))
        await asyncio.gather(*(self._end(note) for note in found))

    async def _end(self, note: HoldNote) -> None:
        started_ns = time.time_ns()
        outcome = await end_interrupted(self._session, note, SUBSCRIBER_SECONDS, self._holds.notes.reread)
        words = f"{_story(note)}: {outcome.words}"
        _log.warning("the hold %s on %s: %s", note.id, note.topic, words)
        self._holds.set_interrupted(note, words)
        self._holds.notes.remove(note.id)
        space = self._session.space
        self._note_write(
            AuditEntry(
                _SELF,
                started_ns,
                time.time_ns(),
                "DELETE",
                space.hold(note.id),
                b"",
                None,
                None,
                0,
                None,
                (f"end the hold of {note.topic}, which was interrupted: {outcome.words}",),
                (space.topic(note.topic),),
                outcome.subscribers,
                204 if outcome.subscribers or note.outcome else 503 if note.data else 200,
                None,
                None if outcome.subscribers else outcome.words,
            )
        )


_NO_THEN = "nothing is published at its end (then=none), so the last command may remain in effect"
_THEN_WAITS = "its final message is published once the robot and a subscriber are available"


def _story(note: HoldNote) -> str:
    return f"rosld was killed while {note.holder} held it"


async def end_interrupted(
    session: Session, note: HoldNote, patience: float, reread: Callable[[HoldNote], HoldNote]
) -> Outcome:
    """Publish the final message once its topic has a subscriber, unless another agent commands the topic.

    Waits for the robot indefinitely, then for a subscriber for `patience` seconds.
    """
    changed = asyncio.Event()
    watch = session.changes.watch(changed.set)
    try:
        return await _end(session, note, patience, reread, changed)
    finally:
        watch.close()


async def _end(
    session: Session, note: HoldNote, patience: float, reread: Callable[[HoldNote], HoldNote], changed: asyncio.Event
) -> Outcome:
    deadline: float | None = None
    while True:
        changed.clear()
        note = reread(note)
        if note.outcome is not None:
            return Outcome(note.outcome)
        if note.data is None:
            return Outcome(_NO_THEN)
        if isinstance(session.graph.state, Live):
            refusal = _refusal(session, note)
            if refusal is not None:
                return Outcome(f"nothing was published: {refusal}")
            topic = session.graph.topics.get(note.topic)
            if (
                topic is not None
                and subscribers_of(topic, session.graph)
                and not _waits_for_other(topic, note, session)
            ):
                return await _publish(session, topic, note, note.data)
            deadline = deadline or loop_time() + patience
            if loop_time() > deadline:
                return Outcome(f"nothing was published: no node subscribed within {patience:g} s", is_final=False)
        with contextlib.suppress(asyncio.TimeoutError, TimeoutError):
            await asyncio.wait_for(changed.wait(), _LOOK_SECONDS)


def _refusal(session: Session, note: HoldNote) -> str | None:
    """Return why the final message must not be published, in words; None if it may be."""
    if session.settings.read_only:
        return "this server is read-only"
    if note.topic in session.interlock.held or note.topic in session.adapter.published:
        return "another client of this rosld already commands it"
    topic = session.graph.topics.get(note.topic)
    if topic is None:
        return None
    if not all(map(_is_rosld, _other_publishers(topic, note, session.graph))):
        return "another node publishes on it"  # the node's name is not for everybody who may read the hold
    if topic.type is not None and topic.type.name != note.type:
        return f"its type is now {topic.type.name}, not {note.type}"
    return None


def _waits_for_other(topic: Topic, note: HoldNote, session: Session) -> bool:
    """Whether another rosld publishes on the topic: a guard that ends the hold just now, or one that died too."""
    return topic.type is None or bool(_other_publishers(topic, note, session.graph))


def _other_publishers(topic: Topic, note: HoldNote, graph: Graph) -> list[str]:
    return [each.node for each in topic.publishers if each.node not in (graph.own_node, note.node)]


def _is_rosld(node: str) -> bool:
    return node.rpartition("/")[2].startswith("rosld_")


async def _publish(session: Session, topic: Topic, note: HoldNote, data: bytes) -> Outcome:
    """Publish the message; other clients of this rosld cannot publish meanwhile."""
    interlock, encoding = session.interlock, session.adapter.capabilities.encoding
    interlock.held[topic.name] = Holder(_SELF.name, session.space.hold(note.id))
    try:
        assert topic.type is not None
        schema = await session.schemas.message(topic.type)
        message = schema.codec.decode(data, encoding)
        last = held_message(schema, message, encoding, restamp=True, clock=not session.graph.simulated_time)
        if schema.ref.name in COMMANDS:
            # Repeated, as in a stop: a single lost message would let the base drive on.
            repetition = Repetition(session, topic.name, last, subscribers_of(topic, session.graph))
            reached = await repetition.wait_received_late()
            subscribers = 0 if reached is None else reached.subscribers
            await repetition.over()
        else:
            now = last.encode_at(time.time_ns(), encoding)
            deadline = loop_time() + _PUBLISH_SECONDS
            published = await session.adapter.publish_always(topic.name, schema.ref, now, deadline=deadline)
            subscribers = published.matched
            session.announce_write(Kind.TOPIC, topic.name)
    except (RosError, ValueError) as error:
        return Outcome(f"its final message was not published: {error}", is_final=False)
    finally:
        interlock.held.pop(topic.name, None)
    if not subscribers:
        return Outcome("its final message reached no subscriber", is_final=False)
    words = "zero" if note.then == "zero" else f"its final message ({note.then})"
    return Outcome(f"{words} was published to {subscribers} subscriber{'s' if subscribers > 1 else ''}", subscribers)
