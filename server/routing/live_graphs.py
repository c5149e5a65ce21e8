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
from itertools import chain

from rosld.adapters.model import Graph, MessageSchema, ParameterValue, RosError, Topic
from rosld.ontology.document import Document
from rosld.ontology.triples import double
from rosld.ontology.urls import Location, Space
from rosld.ontology.vocab import ros
from rosld.server.auth.permissions import Permissions
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.conditions import url_of
from rosld.server.hypermedia.mappings import related
from rosld.server.hypermedia.resource_tree import path_of
from rosld.server.policies import active_limits, stored_queries
from rosld.server.resources.listings import ListingResource
from rosld.server.resources.namespaces import NamespaceContainer, namespaces
from rosld.server.resources.parameters import ParameterResource, ParameterTree
from rosld.server.resources.topics import TopicResource
from rosld.server.rest.resource import Resource
from rosld.server.rest.state import State
from rosld.server.routing.graph_descriptions import LISTED_ROUTES, GraphDescriptions, document_ntriples
from rosld.server.routing.resource_factory import ResourceFactory
from rosld.server.runtime.loop_time import loop_time
from rosld.server.sparql.graph_source import GraphEntry
from rosld.server.sparql.needs import Needs
from rosld.server.sparql.vocabulary_view import ACTIONS, COMPLEX, PROPERTIES

_KEPT = 256
"""Needs whose resources are remembered."""
OTHER_ROUTES = frozenset({stored_queries.ROUTE, active_limits.ROUTE})
"""The containers of what clients keep in which something else lies too: they are described here, whole."""
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
        self._descriptions = GraphDescriptions(factory)
        self._found: dict[Needs, tuple[Hashable, Sequence[Resource]]] = {}
        self._live: Mapping[str, Resource] = {}

    def add(self, fixed: Mapping[str, Callable[[], Document]], live: Iterable[Resource]) -> None:
        """Add documents that never change, by URL, and resources that are read whenever a query may mean them."""
        self._descriptions.add(fixed)
        self._live = {resource.url: resource for resource in live}

    @property
    def revision(self) -> Hashable:
        """Changes whenever a description may have changed."""
        return self._descriptions.revision

    @property
    def writes(self) -> int:
        """How many writes have ended that the robot was told of."""
        return self._session.interlock.writes

    def descriptions(self) -> Mapping[str, GraphEntry]:
        """Every graph without live values, by IRI."""
        return self._descriptions.entries()

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

        Only those count that the permissions let be read.
        """
        graph, space = self._session.graph, self._session.space
        found: dict[str, int] = {}
        if needs.is_everything:
            wanted = {one.url for one in self._resources(graph, needs)}
            urls = {space.topic(name) for name in graph.topics}
            found["topics"] = sum(map(permissions.may_read, urls - wanted))
        if needs.resources:
            tree = await self._services.affordances.tree()
            urls = {url_of(path, space) for path in (*tree.paths, *tree.properties, *tree.actions)}
            found["resources"] = sum(map(permissions.may_read, urls - needs.documents))
            left = () if needs.is_everything else (url for url in self._live if url not in needs.documents)
            found |= {url.removeprefix(space.base): int(permissions.may_read(url)) for url in left}
        if needs.trees:
            urls = {space.container("parameters", path) for path in namespaces(graph, "parameters")}
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
        resources = self._resources(self._session.graph, needs)
        parameters = [one for one in resources if isinstance(one, ParameterResource | ParameterTree)]
        topics = [one for one in resources if isinstance(one, TopicResource)]
        others = [one for one in resources if not isinstance(one, ParameterResource | ParameterTree | TopicResource)]
        found = await self._look(topics, others, deadline)
        stored = await self._parameters(parameters, deadline)
        rates = self._rates({one.name for one in topics}) if needs.is_everything else ()
        return [*stored, *found, *await self._of_topics(topics), *rates]

    def _resources(self, graph: Graph, needs: Needs) -> Sequence[Resource]:
        """The resources that needs ask for, kept while they are the same: where needs name what they are about."""
        named = self._named_resources(needs.documents)
        if any(demand.is_anything for demand in needs.demands):
            return [*self._needed_resources(graph, needs), *named]
        version = (graph.revision, self._session.schemas.count)
        known = self._found.get(needs)
        if known is None or known[0] != version:
            if len(self._found) >= _KEPT:
                self._found.clear()
            known = self._found[needs] = (version, list(self._needed_resources(graph, needs)))
        return [*known[1], *named]

    def _needed_resources(self, graph: Graph, needs: Needs) -> Iterator[Resource]:
        session = self._session
        if needs.needs_messages:
            at_hand = {*session.topics.looked_at(), *session.adapter.published}
            definite = Needs(tuple(demand for demand in needs.demands if not demand.is_anything))
            for topic in _candidates(session.space, graph, needs.graphs):
                url = session.space.topic(topic.name)
                asked = needs if topic.name in at_hand else definite  # looking at anything subscribes to nothing new
                if asked.wants_topic(url, self._types_within(topic)):
                    yield self._factory.topic(topic.name)
        if needs.needs_parameters:
            for name in graph.parameters:
                if needs.wants_parameter(session.space.parameter(name)):
                    yield self._factory.parameter(name)
            for path in namespaces(graph, "parameters") if needs.graph_names else ():
                url = session.space.container("parameters", path)
                if url in needs.graph_names and needs.wants_parameter(url):
                    yield self._factory.parameter_tree(path)
        yield from self._named_listings(needs.graph_names)
        anything = any(demand.is_anything for demand in needs.demands)
        yield from (one for url, one in self._live.items() if anything or url in needs.documents)

    def _named_listings(self, graph_names: frozenset[str]) -> Iterator[Resource]:
        """The listings that are named as graphs: only there they tell what their members say of themselves, too."""
        factory = self._factory
        listings = {"calls": factory.calls, "goals": factory.goals, "holds": factory.holds}
        for url in graph_names:
            location = self._session.space.location(url)
            if location is None or not location.is_container:
                continue
            if location.kind in LISTED_ROUTES:
                yield self._factory.namespace(location.kind, location.segments)
            elif location.kind in listings and not location.segments:
                yield listings[location.kind]()

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

    def _named_resources(self, documents: frozenset[str]) -> Iterator[Resource]:
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
        until = min(deadline, loop_time() + session.settings.call_deadline)
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

    def _rates(self, shown: Collection[str]) -> Iterator[GraphEntry]:
        """The graphs of other topics that are recorded, with the rate and without messages.

        With their messages a query over 200 such topics took 110 ms of processor time, without them 45.
        """
        topics, described = self._session.topics, self._descriptions.entries()
        for name in topics.subscribed():
            view, entry = topics.peek(name), described.get(self._session.space.topic(name))
            if name not in shown and view is not None and view.rate is not None and entry is not None:
                rate = f"<{entry.iri}> {ros.rate} {double(view.rate)} .\n"
                yield GraphEntry(entry.iri, (entry.token, view.rate), partial(_with_line, entry, rate))

    async def _entry(
        self, iri: str, coming: Coroutine[object, object, State], *, is_transient: bool = False
    ) -> GraphEntry | None:
        """The graph of one resource, None where it cannot be read now."""
        try:
            return _live(iri, await coming)._replace(is_transient=is_transient)
        except (Problem, RosError):
            return None


def _candidates(space: Space, graph: Graph, named: frozenset[str] | None) -> Iterator[Topic]:
    """The topics among these URLs; all where none are named."""
    if named is None:
        yield from graph.topics.values()
        return
    for url in named:
        location = space.location(url)
        if location is not None and location.kind == "topics" and location.name in graph.topics:
            yield graph.topics[location.name]


def _of_parameter(resource: ParameterResource | ParameterTree, value: ParameterValue | None) -> GraphEntry | None:
    """The graph of a parameter or a tree, None where it has no value that can be shown."""
    if value is None or isinstance(value, dict) == isinstance(resource, ParameterResource):
        return None
    try:
        return _live(resource.url, resource.state_of(value))._replace(is_transient=isinstance(resource, ParameterTree))
    except Problem:
        return None


def _with_line(entry: GraphEntry, line: str) -> str:
    """The N-Triples of a graph and one more."""
    return entry.ntriples() + line


def _live(iri: str, state: State) -> GraphEntry:
    return GraphEntry(iri, state.tag, lambda: document_ntriples(state.document), lambda: state.document.all_triples())
