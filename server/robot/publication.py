"""Publications: messages that are ready to be published, and the rules under which rosld publishes."""

from __future__ import annotations

from dataclasses import dataclass

from rosld.adapters.base import Published
from rosld.adapters.model import Kind, TypeRef
from rosld.server.http.problem import Problem
from rosld.server.robot.publish_rate import PublishLimiter
from rosld.server.robot.session import Session
from rosld.server.runtime.dry_run import is_dry_run
from rosld.server.runtime.loop_time import loop_time


@dataclass(frozen=True, slots=True)
class Publication:
    """A message for a topic: nothing about it can be refused any more but by the robot.

    `passes_stop`: it is published also while the robot is stopped.
    """

    topic: str
    type: TypeRef
    data: bytes
    latch: bool = False
    passes_stop: bool = False


async def publish(session: Session, publication: Publication) -> Published:
    """Publish, waiting a moment for somebody to listen. Raises a 429 Problem where the topic is published too often."""
    topic = publication.topic
    require_rate(session.limiter, topic)
    deadline = loop_time() + session.settings.publish_wait
    try:
        return await session.adapter.publish(
            topic,
            publication.type,
            publication.data,
            latch=publication.latch,
            deadline=deadline,
            passes_stop=publication.passes_stop,
        )
    finally:
        session.announce_write(Kind.TOPIC, topic)


def require_rate(limiter: PublishLimiter, topic: str) -> None:
    """Count one publish, unless it is a dry run. Raises a 429 Problem where the topic is published to too often."""
    wait = limiter.wait(topic, loop_time(), is_counted=not is_dry_run())
    if wait > 0:
        sentence = f"More than {limiter.rate:g} messages a second on {topic} (--max-publish-rate)."
        raise Problem(429, sentence, headers={"Retry-After": str(max(1, round(wait)))})


def no_subscriber_problem(topic: str) -> Problem:
    """The problem details (202) of a message that was published without a subscriber."""
    sentence = f"The message was published, but no subscriber of {topic} was there to get it."
    return Problem(202, sentence, title="Nobody is listening")
