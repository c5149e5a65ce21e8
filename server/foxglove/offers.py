"""The offers to a client of Foxglove's protocol: the channels, services and connections that it may read.

Numbers of channels and services are the same for all clients and never reused, so that clients may cache schemas.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import count
from typing import NamedTuple

from rosld.adapters.model import Graph, MessageSchema, Schema, ServiceSchema, TypeRef
from rosld.adapters.model.foxglove_protocol import SCHEMA_ENCODINGS, Json
from rosld.adapters.model.schema import Encoding
from rosld.server.auth.permissions import Permissions
from rosld.server.resources.namespaces import listed_graph
from rosld.server.robot.session import Session

Connections = dict[str, dict[str, tuple[str, ...]]]
"""Nodes by name of a topic or service, for each of `_KINDS`."""
_KINDS = {
    "publishedTopics": "publisherIds",
    "subscribedTopics": "subscriberIds",
    "advertisedServices": "providerIds",
}
_DISTROS = {Encoding.ROS1: "noetic", Encoding.CDR: "jazzy"}
"""Value of `ROS_DISTRO`, by which clients choose the conventions of ROS 1 or ROS 2."""


class Offer(NamedTuple):
    """A channel or a service: its ROS name, its schema, and its JSON without a number."""

    name: str
    schema: Schema
    members: Json


class Offers:
    """The offers of one robot."""

    def __init__(self, session: Session, instance_id: str) -> None:
        self.session = session
        self._instance_id = instance_id
        self._counter = count(1)
        self._ids: dict[tuple[str, str, TypeRef], int] = {}

    @property
    def encoding(self) -> str:
        """The encoding of messages."""
        return self.session.adapter.capabilities.encoding.value

    @property
    def is_recording(self) -> bool:
        """Whether the messages come from a recording, which has a clock of its own."""
        return self.session.adapter.capabilities.system == "recording"

    def server_info(self, permissions: Permissions) -> Json:
        """Return the members of the first message."""
        session = self.session
        capabilities = session.adapter.capabilities
        writes = ("clientPublish", "services") if capabilities.writes and not session.settings.read_only else ()
        times = ("time",) if self.is_recording else ()
        return {
            "name": session.name if permissions.may_read(session.space.base) else "rosld",
            "capabilities": ["connectionGraph", "parameters", "parametersSubscribe", *writes, *times],
            "supportedEncodings": [self.encoding, "json"],
            "metadata": {"ROS_DISTRO": _DISTROS[capabilities.encoding], "server": "rosld"},
            "sessionId": self._instance_id,
        }

    def graph(self) -> Graph:
        """Return the graph without hidden names."""
        return listed_graph(self.session.graph, self.session.adapter.capabilities)

    def channels(self, permissions: Permissions) -> tuple[Mapping[int, Offer], Sequence[TypeRef]]:
        """Return the channels by number, and the types whose schemas are not known yet."""
        space = self.session.space
        named = (
            (topic.name, topic.types[0])
            for topic in self.graph().topics.values()
            if len({each.name for each in topic.types}) == 1 and topic.unreadable is None
            if permissions.may_read(space.topic(topic.name))
        )
        return self._numbered("topic", named, self._channel)

    def services(self, permissions: Permissions) -> tuple[Mapping[int, Offer], Sequence[TypeRef]]:
        """Return the services by number, and the types whose schemas are not known yet."""
        space = self.session.space
        named = (
            (service.name, service.type)
            for service in self.graph().services.values()
            if service.type is not None and service.uncallable is None
            if permissions.may_read(space.service(service.name))
        )
        return self._numbered("service", named, self._service)

    def connections(self, permissions: Permissions) -> Connections:
        """Return the nodes that publish and subscribe to topics, and provide services."""
        graph, space = self.graph(), self.session.space
        nodes = {name for name in graph.nodes if permissions.may_read(space.node(name))}
        topics = [each for each in graph.topics.values() if permissions.may_read(space.topic(each.name))]
        services = [each for each in graph.services.values() if permissions.may_read(space.service(each.name))]
        found: Connections = {
            "publishedTopics": {each.name: tuple(one.node for one in each.publishers) for each in topics},
            "subscribedTopics": {each.name: tuple(one.node for one in each.subscribers) for each in topics},
            "advertisedServices": {each.name: each.providers for each in services},
        }
        return {
            kind: {name: visible for name, ids in named.items() if (visible := _distinct(ids, nodes))}
            for kind, named in found.items()
        }

    def type_name(self, ref: TypeRef) -> str:
        """Return the name of a type as its ROS writes it."""
        return ref.name if self.encoding == "cdr" else ref.name.replace("/msg/", "/").replace("/srv/", "/")

    def type_ref(self, name: str, kind: str = "msg") -> TypeRef:
        """Return the type of a name as either ROS writes it."""
        package, _, short = name.partition("/")
        return TypeRef(name if "/" in short else f"{package}/{kind}/{short}")

    def _numbered(
        self, kind: str, named: Iterable[tuple[str, TypeRef]], describe: Callable[[str, Schema], Json | None]
    ) -> tuple[Mapping[int, Offer], Sequence[TypeRef]]:
        offers: dict[int, Offer] = {}
        missing: dict[TypeRef, None] = {}
        for name, ref in named:
            schema = self.session.schemas.find_similar(ref)
            members = None if schema is None else describe(name, schema)
            if schema is None:
                missing[ref] = None
            elif members is not None:
                id = self._ids.setdefault((kind, name, schema.ref), 0) or next(self._counter)
                self._ids[kind, name, schema.ref] = id
                offers[id] = Offer(name, schema, members)
        return offers, list(missing)

    def _channel(self, name: str, schema: Schema) -> Json | None:
        if not isinstance(schema, MessageSchema):
            return None
        return {"topic": name, **self._message(schema, self.type_name(schema.ref))}

    def _service(self, name: str, schema: Schema) -> Json | None:
        if not isinstance(schema, ServiceSchema):
            return None
        type = self.type_name(schema.ref)
        return {
            "name": name,
            "type": type,
            "request": self._message(schema.request, f"{type}_Request"),
            "response": self._message(schema.response, f"{type}_Response"),
            "requestSchema": schema.request.definition,  # of clients older than the two members above
            "responseSchema": schema.response.definition,
        }

    def _message(self, schema: MessageSchema, name: str) -> Json:
        written = SCHEMA_ENCODINGS[self.session.adapter.capabilities.encoding]
        return {
            "encoding": self.encoding,
            "schemaName": name,
            "schemaEncoding": written,
            "schema": schema.definition,
        }


def connection_changes(before: Connections, after: Connections) -> Json:
    """Return the members of an update of the connection graph."""
    changes: Json = {
        kind: [
            {"name": name, members: after[kind].get(name, ())}
            for name in {**before.get(kind, {}), **after[kind]}
            if before.get(kind, {}).get(name) != after[kind].get(name)
        ]
        for kind, members in _KINDS.items()
    }
    topics = [*before.get("publishedTopics", {}), *before.get("subscribedTopics", {})]
    left = after["publishedTopics"].keys() | after["subscribedTopics"].keys()
    changes["removedTopics"] = [name for name in dict.fromkeys(topics) if name not in left]
    services = before.get("advertisedServices", {})
    changes["removedServices"] = [name for name in services if name not in after["advertisedServices"]]
    for kind, removed in zip(_KINDS, ("removedTopics", "removedTopics", "removedServices"), strict=True):
        changes[kind] = [each for each in changes[kind] if each["name"] not in changes[removed]]
    return changes


def _distinct(ids: Iterable[str], visible: set[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(each for each in ids if each in visible))
