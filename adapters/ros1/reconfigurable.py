"""Parameters with dynamic_reconfigure, which their nodes describe and set, so that changes take effect.

A server in a namespace (`/camera`, or `/camera/driver`) has a service `set_parameters` and two latched topics:
`parameter_descriptions` describes each parameter and its limits, `parameter_updates` has the values of all. The
topics are read without registering, like any topic. Nodes write accepted values to the master's tree, from which they
are read like all parameters.
"""

from __future__ import annotations

import ast
import asyncio
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, TypeAlias

from msgspec import Struct, field

from rosld.adapters.model import Choice, Descriptor, Parameter, ParameterType, Range, Refused, Sent, TypeRef, coerce
from rosld.adapters.model.parameter import ParameterValue, shortened
from rosld.adapters.ros1.graph import SystemState
from rosld.adapters.ros1.services import Services
from rosld.adapters.ros1.sources import Nodes, TopicReader
from rosld.adapters.ros1.subscription import MessageFeed
from rosld.adapters.ros1.types import Types
from rosld.adapters.ros1.wire import decode, encode

Scalar: TypeAlias = "bool | int | float | str"

DESCRIPTIONS, UPDATES, SET = "parameter_descriptions", "parameter_updates", "set_parameters"
SERVICE = TypeRef("dynamic_reconfigure/srv/Reconfigure")
_DESCRIPTION = "dynamic_reconfigure/ConfigDescription"
_MAX_CHOICES = 1_000
_MAX_METHOD = 100_000
_MAX_NESTED = 8
_TYPES: Mapping[str, ParameterType] = {
    "bool": ParameterType.BOOLEAN,
    "int": ParameterType.INTEGER,
    "double": ParameterType.DOUBLE,
    "str": ParameterType.STRING,
}
_PARTS: Mapping[type, str] = {bool: "bools", int: "ints", str: "strs", float: "doubles"}
_TOKEN = re.compile(
    r"\s+|[\[{(]|[\]}),:]|True|False|None"
    r"|[uU]?'(?:[^'\\\n]|\\.)*'|[uU]?\"(?:[^\"\\\n]|\\.)*\""
    r"|[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
)
"""Tokens of Python values of dicts, lists, strings and numbers."""


def servers_of(
    publishers: Mapping[str, tuple[str, ...]], services: Mapping[str, tuple[str, ...]], types: Mapping[str, str]
) -> Iterator[tuple[str, str]]:
    """Yield namespaces and nodes of the servers, given the nodes by topic and by service, and the types of topics."""
    for topic, type in types.items():
        namespace, _, last = topic.rpartition("/")
        if type != _DESCRIPTION or last != DESCRIPTIONS or not publishers.get(topic):
            continue
        if providers := services.get(f"{namespace}/{SET}"):
            yield namespace, providers[0]


def read_config(data: bytes) -> Mapping[str, Scalar]:
    """Return the values in a dynamic_reconfigure/Config. Raises ValueError."""
    return _config(decode("dynamic_reconfigure/msg/Config", data))


def _config(message: Any) -> Mapping[str, Scalar]:
    return {each.name: each.value for part in _PARTS.values() for each in getattr(message, part)}


def read_descriptors(data: bytes) -> Mapping[str, Descriptor]:
    """Return the declarations in a dynamic_reconfigure/ConfigDescription, by local name. Raises ValueError."""
    message = decode("dynamic_reconfigure/msg/ConfigDescription", data)
    greatest, least = _config(message.max), _config(message.min)
    return {
        each.name: Descriptor(
            _TYPES[each.type],
            shortened(each.description),
            range=_range(_TYPES[each.type], least.get(each.name), greatest.get(each.name)),
            choices=tuple(_choices(_TYPES[each.type], each.edit_method)),
        )
        for group in message.groups
        for each in group.parameters
        if each.type in _TYPES
    }


def _range(type: ParameterType, least: Scalar | None, greatest: Scalar | None) -> Range | None:
    """Return the range of a number; None without one, or if its ends are invalid."""
    if type not in (ParameterType.INTEGER, ParameterType.DOUBLE):
        return None
    if isinstance(least, bool | str | None) or isinstance(greatest, bool | str | None):
        return None
    return Range(least, greatest) if least <= greatest and not (least == -math.inf and greatest == math.inf) else None


def _choices(type: ParameterType, edit_method: str) -> Iterator[Choice]:
    """Yield the values of an enumeration (`{'enum': [{'name': 'Small', 'value': 0, ...}, ...]}`) that have the type."""
    method = _python_value(edit_method)
    listed = method.get("enum") if isinstance(method, dict) else None
    for each in listed[:_MAX_CHOICES] if isinstance(listed, list) else ():
        if not isinstance(each, dict):
            continue
        value = each.get("value")
        fit = coerce(value, type) if isinstance(value, bool | int | float | str) else None
        if isinstance(fit, bool | int | float | str):
            yield Choice(fit, _words(each.get("name")), _words(each.get("description")))


def _python_value(text: str) -> object:
    """Return the value of a Python literal of dicts, lists, strings and numbers, or None for anything else.

    The text is checked first, because deep nesting would crash Python's parser.
    """
    if not text or len(text) > _MAX_METHOD:
        return None
    place = depth = 0
    while place < len(text):
        token = _TOKEN.match(text, place)
        if token is None:
            return None
        depth += (token[0] in "[{(") - (token[0] in "]})")
        if not 0 <= depth <= _MAX_NESTED:
            return None
        place = token.end()
    try:
        return ast.literal_eval(text.strip())
    except (ValueError, SyntaxError, TypeError, MemoryError, RecursionError):
        return None


def _words(value: object) -> str:
    return shortened(value) if isinstance(value, str) else ""


def request_of(values: Mapping[str, Scalar]) -> bytes:
    """Return a dynamic_reconfigure/Reconfigure request that sets only these parameters, by local name."""
    parts: dict[str, list[object]] = {part: [] for part in _PARTS.values()}
    for name, value in values.items():
        parts[_PARTS[type(value)]].append({"name": name, "value": value})
    return encode("dynamic_reconfigure/msg/Config", parts)


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
        servers = dict(servers_of(system.publishers, system.services, system.topic_types))
        for namespace in self._followed.keys() - servers.keys():
            self._stop(namespace)
        for namespace, node in servers.items():
            followed = self._followed.get(namespace)
            if followed is None or followed.node != node:
                if followed is not None:
                    self._stop(namespace)
                followed = self._followed[namespace] = self._begin(namespace, node)
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

    def _begin(self, namespace: str, node: str) -> _FollowedServer:
        followed = _FollowedServer(node)

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
