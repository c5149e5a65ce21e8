"""Computation graph from the master's state and facts about endpoints. No I/O; unchanged parts are shared."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import TypeVar

from msgspec import Struct, field

from rosld.adapters.model import Endpoint, Graph, Live, Master, Node, Parameter, Service, Stale, Topic, TypeRef, freeze
from rosld.adapters.ros1.actionlib import actions_of
from rosld.adapters.ros1.types import EndpointFacts, LearntFacts, ServiceFacts, message_type

_V = TypeVar("_V")
_NOTHING = EndpointFacts()
_NOT_ASKED = ServiceFacts(None, "its type is not known yet: its node is being asked")


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


def compose(previous: Graph, seen: Observation, learnt: LearntFacts, unreadable: Mapping[TypeRef, str]) -> Graph:
    """Return the graph of an observation, which is `previous` itself if nothing changed."""
    system = seen.system

    def topic(name: str) -> Topic:
        return _topic(name, system, learnt, unreadable)

    def service(name: str) -> Service:
        facts = learnt.services.get(name, _NOT_ASKED)
        return Service(name, facts.type, system.services[name], facts.uncallable)

    def node(name: str) -> Node:
        return Node(name, learnt.uris.get(name), learnt.unreachable.get(name))

    actions = actions_of(system.publishers, system.subscribers, system.topic_types)
    graph = replace(
        previous,
        state=Live(),
        master=seen.master,
        own_node=seen.own_node,
        simulated_time=seen.simulated_time,
        nodes=_shared(previous.nodes, system.nodes(), node),
        topics=_shared(previous.topics, _topic_names(system), topic),
        services=_shared(previous.services, system.services, service),
        actions=_shared(previous.actions, actions, lambda name: actions[name]),
        parameters=_shared(previous.parameters, seen.parameters, lambda name: seen.parameters[name]),
    )
    return previous if graph == previous else replace(graph, revision=previous.revision + 1)


def stale(previous: Graph, since_ns: int, why: str) -> Graph:
    """Return the last known graph, marked as stale."""
    if isinstance(previous.state, Stale):
        return previous
    return replace(previous, state=Stale(since_ns, why), revision=previous.revision + 1)


def _topic_names(system: SystemState) -> set[str]:
    return {*system.publishers, *system.subscribers}  # the master never forgets the types of former topics


def _topic(name: str, system: SystemState, learnt: LearntFacts, unreadable: Mapping[TypeRef, str]) -> Topic:
    nodes = system.publishers.get(name, ())
    facts = [learnt.endpoints.get((name, node), _NOTHING) for node in nodes]
    publishers = tuple(
        Endpoint(node, fact.type, fact.latched, fact.unreachable) for node, fact in zip(nodes, facts, strict=True)
    )
    subscribers = tuple(Endpoint(node) for node in system.subscribers.get(name, ()))
    types = _types(system.topic_types.get(name), [fact.type for fact in facts])
    words = next((unreadable[each] for each in types if each in unreadable), None)
    if not types and (stated := system.topic_types.get(name)) and stated != "*":
        words = f"{stated!r} is no name of a type"
    return Topic(name, types, publishers, subscribers, words)


def _types(stated: str | None, said: list[TypeRef | None]) -> tuple[TypeRef, ...]:
    """Return every type in use: those stated by publishers and, while one is unknown, the master's."""
    types = dict.fromkeys(each for each in said if each is not None)
    if None in said or not said:
        name = message_type(stated) if stated else None
        if name and all(each.name != name for each in types):
            types[TypeRef(name)] = None
    return tuple(types)


def _shared(previous: Mapping[str, _V], names: Iterable[str], make: Callable[[str], _V]) -> Mapping[str, _V]:
    """Return the values of these names, sorted; reuse equal previous values, and the mapping if all are equal."""
    made: dict[str, _V] = {}
    for name in sorted(names):
        new, old = make(name), previous.get(name)
        made[name] = old if old is not None and old == new else new
    if len(made) == len(previous) and all(previous.get(name) is value for name, value in made.items()):
        return previous
    return freeze(made)
