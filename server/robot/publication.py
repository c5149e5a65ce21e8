"""Publications: messages ready to be published, and the rules for publishing."""

from __future__ import annotations

from typing import NamedTuple

from rosld.adapters.base import Published
from rosld.adapters.model import Kind, Message, MessageSchema, TypeRef
from rosld.server.http.fields import Link
from rosld.server.http.problem import Problem
from rosld.server.receipts.audit import record_step
from rosld.server.robot.session import Session
from rosld.server.robot.velocity import goes_on, passes_stop
from rosld.server.robot.write_policy import PublishLimiter
from rosld.server.runtime.dry_run import is_dry_run
from rosld.server.runtime.tasks import loop_time


class Publication(NamedTuple):
    """A message for a topic, after all checks: only the robot can still refuse it.

    `passes_stop`: it is published even while the robot is stopped. `goes_on`: it sets the robot in motion, which
    continues until something else is published.
    """

    topic: str
    type: TypeRef
    data: bytes
    latch: bool = False
    passes_stop: bool = False
    goes_on: bool = False


def prepare(
    session: Session, topic: str, schema: MessageSchema, message: Message, data: bytes, *, latch: bool = False
) -> Publication:
    """Return the publication of a message, according to the current stop state and graph."""
    return Publication(
        topic,
        schema.ref,
        data,
        latch,
        passes_stop(session, topic, schema, message),
        goes_on(session, topic, schema, message),
    )


async def publish(session: Session, publication: Publication) -> Published:
    """Publish, waiting a moment for a subscriber. Raises a 429 Problem if the topic is published to too often."""
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
        if publication.goes_on:  # after the step of the publish, also in the plan of a dry run
            record_step(f"the command on {topic} stays in effect until something stops it")


def require_rate(limiter: PublishLimiter, topic: str) -> None:
    """Count one publish, unless it is a dry run. Raises a 429 Problem if the topic is published to too often."""
    wait = limiter.wait(topic, loop_time(), is_counted=not is_dry_run())
    if wait > 0:
        sentence = f"More than {limiter.rate:g} messages per second on {topic} (--max-publish-rate)."
        raise Problem(429, sentence, headers={"Retry-After": str(max(1, round(wait)))})


def goes_on_link(topic_url: str) -> Link:
    """Return the link to the documentation of holds, for a velocity that was published once."""
    title = "It stays in effect until something stops it: hold it instead, with POST ?for=3 for three seconds"
    return Link(f"{topic_url}#hold", "help", title=title)


def goes_on_problem(topic: str, topic_url: str) -> Problem:
    """Return the problem details (200) of a velocity that was published once."""
    sentence = (
        f"The velocity was published once on {topic}: a robot without a time-out of its own keeps moving "
        f"until something stops it. POST to {topic_url}?for=3 to stop after three seconds, or PUT zero to "
        "stop now."
    )
    link = str(goes_on_link(topic_url))
    return Problem(200, sentence, title="Stays in effect until something stops it", headers={"Link": link})


def no_subscriber_problem(topic: str) -> Problem:
    """Return the problem details (202) of a message that was published without a subscriber."""
    sentence = f"The message was published, but {topic} had no subscriber to receive it."
    return Problem(202, sentence, title="No subscriber")
