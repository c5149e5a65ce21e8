"""Of which types a resource is, for rules about types: topics, services, actions, and what is made of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from rosld.adapters.model import Graph, Kind, TypeRef
from rosld.ontology.urls import Location
from rosld.server.auth.rules import UNTYPED, Types
from rosld.server.hypermedia.affordance_service import AffordanceService
from rosld.server.hypermedia.catalogue import GoalSource, ParameterSource, TopicSource
from rosld.server.rest.state import State
from rosld.server.robot.session import Session

_KINDS: Mapping[type, Kind] = {TopicSource: Kind.TOPIC, GoalSource: Kind.ACTION}
"""What a value is read from or written to; all else is a service."""


def types_at(session: Session, affordances: AffordanceService[State], location: Location) -> Types:
    """The names of the types of what is at a location; none where it is of no type, or is not there."""
    if not location.segments:
        return UNTYPED
    try:
        return frozenset(ref.name for ref in _refs(session, affordances, location))
    except ValueError:  # no name of ROS is spelt so
        return UNTYPED


def _refs(session: Session, affordances: AffordanceService[State], location: Location) -> Iterable[TypeRef]:
    graph = session.graph
    match location.kind:
        case "topics":
            return types_of(graph, Kind.TOPIC, location.name)
        case "services":
            return types_of(graph, Kind.SERVICE, location.name)
        case "actions":
            return _of_action(graph, location.name)
        case "calls":
            found = next((call.service for call in session.calls.all() if call.id == location.segments[0]), None)
            return () if found is None else types_of(graph, Kind.SERVICE, found)
        case "goals":
            goal = next((goal.action for goal in session.goals.all() if goal.id == location.segments[0]), None)
            return () if goal is None else _of_action(graph, goal)
        case "resources" if not location.is_container:
            return _of_member(graph, affordances, location.name)
    return ()


def types_of(graph: Graph, kind: Kind, name: str) -> tuple[TypeRef, ...]:
    """The types of a topic, a service or an action, as far as they are known."""
    if kind is Kind.TOPIC:
        topic = graph.topics.get(name)
        return () if topic is None else tuple(topic.types)
    if kind is Kind.ACTION:
        return _of_action(graph, name)
    service = graph.services.get(name)
    return () if service is None or service.type is None else (service.type,)


def _of_action(graph: Graph, name: str) -> tuple[TypeRef, ...]:
    action = graph.actions.get(name)
    return () if action is None or action.type is None else (action.type,)


def _of_member(graph: Graph, affordances: AffordanceService[State], name: str) -> Iterable[TypeRef]:
    """Those of all topics and services that a property is read from and written to, or an action invokes."""
    tree = affordances.cached_tree() or affordances.last_tree
    if tree is None:
        return
    plan, action = tree.property(name), tree.action(name)
    if plan is not None:
        for way in (*plan.source.readers, *plan.source.writers):
            if not isinstance(way, ParameterSource):
                yield from types_of(graph, _KINDS.get(type(way), Kind.SERVICE), way.name)
    if action is not None:
        yield from types_of(graph, Kind.ACTION if action.sends_goals else Kind.SERVICE, action.service)
