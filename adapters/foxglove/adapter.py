"""The `Adapter` of Foxglove servers: its methods run on the server's event loop and use a client in a thread."""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Sequence
from functools import partial

from rosld.adapters.base import Adapter, AdapterOptions, Capabilities, Sink
from rosld.adapters.bridge_connection import BridgeFeed, BridgeSource, read_source
from rosld.adapters.foxglove.client import Client, Types
from rosld.adapters.model import Operation, Ref, Schema, TypeRef
from rosld.adapters.thread import ThreadAdapter

_DEFAULT_PORT = 8765
_WRITES = frozenset({Operation.PUBLISH})
_numbers = itertools.count()


def adapter(source: str, options: AdapterOptions) -> FoxgloveAdapter:
    """Return the adapter for a source `foxglove://host:port`. Raises ValueError for other sources."""
    return FoxgloveAdapter(read_source(source, _DEFAULT_PORT), options)


class FoxgloveAdapter(ThreadAdapter[Client, BridgeFeed]):
    """A robot that is reached through a Foxglove server. It has no actions: the protocol has none."""

    send_goal = Adapter.send_goal
    cancel_goal = Adapter.cancel_goal
    cancel_goals = Adapter.cancel_goals
    follow_goals = Adapter.follow_goals

    def __init__(self, source: BridgeSource, options: AdapterOptions) -> None:
        self._types = Types(options)
        super().__init__(self._types.library, f"/rosld_foxglove_{os.getpid()}_{next(_numbers)}")
        self._source = source
        self._options = options

    @property
    def capabilities(self) -> Capabilities:
        """The capabilities that the server declares. The encoding is ROS 2's until a server has ROS 1's."""
        can_publish = self._can("clientPublish")
        return Capabilities(
            "Foxglove server",
            self._types.encoding,
            writes=can_publish or self._can("services") or self._can("parameters"),
            creates_topics=can_publish,
            parameter_trees=False,
        )

    async def _begin(self, sink: Sink, until: float) -> Client:
        client = Client(self._source, self._graph, self._options, self._types, sink)
        await client.open(until - time.monotonic())
        return client

    def known_types(self) -> Sequence[TypeRef]:
        self._library = self._types.library  # that of ROS 1 if the server turned out to have that
        return super().known_types()

    def allows(self, ref: Ref) -> frozenset[Operation]:
        """Return the operations on a thing, as far as the server permits them to its clients."""
        operations = super().allows(ref)
        return operations if self._can("clientPublish") else operations - _WRITES

    def _parameter_operations(self, name: str) -> frozenset[Operation]:
        if not self._can("parameters"):
            return frozenset()
        if name in self.graph.parameters:
            return frozenset({Operation.GET_PARAMETER, Operation.SET_PARAMETER, Operation.DELETE_PARAMETER})
        return frozenset({Operation.SET_PARAMETER})

    async def schema(self, ref: TypeRef, *, deadline: float) -> Schema:
        _, client = self._running()
        return await self._schema_in_time(ref.name, client.schema(ref), deadline)

    def _can(self, capability: str) -> bool:
        return self._system is None or self._system.peer.can(capability)

    def _new_feed(self, topic: str, system: Client) -> BridgeFeed:
        return BridgeFeed(topic, self._types.encoding, partial(self._apply, topic))
