"""What the middleware shows of the system: names are looked at each time, endpoints where something hints at a change.

rclpy tells of no graph events, so the names of things are looked at often, which is cheap, and the endpoints of a
topic when something hints at a change, and of all topics now and then.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence

from rosld.adapters.ros2.graph import Observation, foreign_nodes
from rosld.adapters.ros2.middleware import Names, Participant

_COUNTS = 1.0
_ALL = 10.0
_EVERY = 0.2
_SHARE = 20  # looks may take one part in so many of our time
_AT_ONCE = 25


class Discovery:
    """Looks at the system through one participant; `seen` is what was found last. Belongs to the thread of ROS."""

    def __init__(self, participant: Participant) -> None:
        self.seen = Observation()
        self._participant = participant
        self._counts: dict[str, tuple[int, int]] = {}
        self._all_at = 0.0
        self._counted_at = 0.0
        self._took = 0.0
        self._wanted = asyncio.Event()
        self._looking = asyncio.Lock()

    def look_soon(self) -> None:
        """End the pause until the next look."""
        self._wanted.set()

    async def pause(self) -> None:
        """Wait until it is time to look again."""
        try:
            await asyncio.wait_for(self._wanted.wait(), min(max(_EVERY, _SHARE * self._took), _ALL))
        except asyncio.TimeoutError:
            pass
        self._wanted.clear()

    async def look(self, topics: Sequence[str] = ()) -> None:
        """Look now; at the endpoints of these topics whether something hints at a change or not."""
        async with self._looking:
            started = time.monotonic()
            await self._look(topics)
            self._took = time.monotonic() - started

    async def _look(self, wanted: Sequence[str]) -> None:
        participant, before, now = self._participant, self.seen, asyncio.get_running_loop().time()
        nodes, topics, services = participant.node_names(), participant.topics(), participant.services()
        anew = set(wanted) & topics.keys()
        whole = now - self._all_at > max(_ALL, _SHARE * self._took)
        if whole or sorted(nodes) != sorted(before.nodes):
            anew.update(topics)
            self._all_at = now
        else:
            anew.update(name for name, types in topics.items() if before.topics.get(name) != types)
            anew.update(name for name in topics if self._incomplete(name))
            if now - self._counted_at > _COUNTS:
                anew.update(name for name in topics if self._counts.get(name) != participant.counts(name))
                self._counted_at = now
        publishers = {name: before.publishers[name] for name in topics if name in before.publishers}
        subscribers = {name: before.subscribers[name] for name in topics if name in before.subscribers}
        for position, name in enumerate(sorted(anew)):
            publishers[name], subscribers[name] = participant.publishers(name), participant.subscribers(name)
            self._counts[name] = len(publishers[name]), len(subscribers[name])
            if position % _AT_ONCE == _AT_ONCE - 1:
                await asyncio.sleep(0)
        self._counts = {name: count for name, count in self._counts.items() if name in topics}
        providers, callers = before.providers, before.callers
        if whole or sorted(nodes) != sorted(before.nodes) or services != before.services or self._unprovided(services):
            foreign = foreign_nodes(Observation(nodes), participant.hidden_name)
            providers = {node: participant.services_of(node) for node in foreign}
            callers = {node: participant.clients_of(node) for node in foreign}
        self.seen = Observation(nodes, topics, services, publishers, subscribers, providers, callers)

    def _incomplete(self, topic: str) -> bool:
        """Whether an endpoint was seen before its node was: who it is comes a moment later."""
        seen = self.seen
        return any(not each.node for of in (seen.publishers, seen.subscribers) for each in of.get(topic, ()))

    def _unprovided(self, services: Names) -> bool:
        provided = {service for of in self.seen.providers.values() for service in of}
        return not services.keys() <= provided
