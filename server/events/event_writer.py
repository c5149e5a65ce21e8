"""Writer of an event stream: events, and keep-alive comments where there are none for a while."""

from __future__ import annotations

import time

from rosld.server.events import frame
from rosld.server.events.broadcaster import RETRY_SECONDS
from rosld.server.events.endless_response import Tell

KEEP_ALIVE_SECONDS = 15.0


class EventWriter:
    """Writes to one event stream. `quiet`: seconds without an event after which a keep-alive is due."""

    def __init__(self, tell: Tell, quiet: float = KEEP_ALIVE_SECONDS) -> None:
        self.quiet = quiet
        self._tell = tell
        self._spoke = time.monotonic()

    @property
    def silence(self) -> float:
        """Seconds since something was written."""
        return time.monotonic() - self._spoke

    async def open(self) -> None:
        """Write what a stream begins with."""
        await self.send(frame.opening(RETRY_SECONDS))

    async def send(self, chunk: bytes) -> None:
        """Write a frame."""
        self._spoke = time.monotonic()
        await self._tell(chunk)

    async def keep_alive(self) -> None:
        """Write a keep-alive comment, where one is due."""
        if self.silence >= self.quiet:
            await self.send(frame.KEEP_ALIVE)
