"""Topics that rosld reads and publishes through a Foxglove server.

The reading thread replaces the samples of a feed with one assignment; everything else belongs to the server's loop.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from rosld.adapters.foxglove.types import json_of_message
from rosld.adapters.model import Encoding, MessageSchema, Sample, TypeRef
from rosld.adapters.slots import received_ns
from rosld.adapters.thread import LiveFeed, wait_event

_ECHOES = 64
_ECHO_SECONDS = 2.0


class TopicFeed(LiveFeed):
    """The newest messages of one topic."""

    def __init__(self, topic: str, changed: Callable[[Any], None], sequence: int) -> None:
        super().__init__(topic, changed)
        self.sequence = sequence
        self._samples: tuple[Sample, ...] = ()
        self._server = asyncio.get_running_loop()
        self._woken = False
        self._seen: tuple[object, object] = ((), ())
        self._views: dict[int, Sequence[Sample]] = {}

    def take(self, data: bytes, encoding: Encoding, ref: TypeRef, publisher: str) -> None:
        """Add a message; called on the reading thread."""
        self.sequence += 1
        sample = Sample(data, encoding, ref, publisher, time.time_ns(), self.sequence)
        self._samples = (*self._samples, sample)[-self.depth :]
        if self.watches and not self._woken:
            self._woken = True
            with contextlib.suppress(RuntimeError):  # the server's event loop has ended
                self._server.call_soon_threadsafe(self._wake)

    def latest(self, depth: int = 1) -> Sequence[Sample]:
        """Return the newest messages of the topic and of rosld; the same object if nothing is new."""
        seen = (self._samples, self.own)
        if seen[0] is not self._seen[0] or seen[1] is not self._seen[1]:
            self._seen, self._views = seen, {}
        if depth not in self._views:
            self._views[depth] = tuple(sorted((*seen[0][-depth:], *seen[1][-depth:]), key=received_ns))
        return self._views[depth]

    def _wake(self) -> None:
        self._woken = False
        self.notify()


class Publication:
    """A topic that rosld publishes, as a channel of its connection; `matched` is its number of subscribers."""

    def __init__(
        self,
        topic: str,
        id: int,
        schema: MessageSchema,
        encoding: str,
        transmit: Callable[[Publication, bytes], None],
    ) -> None:
        self.topic = topic
        self.id = id
        self.schema = schema
        self.ref = schema.ref
        self.encoding = encoding
        self.matched = 0
        self._changed = asyncio.Event()
        self._transmit = transmit
        self._echoes: deque[tuple[float, bytes]] = deque(maxlen=_ECHOES)

    async def wait_matched(self, count: int, until: float, patience: float) -> None:
        """Wait until there are `count` subscribers, at most until a time of the thread's loop."""
        while self.matched < count and await wait_event(self._changed, until - time.monotonic()):
            self._changed.clear()

    def match(self, count: int) -> None:
        """Set the number of subscribers; called on the thread."""
        self.matched = count
        self._changed.set()

    def send(self, data: bytes, latch: bool) -> None:
        """Send a message; called on the thread."""
        self._echoes.append((time.monotonic(), data))
        if self.encoding == "json":
            encoding = Encoding.ROS1 if self.schema.ref.hash and len(self.schema.ref.hash) == 32 else Encoding.CDR
            data = json_of_message(self.schema, self.schema.codec.decode(data, encoding))
        self._transmit(self, data)

    def takes_echo(self, data: bytes) -> bool:
        """Whether this is the echo of a message that was just sent; each is recognized once."""
        for each in self._echoes:
            if each[1] == data and time.monotonic() - each[0] < _ECHO_SECONDS:
                self._echoes.remove(each)
                return True
        return False


class Publications(dict[str, Publication]):
    """The publications by topic."""

    is_connected = False

    def suitable(self, topic: str, type: TypeRef, latch: bool) -> Publication | None:
        """Return the publication of a topic if messages of this type can be sent with it now (thread-safe)."""
        found = self.get(topic) if self.is_connected else None
        fits = found is not None and found.ref.name == type.name and type.hash in (None, found.ref.hash)
        return found if fits else None

    def is_latched(self, publication: Publication, latch: bool) -> bool:
        """Return False: the protocol has no latched messages."""
        return False
