"""The computation graph described: the entry point and the nodes."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple, TypeVar

from pyoxigraph import Literal, NamedNode, Triple

from rosld.adapters.model import Endpoint, Graph, Live, Node, Stale, Topic, names
from rosld.ontology.describe_lifecycle import lifecycle_statements, transition_triples
from rosld.ontology.describe_search import search_triples
from rosld.ontology.describe_topics import endpoints_of
from rosld.ontology.document import Document
from rosld.ontology.namespaces import IdentityCache
from rosld.ontology.triples import (
    CONTAINER,
    RDF_SOURCE,
    Statement,
    Value,
    boolean,
    date_time_literal,
    integer,
    statements,
    text,
    triples_about,
)
from rosld.ontology.urls import Space
from rosld.ontology.vocab import cora, dcterms, ldp, rdf, rdfs, ros, sosa, xsd

_V = TypeVar("_V")

SECTIONS: Mapping[str, str] = {
    "resources": "Resources",
    "nodes": "Nodes",
    "topics": "Topics",
    "services": "Services",
    "calls": "Calls",
    "actions": "Actions",
    "goals": "Goals",
    "activity": "Activity",
    "holds": "Holds",
    "parameters": "Parameters",
    "types": "Types",
    "shapes": "Shapes",
    "bags": "Recordings",
    "mappings": "Mappings",
    "data": "Data",
    "queries": "Queries",
    "cockpit": "Cockpits",
}
"""The containers at the top, with their titles."""


class ServerProblems(NamedTuple):
    """Problems of a server: why it cannot store everything, and the URLs of holds that were interrupted."""

    storage: tuple[str, ...] = ()
    interrupted_holds: tuple[str, ...] = ()


_NO_PROBLEMS = ServerProblems()


def entry_document(
    graph: Graph, space: Space, system: str = "ROS", problems: ServerProblems = _NO_PROBLEMS, *, name: str = "robot"
) -> Document:
    """The entry point `/`: the distributed application (paper, Table 1), its machine, master, state, and all routes.

    `system` names the kind of ROS system (`ROS 1`, `recording`, ...), `name` the robot.
    """
    entry, robot, status = NamedNode(space.base), NamedNode(f"{space.base}#robot"), NamedNode(f"{space.base}status")
    services = {name: NamedNode(space.base + name) for name in _SERVICES}
    triples = triples_about(
        entry,
        (rdf.type, ros.Graph),
        *CONTAINER,
        (dcterms.title, text(f"The computation graph ({system})")),
        *graph_state(graph),
        (ros.robot, robot),
        (ros.hasMaster, NamedNode(f"{space.base}#master") if graph.master else None),
        *(((ros.simulatedTime, boolean(True)),) if graph.simulated_time else ()),
        *statements(ldp.contains, (NamedNode(space.container(route)) for route in SECTIONS)),
        (ros.hasStop, NamedNode(space.stop)),
        (ros.hasServerStatus, status),
        *statements(rdfs.seeAlso, (*services.values(), NamedNode(space.cockpit("default")))),
    )
    triples += triples_about(
        robot, (rdf.type, sosa.Platform), (rdf.type, cora.Robot), (rdfs.label, text(name)), (sosa.hosts, entry)
    )
    triples += _master_triples(graph, space)
    triples += _section_triples(graph, space)
    triples += triples_about(status, *problem_statements(problems))
    triples += search_triples(entry, space)
    for each, label in _SERVICES.items():
        triples += triples_about(services[each], (rdfs.label, text(label)))
    return Document(space.base, tuple(triples), simulated_time=graph.simulated_time)


_SERVICES = {"sparql": "SPARQL", "graphs": "Graph store", "graph": "Who talks to whom", "ontology": "Ontology"}
"""What there is one of beside the routes, by its name below the base, with its label."""


def _master_triples(graph: Graph, space: Space) -> list[Triple]:
    """What is said of the ROS 1 master; nothing where the system has none."""
    if graph.master is None:
        return []
    master = NamedNode(f"{space.base}#master")
    said = ((rdf.type, ros.Master), (ros.uri, _uri(graph.master.uri)), (ros.runId, text(graph.master.run_id)))
    return triples_about(master, *said)


def _section_triples(graph: Graph, space: Space) -> Iterator[Triple]:
    """The titles of the routes, and how many members each has where the graph tells it."""
    counts = {
        "nodes": len(graph.nodes),
        "topics": len(graph.topics),
        "services": len(graph.services),
        "actions": len(graph.actions),
        "parameters": len(graph.parameters),
    }
    for route, title in SECTIONS.items():
        said = ((rdfs.label, text(title)), (ros.count, integer(counts.get(route))))
        yield from triples_about(NamedNode(space.container(route)), *said)


def problem_statements(problems: ServerProblems) -> list[Statement]:
    """The problems of a server."""
    return [
        *statements(ros.storageProblem, map(Literal, problems.storage)),
        *statements(ros.interruptedHold, map(NamedNode, problems.interrupted_holds)),
    ]


def graph_state(graph: Graph) -> list[Statement]:
    """Whether the robot is seen; if not since when and why."""
    match graph.state:
        case Live():
            return [(ros.state, ros.Live)]
        case Stale(since_ns, why):
            return [(ros.state, ros.Stale), (ros.staleSince, date_time_literal(since_ns)), (ros.reason, text(why))]


def _uri(uri: str | None) -> Value | None:
    found = text(uri)
    return None if found is None else Literal(found.value, datatype=xsd.anyURI)


@dataclass(frozen=True, slots=True)
class NodeView:
    """A node and all that it takes part in: topics with its endpoints on them, all else by name.

    `offers`: its transitions can be asked for here now, and forms say how.
    """

    node: Node
    publishes: tuple[tuple[Topic, tuple[Endpoint, ...]], ...] = ()
    subscribes: tuple[tuple[Topic, tuple[Endpoint, ...]], ...] = ()
    provides: tuple[str, ...] = ()
    serves: tuple[str, ...] = ()
    sends_goals_to: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    offers: bool = False


@dataclass(slots=True)
class _Parts:
    """What one node takes part in, being gathered."""

    publishes: dict[str, list[Endpoint]] = field(default_factory=dict)
    subscribes: dict[str, list[Endpoint]] = field(default_factory=dict)
    provides: list[str] = field(default_factory=list)
    serves: list[str] = field(default_factory=list)
    sends_goals_to: list[str] = field(default_factory=list)
    parameters: list[str] = field(default_factory=list)


def _views(graph: Graph) -> dict[str, NodeView]:
    parts = defaultdict[str, _Parts](_Parts)
    topics, services = _beside_actions(graph.topics), _beside_actions(graph.services)
    for name, topic in topics:
        for endpoint in topic.publishers:
            parts[endpoint.node].publishes.setdefault(name, []).append(endpoint)
        for endpoint in topic.subscribers:
            parts[endpoint.node].subscribes.setdefault(name, []).append(endpoint)
    for name, service in services:
        for node in dict.fromkeys(service.providers):
            parts[node].provides.append(name)
    for name, action in graph.actions.items():
        for node in dict.fromkeys(action.servers):
            parts[node].serves.append(name)
        for node in dict.fromkeys(action.clients):
            parts[node].sends_goals_to.append(name)
    for name, parameter in graph.parameters.items():
        if parameter.node is not None:
            parts[parameter.node].parameters.append(name)
    return {name: _view(node, parts[name], graph) for name, node in graph.nodes.items()}


def _beside_actions(things: Mapping[str, _V]) -> Iterator[tuple[str, _V]]:
    """What is told of its node by its own name: the inner parts of ROS 2's actions are told as these."""
    return ((name, thing) for name, thing in things.items() if names.action_of(name) is None)


def _view(node: Node, parts: _Parts, graph: Graph) -> NodeView:
    return NodeView(
        node,
        tuple((graph.topics[name], tuple(endpoints)) for name, endpoints in sorted(parts.publishes.items())),
        tuple((graph.topics[name], tuple(endpoints)) for name, endpoints in sorted(parts.subscribes.items())),
        tuple(sorted(parts.provides)),
        tuple(sorted(parts.serves)),
        tuple(sorted(parts.sends_goals_to)),
        tuple(sorted(parts.parameters)),
    )


node_views: IdentityCache[Graph, dict[str, NodeView]] = IdentityCache(_views)
"""The nodes of a graph with what each takes part in."""


def node_document(view: NodeView, space: Space, *, simulated_time: bool = False) -> Document:
    """A node with its lifecycle, its endpoints, services, actions and parameters.

    Of topics the quality of service is told, of a node that does not answer the reason.
    """
    node = view.node
    url = space.node(node.name)
    endpoints = [
        described
        for kind, topics in ((ros.Publisher, view.publishes), (ros.Subscriber, view.subscribes))
        for topic, own in topics
        for described in endpoints_of(kind, own, topic, space)
    ]
    triples = triples_about(
        NamedNode(url),
        (rdf.type, ros.Node),
        (rdf.type, ros.ManagedNode if node.lifecycle else None),
        *RDF_SOURCE,
        (ros.name, text(node.name)),
        (ros.uri, _uri(node.uri)),
        (ros.unreachable, text(node.unreachable)),
        *(lifecycle_statements(node.lifecycle) if node.lifecycle else ()),
        *_links(ros.publishes, (space.topic(topic.name) for topic, _ in view.publishes)),
        *_links(ros.subscribes, (space.topic(topic.name) for topic, _ in view.subscribes)),
        *_links(ros.provides, (*map(space.service, view.provides), *map(space.action, view.serves))),
        *_links(ros.sendsGoalsTo, map(space.action, view.sends_goals_to)),
        *_links(ros.hasParameter, map(space.parameter, view.parameters)),
        *statements(ros.hasEndpoint, [endpoint for endpoint, _ in endpoints]),
    )
    for _, said in endpoints:
        triples += said
    if node.lifecycle and view.offers:
        triples += transition_triples(url, node.lifecycle, space)
    return Document(url, tuple(triples), simulated_time=simulated_time)


def _links(predicate: NamedNode, urls: Iterable[str]) -> list[Statement]:
    return statements(predicate, [NamedNode(url) for url in dict.fromkeys(sorted(urls))])
