"""Publications for the stop that are advertised beforehand, so that a stop waits for no discovery.

A new publisher is connected in ROS 1 after up to 0.1 s (the master looks that often for news to tell subscribers), in
ROS 2 after a discovery, both longer on a busy machine; a message of one that is connected takes milliseconds.
"""

from __future__ import annotations

import logging

from rosld.adapters.base import Watch
from rosld.adapters.model import RosError
from rosld.server.robot.session import Session
from rosld.server.robot.velocity import commanded_topics
from rosld.server.runtime.tasks import WokenTask, loop_time

_log = logging.getLogger("rosld")
_PATIENCE = 5.0
"""Seconds that a subscriber of one topic is waited for before the next topic is advertised."""


class ReadyPublications:
    """Advertises the velocity topics of a robot as they come, and keeps them; belongs to the server's loop."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._advertising = WokenTask(self._advertise)
        self._watch: Watch | None = None
        self._failures: dict[str, str] = {}

    def start(self) -> None:
        """Advertise what there is now, and from now on what comes."""
        self._watch = self._session.changes.watch(self._advertising.wake)
        self._advertising.start()

    async def stop(self) -> None:
        """Advertise nothing more; what is advertised goes with the adapter. Idempotent."""
        if self._watch is not None:
            self._watch.close()
        await self._advertising.stop()

    async def _advertise(self) -> None:
        session = self._session
        for topic in commanded_topics(session.graph, session.settings.stop_zero):
            if topic.type is None:
                continue
            try:
                await session.adapter.advertise(topic.name, topic.type, deadline=loop_time() + _PATIENCE)
            except (RosError, ValueError) as error:
                if self._failures.get(topic.name) != str(error):
                    _log.warning("%s cannot be advertised for the stop: %s", topic.name, error)
                self._failures[topic.name] = str(error)
            else:
                self._failures.pop(topic.name, None)
