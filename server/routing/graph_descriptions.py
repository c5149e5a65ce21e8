"""Graphs of the dataset without live values: one per resource, each with a token that changes with its content."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import chain, product

from pyoxigraph import NamedNode

from rosld.adapters.model import Graph, MessageSchema, Parameter, Schema, TypeRef, halves_of
from rosld.ontology.describe_body import sources_of_topic
from rosld.ontology.describe_graph import (
    container_document,
    entry_document,
    node_document,
    node_views,
    type_container_document,
)
from rosld.ontology.describe_services import service_document
from rosld.ontology.describe_topics import topic_document
from rosld.ontology.describe_types import type_document
from rosld.ontology.document import Document
from rosld.ontology.modules import MODULES
from rosld.ontology.parameters import parameter_triples
from rosld.ontology.serialize import serialize, serialize_without_observations
from rosld.ontology.syntax import Syntax
from rosld.ontology.urls import Space
from rosld.server.resources import types
from rosld.server.resources.actions import ActionResource, GoalResource
from rosld.server.resources.bags import bag_urls, describe_armed, describe_bag, describe_row, describe_running
from rosld.server.resources.base import Services
from rosld.server.resources.complex_resource import ComplexResource
from rosld.server.resources.datasets import DatasetResource
from rosld.server.resources.faults import FaultResource, faults_listing
from rosld.server.resources.graph import GraphResource
from rosld.server.resources.holds import HoldResource
from rosld.server.resources.listings import calls_listing, goals_listing, holds_listing
from rosld.server.resources.namespaces import NamespaceContainer, listed_graph, namespaces
from rosld.server.resources.nodes import NodeResource
from rosld.server.resources.parameters import ParameterTree
from rosld.server.resources.property_action import MemberResource
from rosld.server.resources.queries import queries_document, shipped_document
from rosld.server.resources.services import CallResource
from rosld.server.resources.stop import StopResource
from rosld.server.resources.topics import TopicResource
from rosld.server.resources.types import SHAPES_GRAPHS, OntologyResource, child_names, known_types, shapes_graph
from rosld.server.runtime.version_cache import IdentityKey
from rosld.server.sparql.materializer import GraphEntry
from rosld.shapes.message import shape_document
from rosld.shapes.parameter import declared_triples

LISTED_ROUTES = ("nodes", "topics", "services", "actions")
"""Routes of containers whose members are names of the computation graph."""


class GraphDescriptions:
    """Descriptions of one robot's resources, without values of topics, parameters and resources."""

    def __init__(self, services: Services) -> None:
        self._services = services
        self._session = services.session
        self._fixed: Mapping[str, Callable[[], Document]] = {}
        self._entries: tuple[Hashable, Mapping[str, GraphEntry]] = (None, {})

    def add(self, fixed: Mapping[str, Callable[[], Document]]) -> None:
        """Add constant documents, by URL."""
        self._fixed = fixed

    @property
    def revision(self) -> Hashable:
        """Revision that changes whenever a description may have changed."""
        return self._revision(self._session.graph)

    def _revision(self, graph: Graph) -> Hashable:
        session, services = self._session, self._services
        return (
            IdentityKey(graph),
            session.schemas.count,
            session.calls.revision,
            session.goals.revision,
            session.name,
            services.holds.revision,
            services.faults.revision,
            services.software_stop.revision,
            services.recordings.history.digests.revision,
            services.queries.version,
            services.recordings.revision,
            IdentityKey(services.active_limits.current),
            IdentityKey(services.mappings.mapping_set),
            IdentityKey(services.affordances.last_tree),
        )

    def entries(self) -> Mapping[str, GraphEntry]:
        """Return every graph without live values, by IRI."""
        graph = self._session.graph
        revision = self._revision(graph)
        if self._entries[0] != revision:
            self._entries = (revision, {entry.iri: entry for entry in self._describe(graph)})
        return self._entries[1]

    def _describe(self, graph: Graph) -> Iterator[GraphEntry]:
        session, services, space = self._session, self._services, self._session.space
        capabilities, problems = session.adapter.capabilities, services.problems()
        listed = listed_graph(graph, capabilities)
        entry = partial(entry_document, listed, space, capabilities.system, problems, name=session.name)
        yield _graph_entry(space.base, (graph.revision, problems, session.name), entry)
        simulated = graph.simulated_time
        for name, known in node_views(graph).items():
            view = NodeResource(services, name).with_offers(known)
            describe = partial(node_document, view, space, simulated_time=simulated)
            yield _graph_entry(space.node(name), (view, simulated), describe)
        for topic in graph.topics.values():
            hold = services.holds.find_by_topic(topic.name)
            held = None if hold is None else hold.id
            can, schema = TopicResource(services, topic.name).is_holdable, session.schemas.find_message(topic.type)
            describe = partial(topic_document, topic, space, graph, holdable=can, hold=held, schema=schema)
            token = (topic, held, can, sources_of_topic(topic, graph), schema is not None)
            yield _graph_entry(space.topic(topic.name), token, describe)
        for service in graph.services.values():
            yield _graph_entry(space.service(service.name), service, partial(service_document, service, space, graph))
        for name, action in graph.actions.items():
            one = ActionResource(services, name)
            goals = tuple(goal.id for goal in session.goals.of_action(name))
            yield _graph_entry(one.url, (action, goals, one.takes_goals), one.document)
        for parameter in graph.parameters.values():
            url = space.parameter(parameter.name)
            yield _graph_entry(url, parameter, partial(parameter_description, parameter, space))
        graph_resource = GraphResource(services)
        yield _graph_entry(graph_resource.url, (IdentityKey(graph), problems), graph_resource.document)
        yield from self._containers(graph)
        yield from self._types()
        yield from self._recordings()
        yield from self._resources()
        yield from self._activities()
        for iri, fixed in self._fixed.items():
            yield _graph_entry(iri, 0, fixed)
        for module in (OntologyResource(services, name) for name in MODULES):
            yield _graph_entry(module.url, 0, module.document)

    def _containers(self, graph: Graph) -> Iterator[GraphEntry]:
        space = self._session.space
        for path in namespaces(graph, "parameters"):
            tree = ParameterTree(self._services, path)
            yield _graph_entry(tree.url, IdentityKey(graph.parameters), partial(_of_itself, tree))
        for route in LISTED_ROUTES:
            for path in namespaces(graph, route):
                listing = NamespaceContainer(self._services, route, path)
                yield _graph_entry(listing.url, *listing.outline())
        yield _graph_entry(
            space.container("queries"),
            self._services.queries.version,
            queries_document(self._services.documents),
        )
        for name, query in self._services.queries.shipped.items():
            url = space.query(name)
            yield _graph_entry(url, 0, partial(shipped_document, url, query))

    def _types(self) -> Iterator[GraphEntry]:
        space = self._session.space
        listed = tuple(sorted({ref.name for ref in known_types(self._session.adapter)}))
        paths = {tuple(name.split("/"))[:depth] for name in listed for depth in range(3)} | {()}
        for route, path in product(("types", "shapes"), sorted(paths)):
            if route == "shapes" and not path:
                continue
            below = child_names(listed, route, path)
            describe = partial(type_container_document, route, path, below, space)
            yield _graph_entry(space.container(route, path), below, describe)
        shapes = types.shapes_document(self._session.adapter, self._services.documents)
        yield _graph_entry(shapes.url, IdentityKey(shapes), lambda: shapes)
        for name in SHAPES_GRAPHS:
            yield _graph_entry(space.shape(name), *shapes_graph(self._services.limit_checks, name))
        variants = known_types(self._session.adapter)
        for schema in self._session.schemas.all():
            yield from self._type(schema, variants)

    def _type(self, schema: Schema, variants: Sequence[TypeRef]) -> Iterator[GraphEntry]:
        space = self._session.space
        for one in (schema,) if isinstance(schema, MessageSchema) else (schema, *halves_of(schema)):
            same = tuple(ref for ref in variants if ref.name == one.ref.name)
            yield _graph_entry(space.type(one.ref.name), (one.ref, same), partial(type_document, one, space, same))
            yield _graph_entry(space.shape(one.ref.name), one.ref, partial(shape_document, one, space))

    def _recordings(self) -> Iterator[GraphEntry]:
        space, recordings = self._session.space, self._services.recordings
        urls = bag_urls(space, recordings)
        yield _container(space.container("bags"), urls, "Recordings")
        dataset = DatasetResource(self._services)
        yield _graph_entry(dataset.url, *dataset.outline())
        if recordings.history.is_enabled:
            past = recordings.history.recording
            size = past.first, past.count, recordings.history.problem
            yield _graph_entry(space.bag(past.name), size, partial(describe_bag, space, recordings, past))
        for row in recordings.catalogue.rows():
            token = row.version, recordings.history.digests.peek(row.path), recordings.interruptions.reason(row.name)
            yield _graph_entry(space.bag(row.name), token, partial(describe_row, space, recordings, row.name))
        for armed in recordings.armed.values():
            waits = armed.count, armed.suspended, armed.problem
            yield _graph_entry(space.bag(armed.name), waits, partial(describe_armed, space, armed))
        for one in recordings.running.values():
            progress = one.writer.count, one.writer.problem
            yield _graph_entry(space.bag(one.name), progress, partial(describe_running, space, recordings, one))

    def _resources(self) -> Iterator[GraphEntry]:
        """Yield the resources below `/resources/` without values, except conditional ones."""
        tree = self._services.affordances.last_tree
        if tree is None:
            return
        simulated = self._session.graph.simulated_time
        members = map(partial(MemberResource, self._services), {*tree.properties, *tree.actions})
        below: Iterable[ComplexResource | MemberResource] = chain(
            map(partial(ComplexResource, self._services), tree.paths), members
        )
        for resource in below:
            state = resource.outline(tree)
            if state is not None:
                yield _graph_entry(resource.url, (state.view, simulated), state.describe)

    def _activities(self) -> Iterator[GraphEntry]:
        """Yield calls, goals, holds, faults and the stop, and the containers of the first four."""
        services = self._services
        calls, goals, holds = self._session.calls.all(), self._session.goals.all(), services.holds.all()
        for listing in (each(services) for each in (calls_listing, goals_listing, holds_listing, faults_listing)):
            yield _graph_entry(listing.url, *listing.outline())
        for call in calls:
            of_call = CallResource(services, call.id)
            yield _graph_entry(of_call.url, (call.id, call.state), partial(of_call.document, call))
        for hold in holds:
            of_hold = HoldResource(services, hold.id)
            yield _graph_entry(of_hold.url, IdentityKey(hold), partial(of_hold.document, hold))
        for fault in services.faults.all():
            of_fault = FaultResource(services, fault.id)
            yield _graph_entry(of_fault.url, IdentityKey(fault), partial(of_fault.document, fault))
        stop, software_stop = StopResource(services), services.software_stop
        yield _graph_entry(stop.url, (software_stop.revision, software_stop.steps), stop.document)
        for goal in goals:
            of_goal = GoalResource(services, goal.id)
            yield _graph_entry(of_goal.url, IdentityKey(goal), partial(of_goal.document, goal))


def parameter_description(parameter: Parameter, space: Space) -> Document:
    """Return a parameter without its value, which is read when a query needs it."""
    url, descriptor = space.parameter(parameter.name), parameter.descriptor
    triples = parameter_triples(url, parameter.name)
    return Document(url, (*triples, *(declared_triples(descriptor, url, space) if descriptor is not None else ())))


def _of_itself(tree: ParameterTree) -> Document:
    """Return the statements of a tree of parameters about itself: those about its members are in their own graphs."""
    document = tree.outline()
    itself = NamedNode(document.url)
    return Document(document.url, tuple(triple for triple in document.all_triples() if triple.subject == itself))


def _container(url: str, members: tuple[str, ...], title: str) -> GraphEntry:
    """Return the graph of a container that only lists its members."""
    return _graph_entry(url, members, partial(container_document, url, members, title))


def _graph_entry(iri: str, token: Hashable, describe: Callable[[], Document]) -> GraphEntry:
    return GraphEntry(iri, token, lambda: document_ntriples(describe()))


def document_ntriples(document: Document, *, observed: bool = True) -> str:
    """Return a document as N-Triples, which the query process reads; on demand without observations of messages."""
    return (serialize(document, Syntax.N_TRIPLES) if observed else serialize_without_observations(document)).decode()
