"""What was learnt about the graph beside the master's own state: addresses, endpoints' types, services' types."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

from rosld.adapters.model import TypeRef


class EndpointFacts(NamedTuple):
    """What a publisher said when it was connected to, or why it was not."""

    type: TypeRef | None = None
    latched: bool = False
    unreachable: str | None = None


class ServiceFacts(NamedTuple):
    """What a service's node said when it was asked for the type, or why it cannot be called."""

    type: TypeRef | None = None
    uncallable: str | None = None


@dataclass
class LearntFacts:
    """Facts by name; written on the reading thread alone. `changed` is called after each change."""

    changed: Callable[[], None]
    uris: dict[str, str] = field(default_factory=dict)
    unreachable: dict[str, str] = field(default_factory=dict)
    endpoints: dict[tuple[str, str], EndpointFacts] = field(default_factory=dict)
    services: dict[str, ServiceFacts] = field(default_factory=dict)

    def set_node_uri(self, node: str, uri: str) -> None:
        """A node has this address."""
        if self.uris.get(node) != uri:
            self.uris[node] = uri
            self.unreachable.pop(node, None)
            self.changed()

    def set_node_reachable(self, node: str, words: str | None) -> None:
        """A node answers (None), or does not, as these words say."""
        if self.unreachable.get(node) != words:
            if words is None:
                del self.unreachable[node]
            else:
                self.unreachable[node] = words
            self.changed()

    def set_endpoint(self, topic: str, node: str, facts: EndpointFacts) -> None:
        """A publisher said this of itself."""
        if self.endpoints.get((topic, node)) != facts:
            self.endpoints[topic, node] = facts
            self.changed()

    def set_endpoint_unreachable(self, topic: str, node: str, words: str) -> None:
        """A publisher could not be read from; what it said before still holds."""
        before = self.endpoints.get((topic, node), EndpointFacts())
        self.set_endpoint(topic, node, before._replace(unreachable=words))

    def set_service(self, name: str, facts: ServiceFacts) -> None:
        """A service's type is this."""
        if self.services.get(name) != facts:
            self.services[name] = facts
            self.changed()

    def retain(self, nodes: set[str], endpoints: set[tuple[str, str]], services: set[str]) -> None:
        """Forget what the master no longer lists."""
        for gone in self.uris.keys() - nodes:
            del self.uris[gone]
        for gone in self.unreachable.keys() - nodes:
            del self.unreachable[gone]
        for lost in self.endpoints.keys() - endpoints:
            del self.endpoints[lost]
        for gone in self.services.keys() - services:
            del self.services[gone]
