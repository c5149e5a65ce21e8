"""Topics that rosld publishes through a Foxglove server."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

from rosld.adapters.foxglove.types import json_of_message
from rosld.adapters.model import Encoding, MessageSchema, TypeRef
from rosld.adapters.thread import wait_event


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
        if self.encoding == "json":
            encoding = Encoding.ROS1 if self.schema.ref.hash and len(self.schema.ref.hash) == 32 else Encoding.CDR
            data = json_of_message(self.schema, self.schema.codec.decode(data, encoding))
        self._transmit(self, data)


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
