"""The motion stream of a topic of images: each picture replaces the one before (`multipart/x-mixed-replace`).

A reader gets the newest picture whenever it has taken the one before; what it is too slow for is left out
for it alone.
Pictures that several readers want alike are drawn once; what nobody takes is not drawn at all.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from rosld.server.events.broadcaster import Broadcasters, Waiter
from rosld.server.events.event_stream import EndlessResponse, Tell
from rosld.server.rest.resource import Motion

_BOUNDARY = "rosld-picture"
MEDIA_TYPE = f"multipart/x-mixed-replace; boundary={_BOUNDARY}"


@dataclass(slots=True)
class Pace:
    """At most one picture in each interval of 1/`rate` seconds; the intervals of all readers begin at the same times.

    So readers who want fewer pictures than there are want the same ones, and these are drawn once.
    """

    rate: float
    _last: int = -1

    def wait(self, now: float) -> float:
        """Return the seconds until the next picture may be sent, 0.0 where one may be sent now."""
        interval = math.floor(now * self.rate)
        return 0.0 if interval > self._last else max(0.001, (self._last + 1) / self.rate - now)

    def take(self, now: float) -> None:
        """Note that a picture is sent in this interval."""
        self._last = math.floor(now * self.rate)


class MotionStream(EndlessResponse):
    """The pictures of one motion, until its reader leaves, may not look any more, or the server ends."""

    last_chunk = f"\r\n--{_BOUNDARY}--\r\n".encode("ascii")

    def __init__(
        self,
        broadcasters: Broadcasters,
        motion: Motion,
        rate: float,
        headers: list[tuple[bytes, bytes]],
        is_valid: Callable[[], bool],
    ) -> None:
        own = [
            (b"content-type", MEDIA_TYPE.encode("ascii")),
            (b"cache-control", b"no-store"),
            (b"x-accel-buffering", b"no"),
            (b"x-content-type-options", b"nosniff"),
            (b"vary", b"Accept"),
        ]
        super().__init__(broadcasters, [*own, *headers])
        self._motion = motion
        self._pace = Pace(rate)
        self._is_valid = is_valid

    async def write(self, tell: Tell) -> None:
        waiter, is_new = Waiter(), True

        def wake() -> None:
            nonlocal is_new
            is_new = True
            waiter.wake()

        watch = await self._motion.watch(wake)
        try:
            part = f"--{_BOUNDARY}\r\nContent-Type: {self._motion.media_type}\r\n\r\n".encode("ascii")
            await tell(part)
            while True:
                if not is_new:
                    await waiter.sleep()
                if not self._is_valid():
                    return
                if (seconds := self._pace.wait(time.monotonic())) > 0.0:
                    await asyncio.sleep(seconds)
                is_new = False
                picture = await self._motion.newest()
                if picture is None or not self._is_valid():
                    continue
                self._pace.take(time.monotonic())
                # The head of the next part goes with this one: browsers show a picture when they have read that.
                await tell(b"".join((picture, b"\r\n", part)))
        finally:
            watch.close()
