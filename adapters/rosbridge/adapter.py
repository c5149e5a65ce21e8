"""The `Adapter` of a robot behind a rosbridge server: its methods use a system in a separate thread."""

from __future__ import annotations

import os
import socket
import time
from functools import partial

from rosld.adapters.base import AdapterOptions, Capabilities, Sink
from rosld.adapters.bridge_connection import BridgeFeed, BridgeSource, read_source
from rosld.adapters.model import Encoding, Operation, Schema, TypeRef
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.rosbridge.system import System
from rosld.adapters.thread import ThreadAdapter, thread_time

PORT = 9090
_CAPABILITIES = {
    1: Capabilities(
        "ROS 1", Encoding.ROS1, writes=True, creates_topics=True, parameter_trees=True, parameter_server=True
    ),
    2: Capabilities("ROS 2", Encoding.CDR, writes=True, creates_topics=True, parameter_trees=False, hidden_names=True),
}


def adapter(source: str, options: AdapterOptions) -> RosbridgeAdapter:
    """Return the adapter for a source such as `rosbridge://robot:9090` or `rosbridges://robot?ros=1`.

    Raises ValueError for other sources.
    """
    read = read_source(source, PORT, ("ros",))
    if read.options.get("ros") not in (None, "1", "2"):
        raise ValueError(f"ros={read.options['ros']!r} is neither 1 nor 2, the versions of ROS")
    return RosbridgeAdapter(read, options)


class RosbridgeAdapter(ThreadAdapter[System, BridgeFeed]):
    """A ROS 1 or ROS 2 system, reached through rosbridge.

    The version of ROS is the bridge's when the adapter is opened; of a bridge that is off then, it is the option `ros`
    of the source, or else 2.
    """

    def __init__(self, source: BridgeSource, options: AdapterOptions) -> None:
        self._version = int(source.options["ros"]) if "ros" in source.options else None
        library = TypeLibrary(ros_version=1 if self._version == 1 else 2, folders=options.types)
        super().__init__(library, f"/rosld_{socket.gethostname().replace('-', '_')}_{os.getpid()}")
        self._source = source
        self._options = options

    @property
    def capabilities(self) -> Capabilities:
        """The capabilities of the bridge's version of ROS."""
        return _CAPABILITIES[self._version or 2]

    async def _begin(self, sink: Sink, until: float) -> System:
        system = System(self._source, self._version, self._graph, self._options, sink)
        await system.open(until - time.monotonic())
        self._version, self._library = system.client.version, system.client.library
        return system

    def _parameter_operations(self, name: str) -> frozenset[Operation]:
        return self._system.parameters.operations(name) if self._system else frozenset()

    async def schema(self, ref: TypeRef, *, deadline: float) -> Schema:
        _, system = self._running()
        return await self._schema_in_time(ref.name, system.client.types.schema(ref, thread_time(deadline)), deadline)

    def _new_feed(self, topic: str, system: System) -> BridgeFeed:
        return BridgeFeed(topic, self.capabilities.encoding, partial(self._apply, topic))
