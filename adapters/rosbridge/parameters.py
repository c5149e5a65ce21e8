"""Parameters behind rosbridge: ROS 1's tree by rosapi's services, and those of ROS 2's nodes by the nodes' services."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, cast

from rosld.adapters.model import NotFound, Operation, Parameter, Refused, RosError, freeze
from rosld.adapters.model.parameter import ParameterValue
from rosld.adapters.model.plain import MessageFactory
from rosld.adapters.node_parameters import Parameters
from rosld.adapters.parameter_messages import operations_on
from rosld.adapters.parameters import Tree, check, leaves, read_name
from rosld.adapters.rosbridge.client import Client
from rosld.adapters.rosbridge.graph import Observation
from rosld.adapters.rosbridge.topics import Readers
from rosld.adapters.thread import Tasks

_EVERY = 2.0
_SHARE = 20
_SECONDS = 5.0
_EVENTS = "/parameter_events"
_EVENT = "rcl_interfaces/msg/ParameterEvent"
_ALL = frozenset({Operation.GET_PARAMETER, Operation.SET_PARAMETER, Operation.DELETE_PARAMETER})


class TreeParameters:
    """The parameters of ROS 1's master. `changed` is called with the names of changed ones."""

    def __init__(self, rosapi: Callable[..., Any], changed: Callable[[Sequence[str]], None]) -> None:
        self._rosapi = rosapi
        self._changed = changed
        self._tree: Tree = {}
        self._poll_at = 0.0
        self._tasks = Tasks()
        self.graph_parameters: Mapping[str, Parameter] = {}

    @property
    def simulated_time(self) -> bool:
        """Whether `/use_sim_time` is set."""
        return self._tree.get("use_sim_time") is True

    def operations(self, name: str) -> frozenset[Operation]:
        """Return the operations on a parameter; one that does not exist may be created."""
        return _ALL if name in self.graph_parameters else frozenset({Operation.SET_PARAMETER})

    def follow(self, observation: Observation) -> None:
        """Read the tree again if it is due."""
        if time.monotonic() > self._poll_at and not self._tasks:
            self._tasks.begin(self._poll())

    async def wait(self, seconds: float) -> None:
        """Wait for pending queries."""
        await self._tasks.wait(seconds)

    def close(self) -> None:
        """Stop reading the tree."""
        self._tasks.cancel()

    async def get(self, names: Sequence[str], until: float) -> dict[str, ParameterValue]:
        """Return the values of existing names; a namespace is a dict."""
        values = {name: await self._read(name, until) for name in names}
        return {name: value for name, value in values.items() if value is not None}

    async def set(self, values: Mapping[str, ParameterValue], until: float) -> None:
        """Set parameters; all are checked before the first is sent. Raises Refused naming the parameter."""
        texts = {name: _json(name, value) for name, value in values.items()}
        for name, text in texts.items():
            await self._rosapi("set_param", {"name": name, "value": text}, until)
        await self._poll()

    async def delete(self, names: Sequence[str], until: float) -> None:
        """Delete parameters and namespaces. Raises NotFound."""
        for name in names:
            if await self._read(name, until) is None:
                raise NotFound(f"there is no parameter {name!r}")
        for name in names:
            await self._rosapi("delete_param", {"name": name}, until)
        await self._poll()

    async def _read(self, name: str, until: float) -> ParameterValue | None:
        answer = await self._rosapi("get_param", {"name": name, "default": ""}, until)
        try:
            return cast("ParameterValue | None", json.loads(answer.get("value") or "null"))
        except ValueError as error:
            raise Refused(f"the value of {name} cannot be read: {error}") from error

    async def _poll(self) -> None:
        started = time.monotonic()
        try:
            tree = await self._read("/", asyncio.get_running_loop().time() + _SECONDS)
        except RosError:
            return
        finally:
            self._poll_at = time.monotonic() + max(_EVERY, _SHARE * (time.monotonic() - started))
        before, self._tree = self._tree, tree if isinstance(tree, dict) else {}
        names = set(leaves(self._tree))
        differing = [
            each for each in {*leaves(before), *names} if read_name(before, each) != read_name(self._tree, each)
        ]
        if differing:
            if names != self.graph_parameters.keys():
                self.graph_parameters = freeze({name: Parameter(name) for name in sorted(names)})
            self._changed(differing)


def _json(name: str, value: ParameterValue) -> str:
    check(name, value)
    try:
        return json.dumps(value)
    except TypeError as error:
        raise Refused(
            f"the parameter {name} cannot be {value!r}: JSON, which rosapi takes, has no such value"
        ) from error


class NodeParameters:
    """The parameters of ROS 2's nodes, called through the bridge."""

    def __init__(self, client: Client, readers: Readers, changed: Callable[[Sequence[str]], None]) -> None:
        self._client = client
        self._parameters = Parameters(self, changed)
        self._schema = client.messages.schema(_EVENT)
        readers.listen(_EVENTS, lambda data, _: self._take(data), self._schema)
        self.get, self.set, self.delete = self._parameters.get, self._parameters.set, self._parameters.delete

    @property
    def messages(self) -> MessageFactory:
        """Factory of the messages in calls."""
        return self._client.messages

    @property
    def graph_parameters(self) -> Mapping[str, Parameter]:
        """Parameters by name."""
        return self._parameters.graph_parameters

    @property
    def simulated_time(self) -> bool:
        """Whether a node has `use_sim_time` set."""
        return self._parameters.simulated_time

    async def call(self, service: str, type: str, request: object, until: float) -> object:
        """Return the response of a node's service."""
        messages = self._client.messages
        halves = messages.schema(type, "Request"), messages.schema(type, "Response")
        return await self._client.call_parts(service, *halves, request, until)

    def operations(self, name: str) -> frozenset[Operation]:
        """Return the operations on a parameter; a node may accept a new one."""
        if (parameter := self.graph_parameters.get(name)) is not None:
            return operations_on(parameter.descriptor)
        return frozenset({Operation.SET_PARAMETER} if self._parameters.owner_of(name) is not None else ())

    def follow(self, observation: Observation) -> None:
        """Query the parameters of new nodes."""
        self._parameters.follow(dict(_providers(observation)), ())

    async def wait(self, seconds: float) -> None:
        """Wait for pending queries."""
        await self._parameters.queries.wait(seconds)

    def close(self) -> None:
        """Stop querying nodes."""
        self._parameters.queries.cancel()

    def _take(self, data: bytes) -> None:
        try:
            event: Any = self._schema.codec.decode(data, self._client.encoding)
        except ValueError:
            return
        self._parameters.event(event)


def _providers(observation: Observation) -> Iterator[tuple[str, dict[str, tuple[str, ...]]]]:
    for node, details in observation.nodes.items():
        yield node, {service: (observation.services.get(service, ""),) for service in details.services}
