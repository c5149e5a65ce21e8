"""Permissions: the rules at `/acl`, and the types and subjects of resources, which rules can depend on."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from msgspec import Struct
from pyoxigraph import Literal, NamedNode, Triple

from rosld.adapters.model import Graph, Kind, TypeRef
from rosld.ontology.document import Document
from rosld.ontology.triples import boolean, statements, text, triples_about
from rosld.ontology.urls import Location, Space
from rosld.ontology.vocab import acl, foaf, rdf, rdfs, ros
from rosld.server.auth.authenticator import Authenticator
from rosld.server.auth.config import MODES
from rosld.server.auth.rules import ACL, ANONYMOUS, AUTHENTICATED, UNTYPED, Agent, Policy, Rule, Types
from rosld.server.events.notification_channels import Channels
from rosld.server.hypermedia.affordance_service import AffordanceService
from rosld.server.hypermedia.catalogue import GoalSource, ParameterSource, TopicSource
from rosld.server.receipts.journal import NoSuchReceipt
from rosld.server.resources.base import Services
from rosld.server.rest.resource import RDF_SOURCE, RESOURCE, Resource
from rosld.server.rest.state import State

_CLASSES = {ANONYMOUS.name: foaf.Agent, AUTHENTICATED: acl.AuthenticatedAgent}
_MODES = {mode: term for term, mode in MODES.items()}


class AclResource(Resource):
    """The rules, read-only over HTTP: they are edited in their file."""

    kind = "Rights"
    shape = "Authorization"
    title = "Rights"
    links = (RESOURCE, RDF_SOURCE)

    def __init__(self, space: Space, authenticator: Authenticator) -> None:
        super().__init__(space, space.base + ACL)
        self._authenticator = authenticator

    def deny_reason(self, method: str) -> str:
        return "The rules are in the file of --auth, which is reloaded when it changes."

    async def state(self) -> State:
        policy = self._authenticator.config.policy
        return State(lambda: Document(self.url, tuple(policy_document(policy, self.url))))


def policy_document(policy: Policy, url: str) -> Iterable[Triple]:
    """Yield the triples of agents and rules, without credentials."""
    yield Triple(NamedNode(url), rdfs.label, Literal("Rules of access"))
    nodes = {agent.name: _node(agent, number, url) for number, agent in enumerate(policy.agents.values(), 1)}
    by_webid = {agent.webid: nodes[agent.name] for agent in policy.agents.values() if agent.webid}
    for agent in policy.agents.values():
        yield from triples_about(nodes[agent.name], (rdf.type, foaf.Agent), (ros.name, text(agent.name)))
    for number, rule in enumerate(policy.rules, 1):
        yield from _authorization(rule, NamedNode(f"{url}#rule-{number}"), {**by_webid, **nodes})


def _node(agent: Agent, number: int, url: str) -> NamedNode:
    return NamedNode(agent.webid or f"{url}#agent-{number}")


def _authorization(rule: Rule, node: NamedNode, nodes: Mapping[str, NamedNode]) -> Iterable[Triple]:
    names = sorted(rule.agents)
    return triples_about(
        node,
        (rdf.type, acl.Authorization),
        *statements(acl.agentClass, (_CLASSES[name] for name in names if name in _CLASSES)),
        *statements(acl.agent, (nodes[name] for name in names if name in nodes)),
        *statements(acl.mode, (_MODES[mode] for mode in sorted(rule.modes, key=lambda mode: mode.value))),
        *statements(ros.glob, (Literal(glob.text) for glob in rule.globs)),
        *statements(ros.typeGlob, map(Literal, rule.types)),
        (ros.deny, boolean(True) if rule.deny else None),
    )


class AboutResources(Struct, frozen=True):
    """Callable that returns the URLs of the subjects of a resource, or None if the resource is unknown.

    A removed resource has no subjects, because its absence reveals nothing. Thread-safe.
    """

    services: Services
    channels: Channels

    def __call__(self, location: Location) -> Sequence[str] | None:
        """Return the URLs of the subjects of the resource at a location."""
        space, session = self.services.space, self.services.session
        match location.kind, location.segments:
            case "calls", (id,):
                name = session.calls.subject_of(id)
                return name if name is None else (space.service(name),) if name else ()
            case "goals", (id,):
                name = session.goals.subject_of(id)
                return name if name is None else (space.action(name),) if name else ()
            case "holds", (id,):
                name = self.services.holds.topic_of(id)
                return name if name is None else (space.topic(name),) if name else ()
            case "faults", (id,):
                return self.services.faults.about(id, space)
            case "activity", (id,):
                return self._of_receipt(id)
            case "channels", (_, token, *_):
                topic = self.channels.topic_of(token)
                return None if topic is None else (topic,)
            case "bags", (name, "file"):
                return self._of_file(space, name)
            case "bags", (name, "messages", index):
                return self._of_message(space, name, index)
        return ()

    def _of_receipt(self, id: str) -> Sequence[str] | None:
        try:
            return self.services.receipts.find(id).touched
        except NoSuchReceipt:
            return None

    def _of_file(self, space: Space, name: str) -> Sequence[str]:
        """Return the recording and all of its topics, because the file contains their messages."""
        recording = self.services.recordings.find(name)
        return () if recording is None else (space.bag(name), *map(space.topic, recording.topics))

    def _of_message(self, space: Space, name: str, segment: str) -> Sequence[str] | None:
        recording = self.services.recordings.find(name)
        if recording is None or not (segment.isascii() and segment.isdigit()):
            return None
        index = int(segment)
        if index < recording.first:
            return ()
        topic = recording.topic_of(index)
        return None if topic is None else (space.topic(topic),)


_KINDS: Mapping[type, Kind] = {TopicSource: Kind.TOPIC, GoalSource: Kind.ACTION}
"""Kinds of sources and targets of values; all others are services."""


def types_at(services: Services, location: Location) -> Types:
    """Return the names of the types of the resource at a location; none if it is missing or has no type."""
    if not location.segments:
        return UNTYPED
    try:
        return frozenset(ref.name for ref in _refs(services, location))
    except ValueError:  # not a valid ROS name
        return UNTYPED


def _refs(services: Services, location: Location) -> Iterable[TypeRef]:
    session, graph = services.session, services.session.graph
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
            return _of_member(graph, services.affordances, location.name)
    return ()


def types_of(graph: Graph, kind: Kind, name: str) -> tuple[TypeRef, ...]:
    """Return the known types of a topic, a service or an action."""
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
    """Return the topics and services used by a property or an action."""
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
