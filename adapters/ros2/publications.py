"""What rosld publishes: one writer a topic, with the profile that all its subscribers accept.

Made on the thread that talks to ROS; how many are matched may be asked on any.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from rosld.adapters.model import Qos, TypeRef
from rosld.adapters.ros2.middleware import Reader, Writer
from rosld.adapters.ros2.profiles import hears

_PAUSE = 0.005
_SETTLING = 0.1
"""Seconds until a matched best-effort subscriber, for whom nothing is repeated, knows of us as well."""


class Publication:
    """A topic that rosld publishes; `ours` gives our own reader of it, which counts as nobody."""

    def __init__(self, topic: str, ref: TypeRef, writer: Writer, ours: Callable[[], Reader | None]) -> None:
        self.topic = topic
        self.ref = ref
        self.writer = writer
        self._ours = ours

    @property
    def qos(self) -> Qos:
        """The profile it is published with."""
        return self.writer.qos

    @property
    def latched(self) -> bool:
        """Whether later subscribers are told the last message."""
        return self.qos.durability == "transient_local"

    @property
    def matched(self) -> int:
        """How many subscribers are connected."""
        reader = self._ours()
        own = reader is not None and hears(reader.qos, self.qos)
        return max(0, self.writer.subscribers() - own)

    def carries(self, type: TypeRef) -> bool:
        """Whether messages of this type can be published here."""
        return type.name == self.ref.name and type.hash in (None, self.ref.hash)

    async def matching(self, wanted: int, until: float, patience: float) -> None:
        """Wait for one subscriber until then, and for as many as are wanted no longer than `patience` seconds."""
        loop = asyncio.get_running_loop()
        while self.matched == 0 and loop.time() < until:  # noqa: ASYNC110 - the middleware tells of no match
            await asyncio.sleep(_PAUSE)
        enough = min(until, loop.time() + patience)
        while self.matched < wanted and loop.time() < enough:  # noqa: ASYNC110
            await asyncio.sleep(_PAUSE)

    async def settled(self, until: float) -> None:
        """Wait until matched subscribers know of us too."""
        left = until - asyncio.get_running_loop().time()
        if left > 0 and self.matched:
            await asyncio.sleep(min(left, _SETTLING))

    def send(self, data: bytes) -> None:
        """Hand over a message; one that the middleware does not take is lost, as one on a broken line would be."""
        try:
            self.writer.publish(data)
        except ValueError:
            pass
