"""Publications for the stop that are advertised beforehand, so that no base meets a new publisher when it matters.

To make one takes ROS 1 up to 0.1 s (the master looks that often for news to tell subscribers) and ROS 2 a discovery,
both longer on a busy machine; a message on one that is connected takes milliseconds.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging

from rosld.adapters.base import Watch
from rosld.adapters.model import RosError
from rosld.server.robot.session import Session
from rosld.server.robot.velocity import commanded_topics

_log = logging.getLogger("rosld")
_PATIENCE = 5.0
"""Seconds that a subscriber of one topic is waited for before the next topic is advertised."""


class ReadyPublications:
    """Advertises the velocity topics of a robot as they come, and keeps them; belongs to the server's loop."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._changed = asyncio.Event()
        self._watch: Watch | None = None
        self._task: asyncio.Task[None] | None = None
        self._failures: dict[str, str] = {}

    def start(self) -> None:
        """Advertise what there is now, and from now on what comes."""
        self._changed.set()
        self._watch = self._session.changes.watch(self._changed.set)
        self._task = asyncio.get_running_loop().create_task(self._run())

    async def stop(self) -> None:
        """Advertise nothing more; what is advertised goes with the adapter. Idempotent."""
        if self._watch is not None:
            self._watch.close()
        if self._task is not None:
            self._task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._task

    async def _run(self) -> None:
        while True:
            await self._changed.wait()
            self._changed.clear()
            await self._advertise()

    async def _advertise(self) -> None:
        session = self._session
        for topic in commanded_topics(session.graph, session.settings.stop_zero):
            if topic.type is None:
                continue
            try:
                await session.adapter.advertise(topic.name, topic.type, deadline=session.deadline(_PATIENCE))
            except (RosError, ValueError) as error:
                if self._failures.get(topic.name) != str(error):
                    _log.warning("%s cannot be advertised for the stop: %s", topic.name, error)
                self._failures[topic.name] = str(error)
            else:
                self._failures.pop(topic.name, None)
