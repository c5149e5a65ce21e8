"""The dataset that SPARQL sees: one named graph a resource, exactly what a GET of it says.

What listings say of their members is in their graphs only where a query names these: the members say it themselves.

Graphs without live values (the computation graph, containers, types, shapes, the vocabulary) are descriptions, listed
all. Topics with their messages, parameters with their values, resources whose getters are called and recorded messages
are made when a query needs them.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Collection, Coroutine, Hashable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import chain, product

from pyoxigraph import NamedNode

from rosld.adapters.model import (
    MessageSchema,
    Parameter,
    ParameterValue,
    RosError,
    Schema,
    Topic,
    TypeRef,
    halves_of,
    names,
)
from rosld.ontology.describe_containers import container_document, type_container_document
from rosld.ontology.describe_graph import entry_document, node_document, node_views
from rosld.ontology.describe_services import service_document
from rosld.ontology.describe_topics import topic_document
from rosld.ontology.describe_types import type_document
from rosld.ontology.document import Document
from rosld.ontology.modules import MODULES
from rosld.ontology.serialize import Syntax, serialize
from rosld.ontology.triples import RDF_SOURCE, text, triples_about
from rosld.ontology.urls import Location, Space
from rosld.ontology.vocab import rdf, ros
from rosld.server.auth.permissions import Permissions
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.conditions import url_of
from rosld.server.hypermedia.mappings import related
from rosld.server.hypermedia.resource_tree import path_of
from rosld.server.policies import active_limits, stored_queries
from rosld.server.resources import types
from rosld.server.resources.bag_descriptions import bag_urls, describe_armed, describe_bag, describe_running
from rosld.server.resources.listings import ListingResource
from rosld.server.resources.namespaces import (
    NamespaceContainer,
    listed_graph,
    listed_members,
    listing_document,
    namespaces,
    things_of,
)
from rosld.server.resources.parameters import ParameterResource, ParameterTree
from rosld.server.resources.queries import queries_document, shipped_document
from rosld.server.resources.topics import TopicResource
from rosld.server.resources.types import SHAPES_GRAPHS, child_names, known_types, shapes_graph
from rosld.server.rest.resource import Resource
from rosld.server.rest.state import State
from rosld.server.routing.resource_factory import ResourceFactory
from rosld.server.runtime.loop_time import loop_time
from rosld.server.runtime.version_cache import IdentityKey
from rosld.server.sparql.graph_source import GraphEntry
from rosld.server.sparql.needs import Needs
from rosld.server.sparql.vocabulary_view import ACTIONS, COMPLEX, PROPERTIES
from rosld.shapes.message import shape_document
from rosld.shapes.parameter import declared_triples

_KEPT = 256
"""Needs whose resources are remembered."""
OTHER_ROUTES = frozenset({stored_queries.ROUTE, active_limits.ROUTE})
"""The containers of what clients keep in which something else lies too: they are described here, whole."""
_LISTINGS = ("nodes", "topics", "services", "actions")
"""The routes of containers whose members are names of the computation graph."""
_AT_ONCE = 64
"""Looks that are begun before the loop has its turn."""
_TURNS = 4
"""Times that topics are looked at to have their values all of one moment."""


class RobotGraphs:
    """The graphs of one robot: the `GraphSource` of its SPARQL endpoint."""

    def __init__(self, factory: ResourceFactory) -> None:
        self._factory = factory
        self._services = factory.services
        self._session = factory.session
        self._described: tuple[Hashable, Mapping[str, GraphEntry]] = (None, {})
        self._found: dict[Needs, tuple[Hashable, Sequence[Resource]]] = {}
        self._fixed: Mapping[str, Callable[[], Document]] = {}
        self._live: Mapping[str, Resource] = {}

    def add(self, fixed: Mapping[str, Callable[[], Document]], live: Iterable[Resource]) -> None:
        """Add documents that never change, by URL, and resources that are read whenever a query may mean them."""
        self._fixed = fixed
        self._live = {resource.url: resource for resource in live}

    @property
    def revision(self) -> Hashable:
        """Changes whenever a description may have changed."""
        session, services = self._session, self._services
        return (
            IdentityKey(session.graph),
            session.schemas.count,
            session.calls.revision,
            session.goals.revision,
            services.holds.revision,
            services.software_stop.revision,
            services.recordings.history.digests.revision,
            services.queries.version,
            services.recordings.revision,
            IdentityKey(services.active_limits.current),
            IdentityKey(services.mappings.mapping_set),
            IdentityKey(services.affordances.last_tree),
        )

    @property
    def writes(self) -> int:
        """How many writes have ended that the robot was told of."""
        return self._session.interlock.writes

    def descriptions(self) -> Mapping[str, GraphEntry]:
        """Every graph without live values, by IRI."""
        revision = self.revision
        if self._described[0] != revision:
            self._described = (revision, {entry.iri: entry for entry in self._describe()})
        return self._described[1]

    async def documents_of(self, terms: Collection[str]) -> Collection[str]:
        """The URLs of the complex resources, properties and actions that these terms may be said of."""
        tree, space = await self._services.affordances.tree(), self._session.space
        paths: set[str] = set()
        for term in terms:
            paths |= set(tree.paths) if term in COMPLEX else related(tree.mapping_set, term)
        if not PROPERTIES.isdisjoint(terms):
            paths.update(tree.properties)
        if not ACTIONS.isdisjoint(terms):
            paths.update(tree.actions)
        return {url_of(path, space) for path in paths}

    async def count_unread(self, needs: Needs, permissions: Permissions) -> Mapping[str, int]:
        """How many graphs that are there only on demand the needs could match without asking for them, by container.

        Only those count that the judge lets be read.
        """
        session, space = self._session, self._session.space
        found: dict[str, int] = {}
        if needs.is_everything:
            wanted = {one.url for one in self._resources(needs)}
            urls = {space.topic(name) for name in session.graph.topics}
            found["topics"] = sum(map(permissions.may_read, urls - wanted))
        if needs.resources:
            tree = await self._services.affordances.tree()
            urls = {url_of(path, space) for path in (*tree.paths, *tree.properties, *tree.actions)}
            found["resources"] = sum(map(permissions.may_read, urls - needs.documents))
            left = () if needs.is_everything else (url for url in self._live if url not in needs.documents)
            found |= {url.removeprefix(space.base): int(permissions.may_read(url)) for url in left}
        if needs.trees:
            urls = {space.container("parameters", path) for path in namespaces(session.graph, "parameters")}
            found["parameters"] = sum(map(permissions.may_read, urls - needs.graph_names))
        if needs.records:
            recordings = [
                one for one in self._services.recordings.readable.values() if permissions.may_read(space.bag(one.name))
            ]
            named = (space.location(url) for url in needs.documents)
            count = sum(one is not None and one.kind == "bags" and len(one.segments) == 3 for one in named)
            found["bags"] = sum(one.count for one in recordings) - count
        return {container: count for container, count in found.items() if count > 0}

    async def live(self, needs: Needs, *, deadline: float) -> Sequence[GraphEntry]:
        """The graphs of topics and parameters whose values a query needs, as of now.

        What a query names is subscribed to and waited for, at most until `deadline` (loop time); where it names
        nothing, what is subscribed to already is all there is.
        """
        resources = self._resources(needs)
        parameters = [one for one in resources if isinstance(one, ParameterResource | ParameterTree)]
        topics = [one for one in resources if isinstance(one, TopicResource)]
        others = [one for one in resources if not isinstance(one, ParameterResource | ParameterTree | TopicResource)]
        found = await self._look(topics, others, deadline)
        stored = await self._parameters(parameters, deadline)
        return [*stored, *found, *await self._of_topics(topics)]

    def _resources(self, needs: Needs) -> Sequence[Resource]:
        """The resources of `_wanted`, kept for as long as they are the same: where needs name what they are about."""
        if any(demand.is_anything for demand in needs.demands):
            return list(self._wanted(needs))
        version = (self._session.graph.revision, self._session.schemas.count)
        known = self._found.get(needs)
        if known is None or known[0] != version:
            if len(self._found) >= _KEPT:
                self._found.clear()
            known = self._found[needs] = (version, list(self._wanted(needs)))
        return known[1]

    def _wanted(self, needs: Needs) -> Iterator[Resource]:
        session = self._session
        if needs.needs_messages:
            at_hand = {*session.topics.subscribed(), *session.adapter.published}
            definite = Needs(tuple(demand for demand in needs.demands if not demand.is_anything))
            for topic in self._candidates(needs.graphs):
                url = session.space.topic(topic.name)
                asked = needs if topic.name in at_hand else definite  # looking at anything subscribes to nothing new
                if asked.wants_topic(url, self._types_within(topic)):
                    yield self._factory.topic(topic.name)
        if needs.needs_parameters:
            for name in session.graph.parameters:
                if needs.wants_parameter(session.space.parameter(name)):
                    yield self._factory.parameter(name)
            for path in namespaces(session.graph, "parameters") if needs.graph_names else ():
                url = session.space.container("parameters", path)
                if url in needs.graph_names and needs.wants_parameter(url):
                    yield self._factory.parameter_tree(path)
        yield from self._named_listings(needs.graph_names)
        anything = any(demand.is_anything for demand in needs.demands)
        yield from (one for url, one in self._live.items() if anything or url in needs.documents)
        yield from self._named(needs.documents)

    def _named_listings(self, graph_names: frozenset[str]) -> Iterator[Resource]:
        """The listings that are named as graphs: only there they tell what their members say of themselves, too."""
        factory = self._factory
        listings = {"calls": factory.calls, "goals": factory.goals, "holds": factory.holds}
        for url in graph_names:
            location = self._session.space.location(url)
            if location is None or not location.is_container:
                continue
            if location.kind in _LISTINGS:
                yield self._factory.namespace(location.kind, location.segments)
            elif location.kind in listings and not location.segments:
                yield listings[location.kind]()

    def _candidates(self, named: frozenset[str] | None) -> Iterator[Topic]:
        """The topics among these URLs; all where none are named."""
        topics = self._session.graph.topics
        if named is None:
            yield from topics.values()
            return
        for url in named:
            location = self._session.space.location(url)
            if location is not None and location.kind == "topics" and location.name in topics:
                yield topics[location.name]

    def _types_within(self, topic: Topic) -> frozenset[str]:
        """The names of a topic's types and of all types nested in them, as far as they are known."""
        found: set[str] = set()
        for ref in topic.types:
            found.add(ref.name)
            schema = self._session.schemas.find_cached(ref) or self._session.schemas.find_cached_by_name(ref.name)
            if isinstance(schema, MessageSchema):
                found.update(schema.types)
        return frozenset(found)

    def _is_known(self, type: str) -> bool:
        return self._session.schemas.find_cached_by_name(type) is not None

    def _named(self, documents: frozenset[str]) -> Iterator[Resource]:
        """What is in the dataset only where it is named.

        Recorded messages, resources whose getters are called, types that nobody has asked for yet, the edges
        of the graph. Diagnostics are not: their words tell of topics that not everybody may read.
        """
        for url in documents:
            location = self._session.space.location(url)
            match location:
                case Location("bags", (bag, "messages", index), False) if index.isdecimal():
                    recording = self._services.recordings.readable.get(bag)
                    if recording is not None and recording.first <= int(index) < recording.first + recording.count:
                        yield self._factory.bag_message(recording, int(index))
                case Location("types" | "shapes", (_, _, _) as path, False) if not self._is_known("/".join(path)):
                    name = "/".join(path)
                    yield self._factory.type(name) if location.kind == "types" else self._factory.shape(name)
                case Location("graph", (), False):
                    yield self._factory.graph()
                case Location("resources", segments, True):
                    yield self._factory.complex(path_of(segments))
                case Location("resources", (_, *_), False):
                    yield self._factory.member(location.name)

    async def _look(
        self, topics: Iterable[TopicResource], others: Iterable[Resource], deadline: float
    ) -> Sequence[GraphEntry]:
        """The graphs of `others`.

        What must be waited for is looked at together: what getters answer, and the first values of topics.
        """
        is_settled = self._session.topics.is_settled
        firsts = (self._first(topic) for topic in topics if not is_settled(topic.name))
        shown = (
            self._entry(one.url, one.state(), is_transient=isinstance(one, NamespaceContainer | ListingResource))
            for one in others
        )
        tasks: list[asyncio.Future[GraphEntry | None]] = []
        try:
            for coming in chain(firsts, shown):
                tasks.append(asyncio.ensure_future(coming))
                if len(tasks) % _AT_ONCE == 0:
                    await asyncio.sleep(0)
            if tasks:
                seconds = max(0.0, deadline - loop_time())
                await asyncio.wait(tasks, timeout=seconds)
        finally:
            for task in tasks:
                if not task.done():
                    task.cancel()
        entries = [task.result() for task in tasks if task.done() and not task.cancelled()]
        return [entry for entry in entries if entry is not None]

    async def _first(self, topic: TopicResource) -> None:
        """Have the first value of a topic come; what fails is seen again when it is shown."""
        with contextlib.suppress(Problem, RosError):
            await self._session.topics.read(topic.name)

    async def _parameters(
        self, resources: Sequence[ParameterResource | ParameterTree], deadline: float
    ) -> Sequence[GraphEntry]:
        """The graphs of parameters and of trees of them, asked for all together."""
        if not resources:
            return ()
        session = self._session
        until = min(deadline, session.deadline(session.settings.call_deadline))
        try:
            values = await session.adapter.get_parameters([one.name for one in resources], deadline=until)
        except RosError:
            return ()
        found = ((one, values.get(one.name)) for one in resources)
        return [entry for one, value in found if (entry := _of_parameter(one, value)) is not None]

    async def _of_topics(self, resources: Sequence[TopicResource]) -> Sequence[GraphEntry]:
        """The graphs of topics, all of one turn of the loop, in which no message comes.

        Where something must be fetched first (the type of a message), they are all looked at again.
        """
        known = self._session.topics.current_view
        for _ in range(_TURNS):
            turns: list[None] = []
            asyncio.get_running_loop().call_soon(turns.append, None)
            entries = [await self._entry(one.url, one.state_of(known(one.name))) for one in resources]
            if not turns:
                break
        return [entry for entry in entries if entry is not None]

    async def _entry(
        self, iri: str, coming: Coroutine[object, object, State], *, is_transient: bool = False
    ) -> GraphEntry | None:
        """The graph of one resource, None where it cannot be read now."""
        try:
            return _live(iri, await coming)._replace(is_transient=is_transient)
        except (Problem, RosError):
            return None

    def _describe(self) -> Iterator[GraphEntry]:
        session, services = self._session, self._services
        space, graph = session.space, session.graph
        system = session.adapter.capabilities.system
        problems = services.storage_problems()
        entry = partial(entry_document, listed_graph(session), space, system, problems, name=session.name)
        yield _described(space.base, (graph.revision, problems), entry)
        simulated = graph.simulated_time
        for name, known in node_views(graph).items():
            view = self._factory.node(name).with_offers(known)
            describe = partial(node_document, view, space, simulated_time=simulated)
            yield _described(space.node(name), (view, simulated), describe)
        for topic in graph.topics.values():
            hold = services.holds.find_by_topic(topic.name)
            can = self._factory.topic(topic.name).is_holdable
            yield _described(
                space.topic(topic.name),
                (topic, hold and hold.id, can),
                partial(topic_document, topic, space, graph, holdable=can, hold=hold.id if hold else None),
            )
        for service in graph.services.values():
            yield _described(space.service(service.name), service, partial(service_document, service, space, graph))
        for name, action in graph.actions.items():
            one = self._factory.action(name)
            goals = tuple(goal.id for goal in session.goals.of_action(name))
            yield _described(one.url, (action, goals, one.takes_goals), one.document)
        for parameter in graph.parameters.values():
            url = space.parameter(parameter.name)
            yield _described(url, parameter, partial(parameter_description, parameter, space))
        yield from self._containers()
        yield from self._types()
        yield from self._records()
        for iri, fixed in self._fixed.items():
            yield _described(iri, 0, fixed)
        for module in (self._factory.ontology_module(name) for name in MODULES):
            yield _described(module.url, 0, module.document)

    def _containers(self) -> Iterator[GraphEntry]:
        space, graph = self._session.space, self._session.graph
        for path in namespaces(graph, "parameters"):
            tree = self._factory.parameter_tree(path)
            yield _described(tree.url, IdentityKey(graph.parameters), partial(_of_itself, tree))
        for room in _LISTINGS:
            for path, whole in namespaces(graph, room).items():
                members = listed_members(self._session, room, path)
                assert members is not None
                is_name = names.join(path) in things_of(graph, room)
                describe = partial(listing_document, self._session, room, path, members)
                yield _described(space.container(room, path), (members, is_name, members == whole), describe)
        recordings = bag_urls(space, self._services.recordings)
        bags = partial(container_document, space.container("bags"), recordings, "Recordings")
        yield _described(space.container("bags"), recordings, bags)
        yield _described(
            space.container("queries"),
            self._services.queries.version,
            queries_document(self._services.documents, self._services.queries),
        )
        for name, query in self._services.queries.shipped.items():
            url = space.query(name)
            yield _described(url, 0, partial(shipped_document, url, query))

    def _types(self) -> Iterator[GraphEntry]:
        space = self._session.space
        listed = tuple(sorted({ref.name for ref in known_types(self._session)}))
        paths = {tuple(name.split("/"))[:depth] for name in listed for depth in range(3)} | {()}
        for room, path in product(("types", "shapes"), sorted(paths)):
            if room == "shapes" and not path:
                continue
            below = child_names(listed, room, path)
            describe = partial(type_container_document, room, path, below, space)
            yield _described(space.container(room, path), below, describe)
        shapes = types.shapes_document(self._session, self._services.documents)
        yield _described(shapes.url, IdentityKey(shapes), lambda: shapes)
        for name in SHAPES_GRAPHS:
            yield _described(
                space.shape(name),
                *shapes_graph(self._session, self._services.affordances, self._factory.limit_checks, name),
            )
        variants = known_types(self._session)
        for schema in self._session.schemas.all():
            yield from self._type(schema, variants)

    def _type(self, schema: Schema, variants: Sequence[TypeRef]) -> Iterator[GraphEntry]:
        space = self._session.space
        for one in (schema,) if isinstance(schema, MessageSchema) else (schema, *halves_of(schema)):
            same = tuple(ref for ref in variants if ref.name == one.ref.name)
            yield _described(space.type(one.ref.name), (one.ref, same), partial(type_document, one, space, same))
            yield _described(space.shape(one.ref.name), one.ref, partial(shape_document, one, space))

    def _records(self) -> Iterator[GraphEntry]:
        space = self._session.space
        for recording in self._services.recordings.readable.values():
            digest = self._services.recordings.history.digests.known(recording.path)
            size = recording.first, recording.count, self._services.recordings.history.problem, digest
            yield _described(
                space.bag(recording.name),
                size,
                partial(describe_bag, space, self._services.recordings.history, recording),
            )
        for armed in self._services.recordings.armed.values():
            waits = armed.count, armed.problem
            yield _described(space.bag(armed.name), waits, partial(describe_armed, space, armed))
        for one in self._services.recordings.running.values():
            progress = one.writer.count, one.writer.problem
            yield _described(
                space.bag(one.name), progress, partial(describe_running, space, self._services.recordings, one)
            )
        calls = tuple(space.call(call.id) for call in self._session.calls.all())
        listed = partial(container_document, space.container("calls"), calls, "Calls")
        yield _described(space.container("calls"), calls, listed)
        for call in self._session.calls.all():
            resource = self._factory.call(call.id)
            yield _described(resource.url, (call.id, call.state), partial(resource.document, call))
        holds = self._services.holds.all()
        held, room = tuple(space.hold(hold.id) for hold in holds), space.container("holds")
        yield _described(room, held, partial(container_document, room, held, "Holds"))
        for hold in holds:
            of = self._factory.hold(hold.id)
            yield _described(of.url, IdentityKey(hold), partial(of.document, hold))
        stop = self._factory.stop()
        yield _described(
            stop.url, (self._services.software_stop.revision, self._services.software_stop.steps), stop.document
        )
        goals = self._session.goals.all()
        known = tuple(space.goal(goal.id) for goal in goals)
        yield _described(
            space.container("goals"), known, partial(container_document, space.container("goals"), known, "Goals")
        )
        for goal in goals:
            told = self._factory.goal(goal.id)
            yield _described(told.url, IdentityKey(goal), partial(told.document, goal))


def parameter_description(parameter: Parameter, space: Space) -> Document:
    """A parameter without its value, which is read when a query needs it."""
    url, descriptor = space.parameter(parameter.name), parameter.descriptor
    triples = triples_about(NamedNode(url), (rdf.type, ros.Parameter), *RDF_SOURCE, (ros.name, text(parameter.name)))
    return Document(url, (*triples, *(declared_triples(descriptor, url, space) if descriptor is not None else ())))


def _of_itself(tree: ParameterTree) -> Document:
    """What a tree of parameters says of itself alone: the union has what it says of its members from their graphs."""
    document = tree.outline()
    itself = NamedNode(document.url)
    return Document(document.url, tuple(triple for triple in document.all_triples() if triple.subject == itself))


def _of_parameter(resource: ParameterResource | ParameterTree, value: ParameterValue | None) -> GraphEntry | None:
    """The graph of a parameter or a tree, None where it has no value that can be shown."""
    if value is None or isinstance(value, dict) == isinstance(resource, ParameterResource):
        return None
    try:
        return _live(resource.url, resource.state_of(value))._replace(is_transient=isinstance(resource, ParameterTree))
    except Problem:
        return None


def _live(iri: str, state: State) -> GraphEntry:
    return GraphEntry(iri, state.tag, lambda: _ntriples(state.document), lambda: state.document.all_triples())


def _described(iri: str, token: Hashable, describe: Callable[[], Document]) -> GraphEntry:
    return GraphEntry(iri, token, lambda: _ntriples(describe()))


def _ntriples(document: Document) -> str:
    return serialize(document, Syntax.N_TRIPLES).decode()
