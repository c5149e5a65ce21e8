"""Computation graph from the master's state and facts about endpoints. No I/O; unchanged parts are shared."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import TypeVar

from msgspec import Struct, field

from rosld.adapters.model import Endpoint, Graph, Live, Master, Node, Parameter, Service, Stale, Topic, TypeRef, freeze
from rosld.adapters.ros1.actionlib import actions_of
from rosld.adapters.ros1.types import EndpointFacts, Facts, ServiceFacts, message_type

_V = TypeVar("_V")
_NOTHING = EndpointFacts()
_UNPROBED = ServiceFacts(None, "its type is not known yet: waiting for its node to report it")


class SystemState(Struct, frozen=True):
    """Response of getSystemState and getTopicTypes: nodes by name, types by topic."""

    publishers: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    subscribers: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    services: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    topic_types: Mapping[str, str] = field(default_factory=dict)

    def nodes(self) -> set[str]:
        """Return every node with a publisher, a subscriber or a service."""
        return {
            node for each in (self.publishers, self.subscribers, self.services) for of in each.values() for node in of
        }


class Observation(Struct, frozen=True):
    """All inputs of the graph except learnt facts."""

    master: Master
    own_node: str
    system: SystemState = field(default_factory=SystemState)
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    simulated_time: bool = False


def compose(previous: Graph, observation: Observation, facts: Facts, unreadable: Mapping[TypeRef, str]) -> Graph:
    """Return the graph of an observation, which is `previous` itself if nothing changed."""
    system = observation.system

    def topic(name: str) -> Topic:
        return _topic(name, system, facts, unreadable)

    def service(name: str) -> Service:
        fact = facts.services.get(name, _UNPROBED)
        return Service(name, fact.type, system.services[name], fact.uncallable)

    def node(name: str) -> Node:
        return Node(name, facts.uris.get(name), facts.unreachable.get(name))

    actions = actions_of(system.publishers, system.subscribers, system.topic_types)
    graph = replace(
        previous,
        state=Live(),
        master=observation.master,
        own_node=observation.own_node,
        simulated_time=observation.simulated_time,
        nodes=_shared(previous.nodes, system.nodes(), node),
        topics=_shared(previous.topics, _topic_names(system), topic),
        services=_shared(previous.services, system.services, service),
        actions=_shared(previous.actions, actions, lambda name: actions[name]),
        parameters=_shared(previous.parameters, observation.parameters, lambda name: observation.parameters[name]),
    )
    return previous if graph == previous else replace(graph, revision=previous.revision + 1)


def stale(previous: Graph, since_ns: int, why: str) -> Graph:
    """Return the last known graph, marked as stale."""
    if isinstance(previous.state, Stale):
        return previous
    return replace(previous, state=Stale(since_ns, why), revision=previous.revision + 1)


def _topic_names(system: SystemState) -> set[str]:
    return {*system.publishers, *system.subscribers}  # the master never forgets the types of former topics


def _topic(name: str, system: SystemState, facts: Facts, unreadable: Mapping[TypeRef, str]) -> Topic:
    nodes = system.publishers.get(name, ())
    endpoints = [facts.endpoints.get((name, node), _NOTHING) for node in nodes]
    publishers = tuple(
        Endpoint(node, endpoint.type, endpoint.latched, endpoint.unreachable)
        for node, endpoint in zip(nodes, endpoints, strict=True)
    )
    subscribers = tuple(Endpoint(node) for node in system.subscribers.get(name, ()))
    types = _types(system.topic_types.get(name), [endpoint.type for endpoint in endpoints])
    words = next((unreadable[each] for each in types if each in unreadable), None)
    if not types and (stated := system.topic_types.get(name)) and stated != "*":
        words = f"{stated!r} is not a type name"
    return Topic(name, types, publishers, subscribers, words)


def _types(stated: str | None, reported: list[TypeRef | None]) -> tuple[TypeRef, ...]:
    """Return every type in use: those stated by publishers and, while one is unknown, the master's."""
    types = dict.fromkeys(each for each in reported if each is not None)
    if None in reported or not reported:
        name = message_type(stated) if stated else None
        if name and all(each.name != name for each in types):
            types[TypeRef(name)] = None
    return tuple(types)


def _shared(previous: Mapping[str, _V], names: Iterable[str], make: Callable[[str], _V]) -> Mapping[str, _V]:
    """Return the values of these names, sorted; reuse equal previous values, and the mapping if all are equal."""
    values: dict[str, _V] = {}
    for name in sorted(names):
        new, old = make(name), previous.get(name)
        values[name] = old if old is not None and old == new else new
    if len(values) == len(previous) and all(previous.get(name) is value for name, value in values.items()):
        return previous
    return freeze(values)
