"""Topics on the server's own loop, and those that rosld advertises."""

from __future__ import annotations

import time
from collections.abc import Callable, Container, Mapping

from msgspec import Struct

from rosld.adapters.base import Published, Subscription
from rosld.adapters.model import Encoding, NotFound, Refused, Sample, TypeRef
from rosld.adapters.slots import Slot

_MAX_ADVERTISED = 10_000


class AdvertisedTopic(Struct):
    """A topic that rosld advertises; `epoch` counts its advertisings, `sequence` its messages."""

    type: TypeRef
    latched: bool
    epoch: int
    matched: int
    sequence: int = 0


class LocalTopics:
    """The newest messages of each topic, and which topics rosld advertises.

    `types` are those of the robot's own topics; `subscribed` are the names of those that the robot subscribes to.
    `own_node` is the name of rosld. `resolve` finds the type of a message, with its hash; `changed` is called when
    rosld advertises something else.
    """

    def __init__(
        self,
        types: Mapping[str, TypeRef],
        subscribed: Container[str],
        encoding: Encoding,
        own_node: str,
        resolve: Callable[[TypeRef], TypeRef],
        changed: Callable[[], None],
    ) -> None:
        self.advertised: dict[str, AdvertisedTopic] = {}
        self._types = types
        self._subscribed = subscribed
        self._encoding = encoding
        self._own_node = own_node
        self._resolve = resolve
        self._changed = changed
        self._slots = {topic: Slot() for topic in types}
        self._sequences: dict[str, int] = {}
        self._advertisings = 0

    def subscribe(self, topic: str, depth: int) -> Subscription:
        """Subscribe to a topic, whether or not it is there yet."""
        return self._slot(topic).subscribe(depth)

    def is_subscribed(self, topic: str) -> bool:
        """Whether a topic has a subscription."""
        slot = self._slots.get(topic)
        return slot is not None and slot.subscriptions > 0

    def publish_as(self, topic: str, node: str, data: bytes, *, latched: bool = False) -> None:
        """Publish a message of a node of the robot on one of its topics."""
        sequence = self._sequences[topic] = self._sequences.get(topic, 0) + 1
        self._slot(topic).put(
            Sample(data, self._encoding, self._types[topic], node, time.time_ns(), sequence, latched=latched)
        )

    def publish(self, topic: str, type: TypeRef, data: bytes, latch: bool) -> Published:
        """Publish a message of rosld, advertising first if need be. Raises Refused, UnknownType."""
        own = self.advertised.get(topic)
        if own is None or own.latched != latch or own.type != type:
            own = self._advertise(topic, type, latch)
        own.sequence += 1
        self._slot(topic).put(
            Sample(data, self._encoding, own.type, self._own_node, time.time_ns(), own.sequence, own.epoch, latch)
        )
        return Published(own.matched)

    def unadvertise(self, topic: str) -> None:
        """Stop advertising; what rosld sent there is gone with it. Raises NotFound where it advertises nothing."""
        if self.advertised.pop(topic, None) is None:
            raise NotFound(f"rosld does not advertise {topic}")
        self._slots[topic].drop(self._own_node)
        if topic not in self._types and not self._slots[topic].subscriptions:
            del self._slots[topic]
        self._changed()

    def _slot(self, topic: str) -> Slot:
        return self._slots.setdefault(topic, Slot())

    def _advertise(self, topic: str, type: TypeRef, latch: bool) -> AdvertisedTopic:
        """Advertise a topic, or take note of another way of publishing on it."""
        kind = self._resolve(type)
        own = self.advertised.get(topic)
        carried = self._types.get(topic) or (own.type if own else kind)
        if carried != kind:
            raise Refused(f"the topic {topic} carries {carried.name}, not this {kind.name}")
        if own is not None and own.latched == latch:
            return own
        if own is None and len(self.advertised) >= _MAX_ADVERTISED:
            raise Refused(f"rosld advertises {_MAX_ADVERTISED} topics already: DELETE one first")
        self._advertisings += 1
        own = AdvertisedTopic(kind, latch, epoch=self._advertisings, matched=int(topic in self._subscribed))
        self.advertised[topic] = own
        self._changed()
        return own
