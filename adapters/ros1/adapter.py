"""The `Adapter` of ROS 1: its methods run on the server's event loop and use a client in a separate thread."""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Mapping, Sequence
from functools import partial
from urllib.parse import urlsplit

from rosld.adapters.base import AdapterOptions, Capabilities, Sink
from rosld.adapters.model import Encoding, Operation, Schema, TypeRef
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.model.parameter import ParameterValue
from rosld.adapters.ros1.client import Client
from rosld.adapters.ros1.master import own_name
from rosld.adapters.ros1.subscription import TopicFeed
from rosld.adapters.ros1.types import definition_folders
from rosld.adapters.thread import ThreadAdapter, thread_time

DEFAULT_MASTER = "http://localhost:11311"
_instances = itertools.count()


def master_address(source: str, environment: Mapping[str, str] = os.environ) -> tuple[str, int]:
    """Return host and port of the master in a source: `ros1://host:port`, or ROS_MASTER_URI for `ros1` or `ros1:`.

    Raises ValueError with a sentence for the user.
    """
    rest = source.removeprefix("ros1").removeprefix(":").removeprefix("//")
    uri = f"http://{rest}" if rest else environment.get("ROS_MASTER_URI") or DEFAULT_MASTER
    try:
        parts = urlsplit(uri)
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise ValueError(f"{uri!r} does not name a master: {error}") from error
    if parts.scheme != "http" or not host or parts.path.strip("/"):
        raise ValueError(
            f"{source!r} does not name a master: use ros1://HOST:PORT, or set ROS_MASTER_URI=http://HOST:PORT"
        )
    return host, port or 11311


def node_name() -> str:
    """Return our name in ROS: `/rosld_HOST_PID`, with a number for further adapters in one process."""
    return own_name(next(_instances))


def adapter(source: str, options: AdapterOptions) -> Ros1Adapter:
    """Return the adapter for a source `ros1://host:port` or `ros1:`. Raises ValueError for other sources."""
    return Ros1Adapter(master_address(source), options)


class Ros1Adapter(ThreadAdapter[Client, TopicFeed]):
    """A ROS 1 system, reached through its master."""

    capabilities = Capabilities(
        "ROS 1", Encoding.ROS1, writes=True, creates_topics=True, parameter_trees=True, parameter_server=True
    )

    def __init__(self, master: tuple[str, int], options: AdapterOptions) -> None:
        super().__init__(TypeLibrary(ros_version=1, folders=definition_folders(options.types)), node_name())
        self._master = master
        self._options = options

    async def _begin(self, sink: Sink, until: float) -> Client:
        client = Client(self._master, self._graph.own_node, self._options, self._library, sink)
        await client.open(until - time.monotonic())
        return client

    def _parameter_operations(self, name: str) -> frozenset[Operation]:
        """Return the operations on a parameter: one that a node declares cannot be deleted."""
        operations = self._system.parameters.operations(name) if self._system else frozenset()
        parameter = self.graph.parameters.get(name)
        is_declared = parameter is not None and parameter.descriptor is not None
        return operations - {Operation.DELETE_PARAMETER} if is_declared else operations

    async def schema(self, ref: TypeRef, *, deadline: float) -> Schema:
        _, client = self._running()
        return await self._schema_in_time(ref.name, client.types.schema(ref), deadline)

    async def set_parameters(self, values: Mapping[str, ParameterValue], *, deadline: float) -> None:
        """Set parameters; all are checked before the first is sent. Raises Refused naming the parameter.

        Parameters of dynamic_reconfigure are set by their nodes, so that they take effect; all others at the master.
        """
        thread, client = self._running()
        await thread.run(client.set_parameters(values, thread_time(deadline)))

    async def delete_parameters(self, names: Sequence[str], *, deadline: float) -> None:
        thread, client = self._running()

        async def change() -> None:
            try:
                await client.parameters.delete(names, thread_time(deadline))
            finally:
                client.refresh()

        await thread.run(change())

    def _new_feed(self, topic: str, system: Client) -> TopicFeed:
        return TopicFeed(topic, partial(self._apply, topic))
