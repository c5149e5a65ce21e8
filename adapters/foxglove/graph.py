"""The computation graph behind a Foxglove server, composed from the state of the server."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from msgspec import Struct, field

from rosld.adapters.foxglove.types import Channel, ServiceOffer
from rosld.adapters.model import Endpoint, Node, Parameter, ParameterValue, Service, Topic, TypeRef
from rosld.adapters.model.foxglove_protocol import Json
from rosld.adapters.model.names import global_name

_NODE = re.compile(r"\W+", re.ASCII)
_PUBLISHED, _SUBSCRIBED, _SERVICES = "publishedTopics", "subscribedTopics", "advertisedServices"
_MEMBERS = {_PUBLISHED: "publisherIds", _SUBSCRIBED: "subscriberIds", _SERVICES: "providerIds"}


class Peer(Struct):
    """The state of the server, as received over the current or last connection.

    `connections` are nodes by name, for each member of the connection graph; None before the first.
    """

    info: Json = field(default_factory=dict)
    since: float = 0.0
    channels: dict[int, Channel] = field(default_factory=dict)
    services: dict[int, ServiceOffer] = field(default_factory=dict)
    connections: dict[str, dict[str, tuple[str, ...]]] | None = None
    parameters: dict[str, tuple[str, ParameterValue]] = field(default_factory=dict)
    """Values by ROS name, with the server's own name."""
    subscriptions: dict[int, Channel] = field(default_factory=dict)
    words: str | None = None
    """The last error that the server reported."""

    def can(self, capability: str) -> bool:
        """Whether the server has a capability; before the first connection, it may."""
        return not self.info or capability in self.info.get("capabilities", ())

    @property
    def encodings(self) -> Sequence[str]:
        """The encodings that the server reads."""
        return self.info.get("supportedEncodings") or ()

    def update_connections(self, message: Json) -> None:
        """Apply an update of the connection graph."""
        connections = self.connections or {kind: {} for kind in _MEMBERS}
        for kind, members in _MEMBERS.items():
            connections[kind] |= {each["name"]: tuple(each[members]) for each in message.get(kind, ())}
        for kind, removed in zip(_MEMBERS, ("removedTopics", "removedTopics", "removedServices"), strict=True):
            for name in message.get(removed, ()):
                connections[kind].pop(name, None)
        self.connections = connections

    def nodes(self, kind: str, name: str) -> tuple[str, ...]:
        """Return the nodes of a topic or service in a member of the connection graph."""
        return tuple(map(global_name, (self.connections or {}).get(kind, {}).get(name, ())))


def compose(peer: Peer, own_node: str, published: Mapping[str, TypeRef]) -> tuple[dict[str, Any], dict[str, int]]:
    """Return the parts of the graph, and the number of subscribers of each topic that rosld publishes.

    Without a connection graph, a node named after the server has all channels and services, and whether others
    subscribe to a topic is not known: one is assumed where there is a channel of the topic.
    """
    connections = peer.connections or {}
    is_known = any(connections.values())
    server = f"/{_NODE.sub('_', str(peer.info.get('name', ''))).strip('_') or 'foxglove'}"
    topics: dict[str, Topic] = {}
    channels = [*peer.channels.values()]
    written = {each.written for each in channels}
    for name in {**connections.get(_PUBLISHED, {}), **connections.get(_SUBSCRIBED, {})}:
        if name not in written:  # such as one that the server only subscribes to
            channels.append(Channel(-1, global_name(name), name))
    for channel in channels:
        refs = () if channel.schema is None else (channel.schema.ref,)
        publishers = peer.nodes(_PUBLISHED, channel.written) if is_known else (server,)
        topic = topics.get(channel.topic, Topic(channel.topic))
        ends = (Endpoint(node, *refs) for node in publishers)
        topics[channel.topic] = Topic(
            channel.topic,
            tuple(dict.fromkeys((*topic.types, *refs))),
            tuple({each.node: each for each in (*topic.publishers, *ends)}.values()),
            tuple(Endpoint(node) for node in peer.nodes(_SUBSCRIBED, channel.written)),
            topic.unreadable or channel.unreadable,
        )
    matched = {}
    for name, ref in published.items():
        topic = topics.get(name, Topic(name, (ref,)))
        subscribers = tuple(Endpoint(node) for node in peer.nodes(_SUBSCRIBED, name))
        matched[name] = len(subscribers) if is_known else int(name in topics)
        mine = (*topic.publishers, Endpoint(own_node, ref))
        topics[name] = Topic(name, topic.types or (ref,), mine, subscribers, topic.unreadable)
    services = {
        each.name: Service(
            each.name, each.type, peer.nodes(_SERVICES, each.name) if is_known else (server,), each.uncallable
        )
        for each in peer.services.values()
    }
    nodes = {node for kind, named in connections.items() for name in named for node in peer.nodes(kind, name)}
    nodes |= set() if is_known or not (topics or services) else {server}
    nodes |= {own_node} if published else set()
    parts = {"nodes": {name: Node(name) for name in nodes}, "topics": topics, "services": services}
    return {**parts, "parameters": {name: Parameter(name) for name in peer.parameters}}, matched
