"""The graph of a robot behind rosbridge, as rosapi's services describe it."""

from __future__ import annotations

import asyncio
import re
import time
from collections.abc import Awaitable, Callable, Collection, Mapping, Sequence
from typing import Any

from msgspec import Struct, field

from rosld.adapters.model import Action, Endpoint, Node, Refused, RosError, Service, Topic, TypeRef
from rosld.adapters.rosbridge.client import Client
from rosld.adapters.rosbridge.protocol import full_name

_WHOLE = 5.0
"""Seconds after which all nodes are asked for their endpoints again."""
_AT_ONCE = 8
_OF_NODES = {
    "describe_parameters": "rcl_interfaces/srv/DescribeParameters",
    "get_parameter_types": "rcl_interfaces/srv/GetParameterTypes",
    "get_parameters": "rcl_interfaces/srv/GetParameters",
    "list_parameters": "rcl_interfaces/srv/ListParameters",
    "set_parameters": "rcl_interfaces/srv/SetParameters",
    "set_parameters_atomically": "rcl_interfaces/srv/SetParametersAtomically",
    "get_type_description": "type_description_interfaces/srv/GetTypeDescription",
}
"""Types of services that every node of ROS 2 has, by the ends of their names: rosapi would be asked for each."""
_BRIDGES = ("/rosbridge_websocket",)
_ACTION_TYPE = re.compile(r"(\w+)/action/(\w+)_GetResult|class (\w+)_GetResult from package (\w+)")


class NodeDetails(Struct, frozen=True):
    """Topics and services of a node."""

    publishing: frozenset[str] = frozenset()
    subscribing: frozenset[str] = frozenset()
    services: frozenset[str] = frozenset()


class Observation(Struct):
    """Reports of rosapi: types of topics, services and actions (empty if unknown), and details by node."""

    topics: dict[str, str] = field(default_factory=dict)
    services: dict[str, str] = field(default_factory=dict)
    actions: dict[str, str] = field(default_factory=dict)
    nodes: dict[str, NodeDetails] = field(default_factory=dict)


def is_bridge(node: str) -> bool:
    """Whether a node is a rosbridge server, by its name."""
    return "rosbridge" in node.rpartition("/")[2]


class Observer:
    """Asks rosapi for the graph."""

    def __init__(self, client: Client) -> None:
        self.observation = Observation()
        self._client = client
        self._untyped: set[str] = set()
        """Actions whose types the bridge does not tell."""
        self._whole_at = 0.0
        self._has_actions = self._has_rosapi = True
        self._few = asyncio.Semaphore(_AT_ONCE)

    async def poll(self, until: float, *, ros2: bool, whole: bool) -> None:
        """Update the observation. Raises RosError."""
        before = self.observation
        queries = (self._client.rosapi(each, {}, until) for each in ("topics", "nodes", "services"))
        topics, nodes, services = await asyncio.gather(*queries)
        named = dict(zip(topics.get("topics", ()), topics.get("types", ()), strict=False))
        names, present = nodes.get("nodes", ()), services.get("services", ())
        changed = set(names) != before.nodes.keys() or named != before.topics or set(present) != before.services.keys()
        self._has_rosapi = any("rosapi" in each for each in names)
        details = before.nodes
        if whole or changed or time.monotonic() > self._whole_at:
            found = await asyncio.gather(*(self._details(each, until) for each in names))
            details = dict(zip(names, found, strict=True))
            self._whole_at = time.monotonic() + _WHOLE
        types = await self._typed(self._service_type, present, before.services, until)
        actions = await self._actions(before, until) if ros2 and self._has_actions else {}
        self.observation = Observation(named, types, actions, details)

    async def _details(self, node: str, until: float) -> NodeDetails:
        async with self._few:
            try:
                answer = await self._client.rosapi("node_details", {"node": node}, until)
            except RosError:  # it went away, or takes longer than the others
                return self.observation.nodes.get(node, NodeDetails())
        return NodeDetails(*(frozenset(answer.get(each, ())) for each in ("publishing", "subscribing", "services")))

    async def _typed(
        self,
        find: Callable[[str, float], Awaitable[str]],
        names: Sequence[str],
        known: Mapping[str, str],
        until: float,
    ) -> dict[str, str]:
        """Return the types of services or actions; those of known ones are not asked for again."""

        async def type_of(name: str) -> str:
            if found := known.get(name) or _OF_NODES.get(name.rpartition("/")[2]):
                return found
            async with self._few:
                try:
                    return await find(name, until)
                except RosError:
                    return ""

        return dict(zip(names, await asyncio.gather(*map(type_of, names)), strict=True))

    async def _actions(self, before: Observation, until: float) -> dict[str, str]:
        try:
            names = (await self._client.rosapi("action_servers", {}, until)).get("action_servers", ())
        except RosError:
            self._has_actions = False
            return {}
        return await self._typed(self._action_type, names, before.actions, until)

    async def _service_type(self, service: str, until: float) -> str:
        return str((await self._client.rosapi("service_type", {"service": service}, until)).get("type", ""))

    async def _action_type(self, action: str, until: float) -> str:
        """Return the type of an action, as rosbridge_suite names it when it cannot call the action's hidden service.

        rosapi is asked only if it is part of the bridge: `action_type` ends the node of rosapi 2.4 to 2.7.
        """
        if action in self._untyped:
            return ""
        try:  # with an invalid request, so that a bridge that could call the service does not
            await self._client.request(f"{action}/_action/get_result", {"none": None}, until)
        except Refused as error:
            if found := _ACTION_TYPE.search(error.words or ""):
                return f"{found[1] or found[4]}/action/{found[2] or found[3]}"
        if not self._has_rosapi:
            return str((await self._client.rosapi("action_type", {"action": action}, until)).get("type", ""))
        self._untyped.add(action)
        return ""


def compose(
    observation: Observation,
    own_node: str,
    published: Mapping[str, TypeRef],
    read: Collection[str],
    problems: Mapping[str, str],
) -> dict[str, Any]:
    """Return the parts of the graph: the bridge's own endpoints on topics that rosld publishes or reads are rosld's."""
    nodes = {name: Node(name) for name in observation.nodes}
    if published:
        nodes[own_node] = Node(own_node)
    publishers: dict[str, list[str]] = {}
    subscribers: dict[str, list[str]] = {}
    hidden: set[str] = set()
    providers: dict[str, list[str]] = {}
    for name, details in sorted(observation.nodes.items()):
        ours = is_bridge(name)
        for of_topic, topics, own in (
            (publishers, details.publishing, published),
            (subscribers, details.subscribing, read),
        ):
            for topic in topics:
                if ours and topic in own:
                    hidden.add(topic)
                else:
                    of_topic.setdefault(topic, []).append(name)
        for service in details.services:
            providers.setdefault(service, []).append(name)
    for topic in published:
        publishers.setdefault(topic, []).append(own_node)
    bridges = tuple(filter(is_bridge, observation.nodes)) or _BRIDGES  # rosapi hides what belongs to an action
    named = {**{topic: ref.name for topic, ref in published.items()}, **observation.topics}

    def topic_of(name: str, type: str) -> Topic:
        ref, own = TypeRef(full_name(type)) if type and type != "*" else None, published.get(name)
        if own is not None and ref is not None and own.name == ref.name:
            ref = own  # whose hash is known
        of, to = (tuple(Endpoint(node, ref) for node in nodes.get(name, ())) for nodes in (publishers, subscribers))
        return Topic(name, (ref,) if ref else (), of, to, problems.get(ref.name) if ref else None)

    return {
        "nodes": nodes,
        "topics": {
            topic: topic_of(topic, type)
            for topic, type in named.items()
            if topic in publishers or topic in subscribers or topic not in hidden
        },
        "services": {
            name: Service(name, TypeRef(full_name(type, "srv")) if type else None, tuple(providers.get(name, ())))
            for name, type in observation.services.items()
        },
        "actions": {
            name: Action(
                name,
                TypeRef(full_name(type, "action")) if type else None,
                tuple(publishers.get(f"{name}/_action/status", bridges)),
                unusable=None if type else "rosapi does not report its type",
            )
            for name, type in observation.actions.items()
        },
    }
