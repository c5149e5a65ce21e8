"""The `Adapter` of Foxglove servers: its methods run on the server's event loop and use a client in a thread."""

from __future__ import annotations

import itertools
import os
from collections.abc import Sequence
from functools import partial
from urllib.parse import urlsplit, urlunsplit

from rosld.adapters.base import Adapter, AdapterOptions, Capabilities, Sink
from rosld.adapters.bridge_connection import BridgeFeed
from rosld.adapters.foxglove.client import Client, Types
from rosld.adapters.model import Operation, Ref, Schema, TypeRef
from rosld.adapters.thread import IoThread, ThreadAdapter, seconds_left, thread_time

_DEFAULT_PORT = 8765
_SCHEMES = {"foxglove": "ws", "foxgloves": "wss"}
_WRITES = frozenset({Operation.PUBLISH})
_numbers = itertools.count()


def server_url(source: str) -> tuple[str, str]:
    """Return the URL of the WebSocket of a source, and the same without credentials.

    Raises ValueError with a sentence for the user.
    """
    try:
        parts = urlsplit(source if "//" in source else f"{source.partition(':')[0]}://localhost")
        host, port = parts.hostname, parts.port or _DEFAULT_PORT
    except ValueError as error:
        raise ValueError(f"{source!r} does not name a Foxglove server: {error}") from error
    if parts.scheme not in _SCHEMES or not host:
        raise ValueError(f"{source!r} does not name a Foxglove server: use foxglove://HOST:{_DEFAULT_PORT}")
    credentials, _, _ = parts.netloc.rpartition("@")
    place = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
    shown = urlunsplit((_SCHEMES[parts.scheme], place, parts.path or "/", parts.query, ""))
    return shown.replace("//", f"//{credentials}@", 1) if credentials else shown, shown


def adapter(source: str, options: AdapterOptions) -> FoxgloveAdapter:
    """Return the adapter for a source `foxglove://host:port`. Raises ValueError for other sources."""
    return FoxgloveAdapter(server_url(source), options)


class FoxgloveAdapter(ThreadAdapter[Client, BridgeFeed]):
    """A robot that is reached through a Foxglove server. It has no actions: the protocol has none."""

    send_goal = Adapter.send_goal
    cancel_goal = Adapter.cancel_goal
    cancel_goals = Adapter.cancel_goals
    follow_goals = Adapter.follow_goals

    def __init__(self, urls: tuple[str, str], options: AdapterOptions) -> None:
        self._types = Types(options)
        super().__init__(self._types.library, f"/rosld_foxglove_{os.getpid()}_{next(_numbers)}")
        self._urls = urls
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

    async def open(self, sink: Sink, *, deadline: float) -> None:
        """Connect to the server. If it does not respond, the graph is Stale until it does."""
        if self._system is not None:
            return
        thread = IoThread("rosld-foxglove")
        thread.start()
        self._thread = thread
        left = seconds_left(deadline)

        async def begin() -> Client:
            client = Client(*self._urls, self._graph, self._options, self._types, sink)
            await client.open(left)
            return client

        self._system = await thread.run(begin())

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

    async def call(self, service: str, type: TypeRef, request: bytes, *, deadline: float) -> bytes:
        thread, client = self._running()
        return await thread.run(client.call(service, type, request, thread_time(deadline)))

    def _can(self, capability: str) -> bool:
        return self._system is None or self._system.peer.can(capability)

    def _new_feed(self, topic: str, system: Client) -> BridgeFeed:
        return BridgeFeed(topic, self._types.encoding, partial(self._apply, topic))
