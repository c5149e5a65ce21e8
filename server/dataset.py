"""The dataset that SPARQL sees: one named graph a resource, exactly what a GET of it says.

Graphs without live values (the computation graph, containers, types, shapes, the vocabulary) are descriptions, listed
all. Topics with their messages, parameters with their values and recorded messages are made when a query needs them.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Coroutine, Hashable, Iterator, Mapping, Sequence
from functools import partial
from itertools import product

from pyoxigraph import NamedNode

from rosld.adapters.model import MessageSchema, RosError, Schema, ServiceSchema, Topic, names
from rosld.ontology.describe_bags import bag_document
from rosld.ontology.describe_containers import container_document, namespace_document, type_container_document
from rosld.ontology.describe_graph import entry_document, node_document
from rosld.ontology.describe_services import service_document
from rosld.ontology.describe_topics import topic_document
from rosld.ontology.describe_types import type_document
from rosld.ontology.document import Document
from rosld.ontology.serialize import Syntax, serialize
from rosld.ontology.triples import RDF_SOURCE, about, text
from rosld.ontology.urls import Location
from rosld.ontology.vocab import rdf, ros
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.layout import path_of
from rosld.server.ldp.resource import Resource
from rosld.server.resources.bags import BagMessage
from rosld.server.resources.complex import ComplexResource
from rosld.server.resources.members import MemberResource
from rosld.server.resources.namespaces import namespaces, of_room
from rosld.server.resources.ontology import vocabulary
from rosld.server.resources.parameters import ParameterResource
from rosld.server.resources.services import CallResource
from rosld.server.resources.topics import TopicResource
from rosld.server.resources.types import WHOLE, known_types, names_below, whole_shape
from rosld.server.robot import Robot
from rosld.server.sparql.needs import Needs
from rosld.server.sparql.sync import GraphEntry
from rosld.shapes.message import shape_document

_KEPT = 256
"""Needs whose resources are remembered."""
_AT_ONCE = 64
"""Topics looked at concurrently for one query."""


class Dataset:
    """The graphs of one robot: the `GraphSource` of its SPARQL endpoint."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._described: tuple[Hashable, Mapping[str, GraphEntry]] = (None, {})
        self._found: dict[Needs, tuple[Hashable, Sequence[Resource]]] = {}

    @property
    def revision(self) -> Hashable:
        """Changes whenever a description may have changed."""
        robot = self._robot
        return (robot.graph.revision, robot.schemas.count, robot.calls.revision)

    def descriptions(self) -> Mapping[str, GraphEntry]:
        """Every graph without live values, by IRI."""
        revision = self.revision
        if self._described[0] != revision:
            self._described = (revision, {entry.iri: entry for entry in self._describe()})
        return self._described[1]

    async def live(self, needs: Needs, *, deadline: float) -> Sequence[GraphEntry]:
        """The graphs of topics and parameters whose values a query needs, as of now.

        What a query names is subscribed to and waited for, at most until `deadline` (loop time); where it names
        nothing, what is subscribed to already is all there is.
        """
        resources = self._resources(needs)
        for batch in (resources[at : at + _AT_ONCE] for at in range(0, len(resources), _AT_ONCE)):
            await self._look(batch, deadline)
        entries = [await self._entry(resource) for resource in resources]
        return [entry for entry in entries if entry is not None]

    def _resources(self, needs: Needs) -> Sequence[Resource]:
        """The resources of `_wanted`, kept for as long as they are the same: where needs name what they are about."""
        if any(demand.anything for demand in needs.demands):
            return list(self._wanted(needs))
        version = (self._robot.graph.revision, self._robot.schemas.count)
        known = self._found.get(needs)
        if known is None or known[0] != version:
            if len(self._found) >= _KEPT:
                self._found.clear()
            known = self._found[needs] = (version, list(self._wanted(needs)))
        return known[1]

    def _wanted(self, needs: Needs) -> Iterator[Resource]:
        robot = self._robot
        if needs.messages:
            subscribed = frozenset(robot.topics.subscribed())
            definite = Needs(tuple(demand for demand in needs.demands if not demand.anything))
            for topic in self._candidates(needs.graphs):
                url = robot.space.topic(topic.name)
                asked = needs if topic.name in subscribed else definite  # looking at anything subscribes to nothing new
                if asked.wants_topic(url, self._types_within(topic)):
                    yield TopicResource(robot, topic.name)
        if needs.parameters:
            for name in robot.graph.parameters:
                if needs.wants_parameter(robot.space.parameter(name)):
                    yield ParameterResource(robot, name)
        yield from self._named(needs.documents)

    def _candidates(self, named: frozenset[str] | None) -> Iterator[Topic]:
        """The topics among these URLs; all where none are named."""
        topics = self._robot.graph.topics
        if named is None:
            yield from topics.values()
            return
        for url in named:
            location = self._robot.space.location(url)
            if location is not None and location.kind == "topics" and location.name in topics:
                yield topics[location.name]

    def _types_within(self, topic: Topic) -> frozenset[str]:
        """The names of a topic's types and of all types nested in them, as far as they are known."""
        found: set[str] = set()
        for ref in topic.types:
            found.add(ref.name)
            schema = self._robot.schemas.at_hand(ref) or self._robot.schemas.named(ref.name)
            if isinstance(schema, MessageSchema):
                found.update(schema.types)
        return frozenset(found)

    def _named(self, documents: frozenset[str]) -> Iterator[Resource]:
        """What is in the dataset only where it is named: recorded messages, and resources whose getters are called."""
        for url in documents:
            location = self._robot.space.location(url)
            match location:
                case Location("bags", (bag, "messages", index), False) if index.isdecimal():
                    recording = self._robot.adapter.recordings.get(bag)
                    if recording is not None and int(index) < recording.count:
                        yield BagMessage(self._robot, recording, int(index))
                case Location("resources", segments, True):
                    yield ComplexResource(self._robot, path_of(segments))
                case Location("resources", (_, *_), False):
                    yield MemberResource(self._robot, location.name)

    async def _look(self, resources: Sequence[Resource], deadline: float) -> None:
        """Have what must be waited for looked at together: the first values of topics, what getters answer."""
        topics = self._robot.topics
        names = [each.name for each in resources if isinstance(each, TopicResource)]
        looks: list[Coroutine[object, object, object]] = [
            *(topics.look(name) for name in names if topics.peek(name) is None),
            *(each.state() for each in resources if isinstance(each, ComplexResource | MemberResource)),
        ]
        if looks:
            seconds = max(0.0, deadline - asyncio.get_running_loop().time())
            with contextlib.suppress(asyncio.TimeoutError, TimeoutError):
                await asyncio.wait_for(asyncio.gather(*looks, return_exceptions=True), seconds)

    async def _entry(self, resource: Resource) -> GraphEntry | None:
        """The graph of one resource, None where it cannot be read now."""
        try:
            state = await resource.state()
        except (Problem, RosError):
            return None
        return GraphEntry(resource.url, state.tag, lambda: _ntriples(state.document))

    def _describe(self) -> Iterator[GraphEntry]:
        robot, space, graph = self._robot, self._robot.space, self._robot.graph
        system = robot.adapter.capabilities.system
        yield _described(space.base, graph.revision, partial(entry_document, graph, space, system))
        for node in graph.nodes.values():
            yield _described(space.node(node.name), graph.revision, partial(node_document, node, graph, space))
        for topic in graph.topics.values():
            yield _described(space.topic(topic.name), topic, partial(topic_document, topic, space, graph))
        for service in graph.services.values():
            yield _described(space.service(service.name), service, partial(service_document, service, space, graph))
        for name in graph.parameters:
            url = space.parameter(name)
            yield _described(url, name, partial(described_parameter, url, name))
        yield from self._containers()
        yield from self._types()
        yield from self._records()
        ontology = Document(f"{space.base}ontology", vocabulary())
        yield _described(ontology.url, 0, lambda: ontology)

    def _containers(self) -> Iterator[GraphEntry]:
        space, graph = self._robot.space, self._robot.graph
        for room in ("nodes", "topics", "services", "parameters"):
            for path, members in namespaces(graph, room).items():
                is_name = names.join(path) in of_room(graph, room)
                describe = partial(namespace_document, room, path, members, space, is_name=is_name)
                yield _described(space.container(room, path), (members, is_name), describe)
        recordings = tuple(map(space.bag, self._robot.adapter.recordings))
        bags = partial(container_document, space.container("bags"), recordings, "Recordings")
        yield _described(space.container("bags"), recordings, bags)

    def _types(self) -> Iterator[GraphEntry]:
        space = self._robot.space
        listed = tuple(sorted({ref.name for ref in known_types(self._robot)}))
        paths = {tuple(name.split("/"))[:depth] for name in listed for depth in range(3)} | {()}
        for room, path in product(("types", "shapes"), sorted(paths)):
            below = names_below(listed, room, path)
            describe = partial(type_container_document, room, path, below, space)
            yield _described(space.container(room, path), below, describe)
        for name in WHOLE:
            yield _described(space.shape(name), 0, partial(whole_shape, self._robot, name))
        for schema in self._robot.schemas.all():
            yield from self._type(schema)

    def _type(self, schema: Schema) -> Iterator[GraphEntry]:
        space = self._robot.space
        yield _described(space.type(schema.ref.name), schema.ref, partial(type_document, schema, space))
        halves = (schema.request, schema.response) if isinstance(schema, ServiceSchema) else (schema,)
        for half in halves:
            yield _described(space.shape(half.ref.name), schema.ref, partial(shape_document, half, space))

    def _records(self) -> Iterator[GraphEntry]:
        space = self._robot.space
        for recording in self._robot.adapter.recordings.values():
            yield _described(space.bag(recording.name), 0, partial(bag_document, recording, space))
        calls = tuple(space.call(call.id) for call in self._robot.calls.all())
        listed = partial(container_document, space.container("calls"), calls, "Calls")
        yield _described(space.container("calls"), calls, listed)
        for call in self._robot.calls.all():
            resource = CallResource(self._robot, call.id)
            yield _described(resource.url, (call.id, call.state), partial(resource.document, call))


def described_parameter(url: str, name: str) -> Document:
    """A parameter without its value, which is read when a query needs it."""
    return Document(url, tuple(about(NamedNode(url), (rdf.type, ros.Parameter), *RDF_SOURCE, (ros.name, text(name)))))


def _described(iri: str, token: Hashable, describe: Callable[[], Document]) -> GraphEntry:
    return GraphEntry(iri, token, lambda: _ntriples(describe()))


def _ntriples(document: Document) -> str:
    return serialize(document, Syntax.N_TRIPLES).decode()
