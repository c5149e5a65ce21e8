"""Documents of the computation graph: the entry point, nodes, their lifecycle, containers, and edges."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from typing import NamedTuple, TypeVar

from msgspec import Struct, field
from pyoxigraph import Literal, NamedNode, Triple

from rosld.adapters.model import Endpoint, Graph, Lifecycle, LifecycleState, Live, Master, Node, Stale, Topic, names
from rosld.ontology import kinds
from rosld.ontology.describe_body import body_links, body_sources
from rosld.ontology.describe_topics import endpoints_of
from rosld.ontology.describe_views import search_triples
from rosld.ontology.document import Document
from rosld.ontology.names import IdentityCache, Members
from rosld.ontology.node_shape import CONTAINER_TYPES, SOURCE, NodeShape, many, one, optional
from rosld.ontology.triples import (
    BODIES,
    CONTAINER,
    RDF_SOURCE,
    Statement,
    date_time_literal,
    forms,
    integer,
    labelled,
    statements,
    text,
    triples_about,
)
from rosld.ontology.urls import Space
from rosld.ontology.vocab import cora, dcterms, hydra, ldp, rdf, rdfs, ros, sh, sosa, td, xsd

_STATES: Mapping[int, NamedNode] = {
    1: ros.Unconfigured,
    2: ros.Inactive,
    3: ros.Active,
    4: ros.Finalized,
    10: ros.Configuring,
    11: ros.CleaningUp,
    12: ros.ShuttingDown,
    13: ros.Activating,
    14: ros.Deactivating,
    15: ros.ErrorProcessing,
}
"""The states of lifecycle_msgs/msg/State that have a meaning."""


def transition_triples(node: str, lifecycle: Lifecycle, space: Space) -> list[Triple]:
    """Return an affordance of the node at a URL for each transition that is legal now, with its input and forms."""
    subject = NamedNode(node)
    triples: list[Triple] = []
    for transition in lifecycle.transitions:
        affordance = NamedNode(space.fragment(node, "transitions", transition.label))
        shape, path = (NamedNode(f"{affordance.value}/{part}") for part in ("shape", "shape/transition"))
        label = text(transition.label)
        triples += [
            Triple(subject, td.hasActionAffordance, affordance),
            *triples_about(
                affordance,
                (rdf.type, td.ActionAffordance),
                (td.name, label),
                *_goal(transition.goal),
                (ros.shape, shape),
            ),
            *forms(affordance, "invoke", "POST", td.invokeAction, node, BODIES),
            *triples_about(shape, (rdf.type, sh.NodeShape), (sh.property, path)),
            *triples_about(
                path,
                (sh.path, ros.transition),
                (sh.datatype, xsd.string),
                (sh.hasValue, label),
                (sh.minCount, integer(1)),
                (sh.maxCount, integer(1)),
            ),
        ]
    return triples


def _goal(state: LifecycleState) -> tuple[Statement, ...]:
    return ((ros.targetState, _STATES.get(state.id)), (ros.targetStateWord, text(state.label)))


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
    "faults": "Faults",
    "parameters": "Parameters",
    "types": "Types",
    "shapes": "Shapes",
    "bags": "Recordings",
    "mappings": "Mappings",
    "data": "Data",
    "queries": "Queries",
    "cockpit": "Cockpits",
}
"""The top-level containers with their titles."""


class ServerProblems(NamedTuple):
    """Problems of a server: why it cannot store everything, and the URLs of holds that were interrupted."""

    storage: tuple[str, ...] = ()
    interrupted_holds: tuple[str, ...] = ()


_NO_PROBLEMS = ServerProblems()


_SERVICES: Mapping[str, str] = {
    "sparql": "SPARQL",
    "graphs": "Graph store",
    "graph": "Who talks to whom",
    "ontology": "Ontology",
}
"""Single resources among the routes, by name below the base, with their labels."""
_GUIDES: Mapping[str, str] = {"?offer": "Offer", "llms.txt": "Guide for language models"}
"""Guides for agents, by reference below the base, with their labels."""


_GRAPH = NodeShape[Graph]("Graph", "a computation graph", ros.Graph, *CONTAINER_TYPES).with_properties(
    one(dcterms.title, kinds.TEXT),
    one(ros.state, kinds.TERM.where("sh:in ( ros:Live ros:Stale )")),
    optional(ros.staleSince, kinds.DATE_TIME),
    optional(ros.reason, kinds.TEXT),
    one(ros.robot, kinds.FRAGMENT.where("sh:class sosa:Platform"), lambda graph: "#robot"),
    optional(
        ros.hasMaster, kinds.FRAGMENT.where("sh:class ros:Master"), lambda graph: "#master" if graph.master else None
    ),
    one(hydra.search, kinds.IRI.where("sh:class hydra:IriTemplate")),
    optional(ros.simulatedTime, kinds.FLAG, lambda graph: graph.simulated_time or None),
    many(ldp.contains, kinds.FRAGMENT, lambda graph: [f"{route}/" for route in SECTIONS], minimum=1),
    one(ros.hasStop, kinds.FRAGMENT, lambda graph: "stop"),
    one(ros.hasServerStatus, kinds.FRAGMENT, lambda graph: "status"),
    many(rdfs.seeAlso, kinds.FRAGMENT, lambda graph: (*_SERVICES, *_GUIDES, "cockpit/default"), minimum=1),
)
_ROBOT = NodeShape[str]("Robot", "the machine", sosa.Platform, cora.Robot).with_properties(
    one(rdfs.label, kinds.TEXT, lambda name: name),
    many(sosa.hosts, kinds.IRI, minimum=1),
    optional(ros.hasBody, kinds.IRI),
)
_SURROUNDINGS = NodeShape[str]("Surroundings", "what surrounds the machine", sosa.FeatureOfInterest).with_properties(
    one(rdfs.label, kinds.TEXT, lambda name: f"surroundings of {name}")
)
_MASTER = NodeShape[Master]("Master", "a master", ros.Master).with_properties(
    optional(ros.uri, kinds.URI, lambda master: master.uri),
    optional(ros.runId, kinds.TEXT, lambda master: master.run_id),
)


def entry_document(
    graph: Graph, space: Space, system: str = "ROS", problems: ServerProblems = _NO_PROBLEMS, *, name: str = "robot"
) -> Document:
    """Return the entry point `/`: the distributed application (paper, Table 1), its machine, master, state, and routes.

    `system` names the kind of ROS system (`ROS 1`, `recording`, ...), `name` the robot.
    """
    entry, title = NamedNode(space.base), labelled(dcterms.title, f"The computation graph ({system})")
    master = NamedNode(f"{space.base}#master") if graph.master else None
    triples = _GRAPH.triples(entry, graph, space, *title, (ros.hasMaster, master), *graph_state(graph))
    robot = f"{space.base}#robot"
    triples += _ROBOT.triples(NamedNode(robot), name, space, (sosa.hosts, entry))
    triples += body_links(robot, ros.hasBody, body_sources(graph), space)
    triples += _SURROUNDINGS.triples(NamedNode(f"{space.base}#surroundings"), name, space)
    if master and graph.master:
        triples += _MASTER.triples(master, graph.master, space)
    triples += _section_triples(graph, space)
    triples += triples_about(NamedNode(f"{space.base}status"), *problem_statements(problems))
    triples += search_triples(entry, space)
    for each, label in {**_SERVICES, **_GUIDES}.items():
        triples.append(Triple(NamedNode(space.base + each), rdfs.label, Literal(label)))
    return Document(space.base, tuple(triples), simulated_time=graph.simulated_time)


def _section_triples(graph: Graph, space: Space) -> Iterator[Triple]:
    """Yield the titles of the routes, and their numbers of members if the graph has them."""
    counts = {
        "nodes": len(graph.nodes),
        "topics": len(graph.topics),
        "services": len(graph.services),
        "actions": len(graph.actions),
        "parameters": len(graph.parameters),
    }
    for route, title in SECTIONS.items():
        properties = ((rdfs.label, text(title)), (ros.count, integer(counts.get(route))))
        yield from triples_about(NamedNode(space.container(route)), *properties)


def problem_statements(problems: ServerProblems) -> list[Statement]:
    """Return the problems of a server."""
    return [
        *statements(ros.storageProblem, map(Literal, problems.storage)),
        *statements(ros.interruptedHold, map(NamedNode, problems.interrupted_holds)),
    ]


def graph_state(graph: Graph) -> list[Statement]:
    """Return statements about whether the robot is reachable and, if not, since when and why."""
    match graph.state:
        case Live():
            return [(ros.state, ros.Live)]
        case Stale(since_ns, why):
            return [(ros.state, ros.Stale), (ros.staleSince, date_time_literal(since_ns)), (ros.reason, text(why))]


class NodeView(Struct, frozen=True):
    """A node and everything it takes part in: topics with its endpoints on them, the others by name.

    `offers`: its transitions are available now, and get forms.
    """

    node: Node
    publishes: tuple[tuple[Topic, tuple[Endpoint, ...]], ...] = ()
    subscribes: tuple[tuple[Topic, tuple[Endpoint, ...]], ...] = ()
    provides: tuple[str, ...] = ()
    serves: tuple[str, ...] = ()
    sends_goals_to: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    offers: bool = False

    @property
    def lifecycle(self) -> Lifecycle:
        return self.node.lifecycle or Lifecycle("")

    @property
    def state(self) -> LifecycleState | None:
        return self.lifecycle.state


class _Parts(Struct):
    """Builder of a `NodeView`."""

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
    """Omit the inner topics and services of ROS 2 actions, which are described as actions."""
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
"""The nodes of a graph with everything that each takes part in."""


def _uses(view: NodeView, space: Space) -> dict[NamedNode, Sequence[str]]:
    """Return the URLs of the resources that a node takes part in, by the linking property."""
    return {
        ros.publishes: [space.topic(topic.name) for topic, _ in view.publishes],
        ros.subscribes: [space.topic(topic.name) for topic, _ in view.subscribes],
        ros.provides: [*map(space.service, view.provides), *map(space.action, view.serves)],
        ros.sendsGoalsTo: [space.action(name) for name in view.sends_goals_to],
    }


_NODE = NodeShape[NodeView]("Node", "a node", ros.Node, *SOURCE, is_listed=True).with_properties(
    one(ros.name, kinds.NAME, lambda view: view.node.name),
    optional(ros.uri, kinds.URI, lambda view: view.node.uri),
    optional(ros.unreachable, kinds.TEXT, lambda view: view.node.unreachable),
    optional(ros.lifecycleState, kinds.STATE, lambda view: _STATES.get(view.state.id) if view.state else None),
    optional(ros.lifecycleStateWord, kinds.TEXT, lambda view: view.state.label if view.state else None),
    optional(ros.lifecycleUnknown, kinds.TEXT, lambda view: view.lifecycle.unknown),
    many(ros.publishes, kinds.TOPIC),
    many(ros.subscribes, kinds.TOPIC),
    many(ros.provides, kinds.IRI.where('sh:pattern "/(services|actions)/"')),
    many(ros.sendsGoalsTo, kinds.ACTION),
    many(ros.hasParameter, kinds.PARAMETER, lambda view: view.parameters),
    many(ros.hasEndpoint, kinds.ENDPOINT),
    many(td.hasActionAffordance, kinds.ACTION_AFFORDANCE),
)


def node_document(view: NodeView, space: Space, *, simulated_time: bool = False) -> Document:
    """Return a node with its lifecycle, its endpoints, services, actions and parameters.

    Topics include the quality of service; a node that does not answer has the reason.
    """
    url, lifecycle = space.node(view.node.name), view.node.lifecycle
    endpoints = [
        described
        for kind, topics in ((ros.Publisher, view.publishes), (ros.Subscriber, view.subscribes))
        for topic, own in topics
        for described in endpoints_of(kind, own, topic, space)
    ]
    triples = _NODE.triples(
        NamedNode(url),
        view,
        space,
        (rdf.type, ros.ManagedNode if lifecycle else None),
        *((predicate, NamedNode(used)) for predicate, urls in _uses(view, space).items() for used in sorted(urls)),
        *statements(ros.hasEndpoint, [endpoint for endpoint, _ in endpoints]),
    )
    for _, described in endpoints:
        triples += described
    if lifecycle and view.offers:
        triples += transition_triples(url, lifecycle, space)
    return Document(url, tuple(triples), simulated_time=simulated_time)


def container_document(url: str, members: Iterable[str], title: str) -> Document:
    """Return a container and the URLs of its members; a URL that ends in a slash is a container itself."""
    found = [NamedNode(member) for member in members]
    return Document(
        url,
        tuple(
            triples_about(
                NamedNode(url),
                *CONTAINER,
                *labelled(dcterms.title, title),
                *statements(ldp.contains, found),
            )
        ),
    )


def namespace_title(route: str, namespace: tuple[str, ...]) -> str:
    """Return the title of a namespace of names of one kind."""
    title = SECTIONS.get(route, route.capitalize())
    return f"{title} in {names.join(namespace)}" if namespace else title


def namespace_document(
    route: str,
    namespace: tuple[str, ...],
    members: Members,
    space: Space,
    *,
    is_name: bool = False,
    whole: str | None = None,
) -> Document:
    """Return a namespace of names of one kind: its direct members and nested namespaces; a name can be both.

    `is_name`: the namespace is also a name (`/camera/image_raw`), and links to it. `whole` is the URL that includes its
    hidden members, if any. Members are described in their own graphs only, so that a query over all graphs finds
    each statement once.
    """
    url = space.container(route, namespace)
    leaves = {leaf: NamedNode(space.url(route, (*namespace, leaf))) for leaf in members.leaves}
    below = {inner: NamedNode(space.container(route, (*namespace, inner))) for inner in members.namespaces}
    triples = triples_about(
        NamedNode(url),
        *CONTAINER,
        *labelled(dcterms.title, namespace_title(route, namespace)),
        (ros.name, text(names.join(namespace)) if namespace else None),
        *statements(ldp.contains, leaves.values()),
        *statements(ldp.contains, below.values()),
        (rdfs.seeAlso, NamedNode(space.url(route, namespace)) if is_name else None),
        (rdfs.seeAlso, NamedNode(whole) if whole else None),
    )
    return Document(url, tuple(triples))


def type_container_document(route: str, namespace: tuple[str, ...], below: Sequence[str], space: Space) -> Document:
    """Return a container of types or shapes: `below` are the type names (`pkg/msg/X`) in this namespace."""
    depth = len(namespace)
    members: dict[str, str] = {}
    for name in below:
        path = tuple(name.split("/"))
        if len(path) == depth + 1:
            members[space.url(route, path)] = name
        else:
            members[space.container(route, path[: depth + 1])] = _types_title(route, path[: depth + 1])
    document = container_document(space.container(route, namespace), members, _types_title(route, namespace))
    labels = [Triple(NamedNode(url), rdfs.label, Literal(label)) for url, label in members.items()]
    return Document(document.url, (*document.triples, *labels))


def _types_title(route: str, namespace: Sequence[str]) -> str:
    return SECTIONS[route] + (f" of {'/'.join(namespace)}" if namespace else "")


def edges_document(
    url: str, views: Mapping[str, NodeView], space: Space, shown: Set[str], problems: Iterable[tuple[str, str]]
) -> Document:
    """Return the nodes among the URLs `shown`, each with the resources among these that it uses.

    `problems` maps URLs to descriptions of problems with their resources.
    """
    triples = triples_about(NamedNode(url), *RDF_SOURCE, *labelled(dcterms.title, "Who talks to whom"))
    for name, view in views.items():
        if space.node(name) in shown:
            for predicate, urls in _uses(view, space).items():
                links = statements(predicate, [NamedNode(each) for each in urls if each in shown])
                triples += triples_about(NamedNode(space.node(name)), *links)
    for thing, words in problems:
        triples += triples_about(NamedNode(thing), (rdfs.comment, text(words)))
    return Document(url, tuple(triples))
