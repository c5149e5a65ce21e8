"""The parameters of ROS 1's master behind rosbridge, by rosapi's services."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, cast

from rosld.adapters.model import NotFound, Operation, Parameter, Refused, RosError, freeze
from rosld.adapters.model.parameter import ParameterValue
from rosld.adapters.node_parameters import Names
from rosld.adapters.parameters import Tree, check, leaves, read_name
from rosld.adapters.thread import Tasks

_EVERY = 2.0
_SHARE = 20
_SECONDS = 5.0
_ALL = frozenset({Operation.GET_PARAMETER, Operation.SET_PARAMETER, Operation.DELETE_PARAMETER})


class TreeParameters:
    """The tree, used like the `Parameters` of nodes. `changed` is called with the names of changed parameters."""

    def __init__(self, rosapi: Callable[..., Any], changed: Callable[[Sequence[str]], None]) -> None:
        self._rosapi = rosapi
        self._changed = changed
        self._tree: Tree = {}
        self._poll_at = 0.0
        self.queries = Tasks()
        self.graph_parameters: Mapping[str, Parameter] = {}

    @property
    def simulated_time(self) -> bool:
        """Whether `/use_sim_time` is set."""
        return self._tree.get("use_sim_time") is True

    def operations(self, name: str) -> frozenset[Operation]:
        """Return the operations on a parameter; one that does not exist may be created."""
        return _ALL if name in self.graph_parameters else frozenset({Operation.SET_PARAMETER})

    def follow(self, providers: Mapping[str, Names], ours: Iterable[str]) -> None:
        """Read the tree again if it is due."""
        if time.monotonic() > self._poll_at and not self.queries:
            self.queries.begin(self._poll())

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
