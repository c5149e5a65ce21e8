"""Parameters with dynamic_reconfigure, which their nodes describe and set, so that changes take effect.

The servers' topics are read without registering, like any topic. Nodes write accepted values to the master's tree, from
which they are read like all parameters.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Mapping, Sequence

from msgspec import Struct, field

from rosld.adapters.model import Descriptor, Parameter, Refused, Sent, coerce
from rosld.adapters.model.parameter import ParameterValue
from rosld.adapters.ros1.graph import SystemState
from rosld.adapters.ros1.reconfiguration import (
    DESCRIPTIONS,
    SERVICE,
    SET,
    UPDATES,
    Scalar,
    Server,
    read_config,
    read_descriptors,
    request_of,
    servers_of,
)
from rosld.adapters.ros1.services import Services
from rosld.adapters.ros1.sources import Nodes, TopicReader
from rosld.adapters.ros1.subscription import MessageFeed
from rosld.adapters.ros1.types import Types

_DEPTH = 1


class _FollowedServer(Struct):
    """A followed server: its readers, its declarations, and its last reported values."""

    node: str
    readers: dict[str, TopicReader] = field(default_factory=dict)
    descriptors: Mapping[str, Descriptor] = field(default_factory=dict)
    values: Mapping[str, Scalar] = field(default_factory=dict)
    description_event: asyncio.Event = field(default_factory=asyncio.Event)


class Reconfigurables:
    """The dynamic_reconfigure servers in a ROS system. All methods run on the reading thread.

    `described` is called after changes of declarations, `changed` with the names of parameters whose nodes report new
    values.
    """

    def __init__(
        self,
        nodes: Nodes,
        types: Types,
        services: Services,
        described: Callable[[], None],
        changed: Callable[[Sequence[str]], None],
    ) -> None:
        self._nodes = nodes
        self._types = types
        self._services = services
        self._described = described
        self._changed = changed
        self._followed: dict[str, _FollowedServer] = {}
        self._parameters: Mapping[str, Parameter] = {}

    def follow(self, system: SystemState) -> None:
        """Update the set of servers and their publishers."""
        servers = {one.namespace: one for one in servers_of(system.publishers, system.services, system.topic_types)}
        for namespace in self._followed.keys() - servers.keys():
            self._stop(namespace)
        for namespace, server in servers.items():
            followed = self._followed.get(namespace)
            if followed is None or followed.node != server.node:
                if followed is not None:
                    self._stop(namespace)
                followed = self._followed[namespace] = self._begin(server)
            for part, reader in followed.readers.items():
                reader.follow(system.publishers.get(f"{namespace}/{part}", ()))

    def close(self) -> None:
        """Stop following all servers."""
        for namespace in list(self._followed):
            self._stop(namespace)

    async def wait_described(self, patience: float) -> None:
        """Wait until every server has described its parameters, for at most `patience` seconds."""
        waits = [asyncio.ensure_future(each.description_event.wait()) for each in self._followed.values()]
        if waits:
            _, late = await asyncio.wait(waits, timeout=patience)
            for each in late:
                each.cancel()

    def with_descriptors(self, parameters: Mapping[str, Parameter]) -> Mapping[str, Parameter]:
        """Return the parameters of a graph, with the declarations of their nodes."""
        declared = {name: parameter for name, parameter in self._parameters.items() if name in parameters}
        return {**parameters, **declared} if declared else parameters

    async def set(self, values: Mapping[str, ParameterValue], until: float) -> Mapping[str, ParameterValue]:
        """Set values at the nodes that declare them, with one request per node; return the accepted values.

        Raises Refused for a value of another type, before anything is sent, and what `Services.call` raises.
        """
        requests = {namespace: own for namespace in self._followed if (own := self._own(namespace, values))}
        accepted: dict[str, ParameterValue] = {}
        for namespace, own in requests.items():
            answer = await self._services.call(f"{namespace}/{SET}", SERVICE, request_of(own), until)
            try:
                config = read_config(answer)
            except ValueError as error:
                raise Refused(f"the answer of {namespace}/{SET} cannot be read: {error}", sent=Sent.YES) from error
            accepted |= {f"{namespace}/{name}": config.get(name, value) for name, value in own.items()}
        return accepted

    def _own(self, namespace: str, values: Mapping[str, ParameterValue]) -> dict[str, Scalar]:
        """Return the values that a server declares, by its own names and converted to its types. Raises Refused."""
        descriptors = self._followed[namespace].descriptors
        scalars: dict[str, Scalar] = {}
        for name, value in values.items():
            own = name.removeprefix(f"{namespace}/")
            descriptor = descriptors.get(own) if own != name else None
            if descriptor is not None and descriptor.type is not None:
                fit = coerce(value, descriptor.type)
                if not isinstance(fit, bool | int | float | str):
                    raise Refused(
                        f"the parameter {name} cannot be {value!r}: its node declares a {descriptor.type.value}"
                    )
                scalars[own] = fit
        return scalars

    def _begin(self, server: Server) -> _FollowedServer:
        followed = _FollowedServer(server.node)
        namespace = server.namespace

        def take_description(data: bytes) -> None:
            followed.descriptors = read_descriptors(data)
            followed.description_event.set()
            self._describe()

        def take_update(data: bytes) -> None:
            before, followed.values = followed.values, read_config(data)
            new = [name for name, value in followed.values.items() if name not in before or before[name] != value]
            self._changed([f"{namespace}/{name}" for name in new])

        for part, take in ((DESCRIPTIONS, take_description), (UPDATES, take_update)):
            feed = MessageFeed(f"{namespace}/{part}", take, _DEPTH)
            followed.readers[part] = TopicReader(feed, self._nodes, self._types, 0)
        return followed

    def _stop(self, namespace: str) -> None:
        for reader in self._followed.pop(namespace).readers.values():
            reader.close()
        self._describe()

    def _describe(self) -> None:
        self._parameters = dict(self._declared_parameters())
        self._described()

    def _declared_parameters(self) -> Iterator[tuple[str, Parameter]]:
        for namespace, followed in self._followed.items():
            for own, descriptor in followed.descriptors.items():
                name = f"{namespace}/{own}"
                yield name, Parameter(name, followed.node, descriptor)
