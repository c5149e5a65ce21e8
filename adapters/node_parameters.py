"""Parameters of all nodes, read and set concurrently through their services; events update the list.

Declarations are requested together with the names, and those of new parameters soon after their event. A parameter's
name is NODE + "/" + PARAMETER. Everything here runs on the ROS thread.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from typing import Any, Protocol, TypeAlias, cast

from msgspec import Struct, field

from rosld.adapters.model import (
    Descriptor,
    NotFound,
    Operation,
    Parameter,
    Refused,
    RosError,
    Sent,
    TimedOut,
    Unreachable,
    freeze,
)
from rosld.adapters.model.names import global_name, segments
from rosld.adapters.model.parameter import ParameterValue, as_declared
from rosld.adapters.model.plain import MessageFactory
from rosld.adapters.parameter_messages import Tag, descriptor_of, from_message, operations_on, to_fields
from rosld.adapters.thread import Tasks

_SERVICES = {
    "list_parameters": "rcl_interfaces/srv/ListParameters",
    "describe_parameters": "rcl_interfaces/srv/DescribeParameters",
    "get_parameters": "rcl_interfaces/srv/GetParameters",
    "set_parameters": "rcl_interfaces/srv/SetParameters",
    "set_parameters_atomically": "rcl_interfaces/srv/SetParametersAtomically",
}
_PATIENCE = 2.0
_FIRST_RETRY = 2.0
_LONGEST_RETRY = 60.0
_AGAIN = 60.0
_AT_ONCE = 16
_MAX_PARAMETERS = 20_000


Names: TypeAlias = Mapping[str, Sequence[str]]
"""Names of services, with the names of their types."""


class NodeCalls(Protocol):
    """Calls of the nodes' services, with messages of a factory."""

    @property
    def messages(self) -> MessageFactory: ...

    async def call(self, service: str, type: str, request: object, until: float) -> object:
        """Return the response; `until` is a time of the running loop. Raises TimedOut, Unreachable, UnknownType."""


class _Owner(Struct):
    """A node with parameters: their names and declarations, and the time of its next query.

    `new` are names with declarations yet to be requested; `describes` is whether the node returns declarations.
    """

    names: frozenset[str] = frozenset()
    descriptors: dict[str, Descriptor] = field(default_factory=dict)
    new: frozenset[str] = frozenset()
    describes: bool = False
    query_at: float = 0.0
    wait: float = _FIRST_RETRY
    is_querying: bool = False
    uses_simulated_time: bool = False
    generation: int = 0

    def learn(self, names: Set[str], descriptors: Mapping[str, Descriptor]) -> None:
        """Set the complete declarations of these names."""
        others = {name: each for name, each in self.descriptors.items() if name not in names}
        self.descriptors = {name: each for name, each in {**others, **descriptors}.items() if name in self.names}


class Parameters(Struct):
    """Parameters of all nodes except ours. `changed` is called with the names of changed parameters."""

    calls: NodeCalls
    changed: Callable[[Sequence[str]], None]
    owners: dict[str, _Owner] = field(default_factory=dict)
    unreachable: dict[str, str] = field(default_factory=dict)
    _listed: Mapping[str, Parameter] = field(default_factory=dict)
    queries: Tasks = field(default_factory=Tasks)
    """Pending queries of nodes."""
    _few: asyncio.Semaphore = field(default_factory=lambda: asyncio.Semaphore(_AT_ONCE))

    @property
    def graph_parameters(self) -> Mapping[str, Parameter]:
        """Return the parameters by name; the same object until one is added or removed."""
        return self._listed

    @property
    def simulated_time(self) -> bool:
        """Whether a node has `use_sim_time` set."""
        return any(owner.uses_simulated_time for owner in self.owners.values())

    def follow(self, providers: Mapping[str, Names], ours: Iterable[str]) -> None:
        """Set the present nodes (with their services); query those that are new, did not respond, or are due."""
        present = {node for node in providers if _provides(providers, node, "list_parameters")} - set(ours)
        for former in self.owners.keys() - present:
            del self.owners[former]
        for former in self.unreachable.keys() - present:
            del self.unreachable[former]
        now = asyncio.get_running_loop().time()
        for node in present:
            owner = self.owners.setdefault(node, _Owner())
            owner.describes = _provides(providers, node, "describe_parameters")
            if not owner.is_querying and now >= owner.query_at:
                owner.is_querying = True
                self.queries.begin(self._list(node, owner))
        self._refresh_list()

    def event(self, event: Any) -> None:
        """Process a rcl_interfaces/ParameterEvent of a node."""
        node = global_name(event.node)
        new, deleted = ([each.name for each in of] for of in (event.new_parameters, event.deleted_parameters))
        set = [*new, *(each.name for each in event.changed_parameters)]
        owner = self.owners.get(node)
        if owner is not None:
            self._apply_changes(node, owner, set, deleted, new)
            if "use_sim_time" in set:
                owner.query_at = 0.0
        self.changed([f"{node}/{name}" for name in (*set, *deleted)])

    def owner_of(self, name: str) -> tuple[str, str] | None:
        """Return node and parameter for a name: the known pair, else the longest node name that is a prefix."""
        existing = self._listed.get(name)
        if existing is not None and existing.node is not None:
            return existing.node, name[len(existing.node) + 1 :]
        fits = [node for node in self.owners if name.startswith(f"{node}/") and len(name) > len(node) + 1]
        node = max(fits, key=len, default=None)
        return None if node is None else (node, name[len(node) + 1 :])

    def operations(self, name: str) -> frozenset[Operation]:
        """Return the operations on a parameter; a node may accept a new one."""
        if (existing := self._listed.get(name)) is not None:
            return operations_on(existing.descriptor)
        return frozenset({Operation.SET_PARAMETER} if self.owner_of(name) is not None else ())

    async def get(self, names: Sequence[str], until: float) -> dict[str, ParameterValue]:
        """Return the values of existing names; that of a prefix of other names is a dict."""
        trees = {name: self._below(name) for name in names if name not in self._listed}
        requested: dict[str, None] = dict.fromkeys(name for name in names if self.owner_of(name) is not None)
        requested.update(dict.fromkeys(each for below in trees.values() for each in below))
        values = await self._values(requested, until, strict=frozenset(names))
        return {
            name: values[name]
            if name in values
            else tree_below(name, {each: values[each] for each in below if each in values})
            for name in names
            for below in [trees.get(name, [])]
            if name in values or below or name == "/"
        }

    async def set(self, values: Mapping[str, ParameterValue], until: float) -> None:
        """Set parameters, all or none of each node. Raises Refused naming the parameter, NotFound, TimedOut."""
        by_node: dict[str, dict[str, tuple[str, ParameterValue]]] = {}
        for name, value in values.items():
            node, parameter = self._owner(name)
            if (existing := self._listed.get(name)) is not None:
                value = as_declared(value, existing.descriptor)
            if value != []:
                to_fields(name, value)
            by_node.setdefault(node, {})[parameter] = name, value
        await _all_done(*(self._set(node, changes, until) for node, changes in by_node.items()))

    async def delete(self, names: Sequence[str], until: float) -> None:
        """Delete parameters, or those below a prefix. Raises NotFound, Refused."""
        by_node: dict[str, list[str]] = {}
        for name in names:
            leaves = [name] if name in self._listed else self._below(name)
            if not leaves:
                raise NotFound(f"there is no parameter {name}")
            for leaf in leaves:
                node, parameter = self._owner(leaf)
                by_node.setdefault(node, []).append(parameter)
        await _all_done(*(self._delete(node, parameters, until) for node, parameters in by_node.items()))

    def _owner(self, name: str) -> tuple[str, str]:
        found = self.owner_of(name)
        if found is None:
            raise NotFound(f"the parameter {name} belongs to no node: its name is a node's name, a slash, and its own")
        return found

    def _below(self, name: str) -> list[str]:
        """Return the names of the parameters below a prefix that is not itself a parameter."""
        prefix = "/" if name == "/" else f"{name}/"
        return [each for each in self._listed if each.startswith(prefix)]

    async def _values(self, names: Iterable[str], until: float, *, strict: frozenset[str]) -> dict[str, ParameterValue]:
        """Return the values of parameters. A node that does not respond is an error only for `strict` names."""
        by_node: dict[str, list[tuple[str, str]]] = {}
        for name in names:
            node, parameter = self._owner(name)
            by_node.setdefault(node, []).append((name, parameter))

        async def query(node: str, pairs: list[tuple[str, str]]) -> dict[str, ParameterValue]:
            try:
                return await self._query_values(node, pairs, until)
            except (TimedOut, Unreachable):
                if any(name in strict for name, _ in pairs):
                    raise
                return {}

        answers = await _all(*(query(node, pairs) for node, pairs in by_node.items()))
        return {name: value for answer in answers for name, value in answer.items()}

    async def _query_values(self, node: str, pairs: list[tuple[str, str]], until: float) -> dict[str, ParameterValue]:
        response = await self._query(node, "get_parameters", {"names": [parameter for _, parameter in pairs]}, until)
        if len(response.values) != len(pairs):  # a parameter is undeclared, which makes the whole response empty
            if len(pairs) == 1:
                return {}
            halves = (pairs[: len(pairs) // 2], pairs[len(pairs) // 2 :])
            answers = await _all(*(self._query_values(node, half, until) for half in halves))
            return {name: value for answer in answers for name, value in answer.items()}
        values = {name: from_message(message) for (name, _), message in zip(pairs, response.values, strict=True)}
        return {name: value for name, value in values.items() if value is not None}

    async def _set(self, node: str, changes: Mapping[str, tuple[str, ParameterValue]], until: float) -> None:
        current = await self._tags(node, [parameter for parameter, (_, value) in changes.items() if value == []], until)
        messages = [
            self._parameter(parameter, to_fields(name, value, current.get(parameter)))
            for parameter, (name, value) in changes.items()
        ]
        response = await self._query(node, "set_parameters_atomically", {"parameters": messages}, until)
        if not response.result.successful:
            names = ", ".join(name for name, _ in changes.values())
            raise _refusal(names, node, response.result.reason)
        self._note(node, set=changes.keys())

    async def _delete(self, node: str, parameters: Sequence[str], until: float) -> None:
        messages = [self._parameter(parameter, {"type": int(Tag.NOT_SET)}) for parameter in parameters]
        response = await self._query(node, "set_parameters", {"parameters": messages}, until)
        for parameter, result in zip(parameters, response.results, strict=False):
            if not result.successful:
                raise _refusal(f"{node}/{parameter}", node, result.reason)
        left = await self._names(node, until)
        for parameter in parameters:
            if parameter in left:
                raise _refusal(f"{node}/{parameter}", node, "it was declared by its node, which keeps it")
        self._note(node, deleted=parameters)

    async def _tags(self, node: str, parameters: Sequence[str], until: float) -> dict[str, int]:
        if not parameters:
            return {}
        response = await self._query(node, "get_parameters", {"names": list(parameters)}, until)
        return {name: value.type for name, value in zip(parameters, response.values, strict=False)}

    def _note(self, node: str, *, set: Iterable[str] = (), deleted: Iterable[str] = ()) -> None:
        """Apply our own change at once; the node's event follows."""
        owner = self.owners.get(node)
        if owner is not None:
            self._apply_changes(node, owner, tuple(set), tuple(deleted))
        self.changed([f"{node}/{name}" for name in (*set, *deleted)])

    def _apply_changes(
        self, node: str, owner: _Owner, set: Sequence[str], deleted: Sequence[str], new: Sequence[str] = ()
    ) -> None:
        """Process added and deleted parameters; request the declarations of new ones soon."""
        owner.generation += 1
        room = max(0, _MAX_PARAMETERS - len(owner.names))
        added = [name for name in dict.fromkeys(set) if name not in owner.names][:room]
        owner.names = owner.names.union(added).difference(deleted)
        for name in deleted:
            owner.descriptors.pop(name, None)
        self._refresh_list()
        is_running = bool(owner.new)
        owner.new = owner.names.intersection(owner.new.union(added, new))
        if owner.new and not is_running and owner.describes:
            self.queries.begin(self._describe_new(node, owner))

    async def _list(self, node: str, owner: _Owner) -> None:
        loop = asyncio.get_running_loop()
        generation = owner.generation
        try:
            async with self._few:
                names = await self._names(node, loop.time() + _PATIENCE)
                simulated, descriptors = await _all(
                    self._simulated(node, names, loop.time() + _PATIENCE), self._describe(node, owner, names)
                )
        except (RosError, ValueError) as error:
            self._retry_later(owner)
            if self.owners.get(node) is owner:
                self.unreachable[node] = f"it does not report its parameters: {error}"
        else:
            owner.query_at = loop.time() + _AGAIN
            if descriptors is not None:
                owner.wait = _FIRST_RETRY
            owner.uses_simulated_time = simulated
            if generation == owner.generation:  # else an event was newer than this response
                owner.names = names
            else:
                owner.query_at = loop.time() + _FIRST_RETRY
            if descriptors is None:
                self._retry_later(owner)
            else:
                owner.learn(names, descriptors)
            self.unreachable.pop(node, None)
        finally:
            owner.is_querying = False
        self._refresh_list()
        self.changed([])

    async def _names(self, node: str, until: float) -> frozenset[str]:
        response = await self._query(node, "list_parameters", {"prefixes": [], "depth": 0}, until)
        return frozenset(list(response.result.names)[:_MAX_PARAMETERS])

    def _retry_later(self, owner: _Owner) -> None:
        """Schedule another query of a node, with an increasing delay."""
        owner.query_at = asyncio.get_running_loop().time() + owner.wait
        owner.wait = min(2 * owner.wait, _LONGEST_RETRY)

    async def _describe(self, node: str, owner: _Owner, names: Iterable[str]) -> dict[str, Descriptor] | None:
        """Return a node's declarations of parameters, or None if it does not respond in time."""
        declarations: dict[str, Descriptor] = {}
        pending = [sorted(names)] if owner.describes else []
        until = asyncio.get_running_loop().time() + _PATIENCE
        try:
            while pending:
                batch = pending.pop()
                response = await self._query(node, "describe_parameters", {"names": batch}, until)
                if len(response.descriptors) == len(batch):
                    descriptors = zip(batch, map(descriptor_of, response.descriptors), strict=True)
                    declarations.update(
                        (name, descriptor) for name, descriptor in descriptors if descriptor is not None
                    )
                elif len(batch) > 1:  # one of them is undeclared, which makes the whole response empty
                    pending += (batch[: len(batch) // 2], batch[len(batch) // 2 :])
        except (RosError, ValueError):
            return None
        return declarations

    async def _describe_new(self, node: str, owner: _Owner) -> None:
        """Request the declarations of new parameters until there are no more."""
        while owner.new and self.owners.get(node) is owner:
            names = owner.new
            async with self._few:
                descriptors = await self._describe(node, owner, names)
            if descriptors is None:
                owner.new = frozenset()
                self._retry_later(owner)
                return
            owner.new = (owner.new - names) & owner.names
            owner.learn(names, descriptors)
            self._refresh_list()
            self.changed([])

    async def _simulated(self, node: str, names: frozenset[str], until: float) -> bool:
        if "use_sim_time" not in names:
            return False
        response = await self._query(node, "get_parameters", {"names": ["use_sim_time"]}, until)
        return [from_message(value) for value in response.values] == [True]

    async def _query(self, node: str, service: str, fields: dict[str, object], until: float) -> Any:
        type = _SERVICES[service]
        request = self.calls.messages.make_message(type, fields, "Request")
        return cast(Any, await self.calls.call(f"{node}/{service}", type, request, until))

    def _parameter(self, name: str, fields: dict[str, object]) -> object:
        make = self.calls.messages.make_message
        value = make("rcl_interfaces/msg/ParameterValue", fields)
        return make("rcl_interfaces/msg/Parameter", {"name": name, "value": value})

    def _refresh_list(self) -> None:
        names = {
            f"{node}/{parameter}": Parameter(f"{node}/{parameter}", node, owner.descriptors.get(parameter))
            for node, owner in sorted(self.owners.items())
            for parameter in sorted(owner.names)
        }
        if names != self._listed:
            self._listed = freeze(names)


def _provides(providers: Mapping[str, Names], node: str, service: str) -> bool:
    """Whether a node has this parameter service."""
    return _SERVICES[service] in providers[node].get(f"{node}/{service}", ())


async def _all(*coroutines: Any) -> list[Any]:
    """Return all results; wait for all coroutines before raising the first error."""
    results = await asyncio.gather(*coroutines, return_exceptions=True)
    for result in results:
        if isinstance(result, BaseException):
            raise result
    return list(results)


async def _all_done(*writes: Any) -> None:
    """Execute writes to several nodes. The error reports whether another node may have been changed."""
    results = await asyncio.gather(*writes, return_exceptions=True)
    errors = [each for each in results if isinstance(each, BaseException)]
    for error in errors:
        if isinstance(error, RosError) and error.sent is Sent.NO and len(errors) < len(results):
            error.sent = Sent.MAYBE
        raise error


def tree_below(name: str, values: Mapping[str, ParameterValue]) -> ParameterValue:
    """Return the values below a name as nested dicts; a leaf yields to a tree of the same name."""
    root: dict[str, ParameterValue] = {}
    start = len(segments(name))
    for each in sorted(values):
        *above, last = segments(each)[start:]
        place = root
        for step in above:
            below = place.get(step)
            if not isinstance(below, dict):
                below = place[step] = {}
            place = below
        place[last] = values[each]
    return root


def _refusal(name: str, node: str, reason: str) -> Refused:
    return Refused(f"{node} refuses the parameter {name}", words=reason or None, sent=Sent.YES)
