"""An open adapter on a real system and its events, for the tests of an adapter."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from typing import Any

from rosld.adapters.base import Adapter, Published, Subscription
from rosld.adapters.model import GoalEvent, GoalId, Graph, MessageSchema, Sample, TypeRef


class EventRecorder:
    """A sink that records events."""

    def __init__(self) -> None:
        self.graphs: list[Graph] = []
        self.parameters: list[str] = []
        self.goals: list[tuple[GoalId, GoalEvent]] = []

    def graph_changed(self, graph: Graph) -> None:
        self.graphs.append(graph)

    def goal_changed(self, goal: GoalId, event: GoalEvent) -> None:
        self.goals.append((goal, event))

    def parameter_changed(self, name: str) -> None:
        self.parameters.append(name)


class Session:
    """An open adapter with the waits that tests need."""

    def __init__(self, opened: Adapter, events: EventRecorder) -> None:
        self.adapter = opened
        self.events = events

    @property
    def graph(self) -> Graph:
        return self.adapter.graph

    def deadline(self, seconds: float = 5.0) -> float:
        return asyncio.get_running_loop().time() + seconds

    # The calls of the adapter, each with a deadline

    async def publish(
        self, topic: str, type: TypeRef, data: bytes, *, seconds: float | None = None, latch: bool = False
    ) -> Published:
        return await self.adapter.publish(topic, type, data, latch=latch, deadline=self._deadline(seconds))

    async def call(self, service: str, type: TypeRef, data: bytes, *, seconds: float | None = None) -> bytes:
        return await self.adapter.call(service, type, data, deadline=self._deadline(seconds))

    async def schema(self, type: TypeRef, *, seconds: float | None = None) -> Any:
        return await self.adapter.schema(type, deadline=self._deadline(seconds))

    async def set_parameters(self, values: Mapping[str, Any], *, seconds: float | None = None) -> None:
        await self.adapter.set_parameters(values, deadline=self._deadline(seconds))

    async def get_parameters(self, names: Sequence[str], *, seconds: float | None = None) -> Mapping[str, Any]:
        return await self.adapter.get_parameters(names, deadline=self._deadline(seconds))

    async def delete_parameters(self, names: Sequence[str], *, seconds: float | None = None) -> None:
        await self.adapter.delete_parameters(names, deadline=self._deadline(seconds))

    def _deadline(self, seconds: float | None) -> float:
        return self.deadline() if seconds is None else self.deadline(seconds)

    # Waiting

    async def until(self, true: Callable[[], Any], what: str = "what was waited for", timeout: float = 60.0) -> Any:
        end = time.monotonic() + timeout
        while not (found := true()):
            assert time.monotonic() < end, f"never came: {what}"
            await asyncio.sleep(0.02)
        return found

    async def first(self, subscription: Subscription, count: int = 1) -> list[Sample]:
        """Return the newest samples, once there are this many."""
        await self.until(lambda: len(subscription.latest()) >= count, f"{count} samples")
        return list(subscription.latest())

    async def decoded(self, sample: Sample) -> Any:
        schema = await self.adapter.schema(sample.schema, deadline=self.deadline())
        assert isinstance(schema, MessageSchema)
        return schema.codec.decode(sample.data, sample.encoding)


@asynccontextmanager
async def opened_on(adapter: Adapter, *, seconds: float = 10.0, kind: type[Session] = Session) -> AsyncIterator[Any]:
    """Open an adapter within a time, and close it at the end."""
    events = EventRecorder()
    await adapter.open(events, deadline=asyncio.get_running_loop().time() + seconds)
    try:
        yield kind(adapter, events)
    finally:
        await adapter.close()
