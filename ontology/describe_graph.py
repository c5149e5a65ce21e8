"""The computation graph described: the entry point and the nodes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from pyoxigraph import Literal, NamedNode

from rosld.adapters.model import Graph, Live, Node, Stale
from rosld.ontology.document import Document
from rosld.ontology.namespaces import Kept
from rosld.ontology.triples import CONTAINER, RDF_SOURCE, Statement, Value, about, boolean, each, integer, moment, text
from rosld.ontology.urls import Space
from rosld.ontology.vocab import dcterms, ldp, rdf, rdfs, ros, xsd

ROOMS: Mapping[str, str] = {
    "resources": "Resources",
    "nodes": "Nodes",
    "topics": "Topics",
    "services": "Services",
    "calls": "Calls",
    "parameters": "Parameters",
    "types": "Types",
    "shapes": "Shapes",
    "bags": "Recordings",
    "mappings": "Mappings",
    "data": "Data",
    "queries": "Queries",
}
"""The containers at the top, with their titles."""


def entry_document(graph: Graph, space: Space, system: str = "ROS") -> Document:
    """The entry point `/`: the distributed application (paper, Table 1), its master and state, and all the rooms.

    `system` names the kind of ROS system (`ROS 1`, `recording`, ...).
    """
    entry, rooms = NamedNode(space.base), {room: NamedNode(space.container(room)) for room in ROOMS}
    ontology, sparql = NamedNode(f"{space.base}ontology"), NamedNode(f"{space.base}sparql")
    master = NamedNode(f"{space.base}#master") if graph.master else None
    triples = about(
        entry,
        (rdf.type, ros.Graph),
        *CONTAINER,
        (dcterms.title, text(f"The computation graph ({system})")),
        *_state(graph),
        (ros.master, master),
        *(((ros.simulatedTime, boolean(True)),) if graph.simulated_time else ()),
        *each(ldp.contains, rooms.values()),
        (rdfs.seeAlso, sparql),
        (rdfs.seeAlso, ontology),
    )
    if graph.master and master:
        uri = graph.master.uri
        triples += about(
            master, (rdf.type, ros.Master), (ros.uri, _uri(uri)), (ros.runId, text(graph.master.run_id))
        )  # fmt: skip
    counts = {
        "nodes": len(graph.nodes),
        "topics": len(graph.topics),
        "services": len(graph.services),
        "parameters": len(graph.parameters),
    }
    for room, title in ROOMS.items():
        triples += about(
            rooms[room],
            (rdfs.label, text(title)),
            (ros.count, integer(counts.get(room))),
        )
    triples += about(ontology, (rdfs.label, text("Vocabulary")))
    triples += about(sparql, (rdfs.label, text("SPARQL")))
    return Document(space.base, tuple(triples), simulated_time=graph.simulated_time)


def _state(graph: Graph) -> list[Statement]:
    match graph.state:
        case Live():
            return [(ros.state, ros.Live)]
        case Stale(since_ns, why):
            return [(ros.state, ros.Stale), (ros.staleSince, moment(since_ns)), (ros.reason, text(why))]


def _uri(uri: str | None) -> Value | None:
    found = text(uri)
    return None if found is None else Literal(found.value, datatype=xsd.anyURI)


@dataclass(slots=True)
class NodeLinks:
    """What one node takes part in, by name."""

    publishes: list[str] = field(default_factory=list)
    subscribes: list[str] = field(default_factory=list)
    provides: list[str] = field(default_factory=list)


def _links_by_node(graph: Graph) -> dict[str, NodeLinks]:
    links: dict[str, NodeLinks] = {}
    for topic in graph.topics.values():
        for endpoint in topic.publishers:
            links.setdefault(endpoint.node, NodeLinks()).publishes.append(topic.name)
        for endpoint in topic.subscribers:
            links.setdefault(endpoint.node, NodeLinks()).subscribes.append(topic.name)
    for service in graph.services.values():
        for node in service.providers:
            links.setdefault(node, NodeLinks()).provides.append(service.name)
    return links


links_by_node: Kept[Graph, dict[str, NodeLinks]] = Kept(_links_by_node)
"""What each node of a graph takes part in."""


def node_document(node: Node, graph: Graph, space: Space) -> Document:
    """A node: what it publishes, subscribes to and provides, and why it does not answer, if it does not."""
    url = space.node(node.name)
    links = links_by_node(graph).get(node.name) or NodeLinks()
    triples = about(
        NamedNode(url),
        (rdf.type, ros.Node),
        *RDF_SOURCE,
        (ros.name, text(node.name)),
        (ros.uri, _uri(node.uri)),
        (ros.unreachable, text(node.unreachable)),
        *_links(ros.publishes, map(space.topic, links.publishes)),
        *_links(ros.subscribes, map(space.topic, links.subscribes)),
        *_links(ros.provides, map(space.service, links.provides)),
    )
    return Document(url, tuple(triples), simulated_time=graph.simulated_time)


def _links(predicate: NamedNode, urls: Iterable[str]) -> list[Statement]:
    return each(predicate, [NamedNode(url) for url in dict.fromkeys(sorted(urls))])
