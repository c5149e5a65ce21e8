"""The dataset of SPARQL: one named graph per resource, with exactly the triples of a GET of it.

Descriptions (the computation graph, containers, types, shapes, resources without values, the vocabulary) require no
reading of the robot and are always present. Values (latest messages, those of parameters and properties, and
affordances that depend on them) are read when a query can match them.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Hashable, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache, partial, reduce
from itertools import chain
from typing import NamedTuple

from msgspec.structs import replace

from rosld.adapters.model import Array, Graph, MessageSchema, Nested, ParameterValue, RosError, Topic
from rosld.ontology import describe_body, geometry
from rosld.ontology.document import Document
from rosld.ontology.observations import CLASSES, PREDICATES, role_of
from rosld.ontology.urls import Location, Space
from rosld.ontology.vocab import rdf, rdfs, ros
from rosld.server.auth.permissions import Permissions
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.catalogue import Property, TopicSource
from rosld.server.hypermedia.conditions import url_of
from rosld.server.hypermedia.resource_tree import ComplexPlan, MemberPlan, ResourceTree
from rosld.server.hypermedia.type_inference import is_bulky
from rosld.server.policies import active_limits, stored_queries
from rosld.server.resources.bag_messages import BagMessage
from rosld.server.resources.base import Services
from rosld.server.resources.body import BodyResource
from rosld.server.resources.complex_resource import ComplexResource
from rosld.server.resources.namespaces import NamespaceContainer, namespaces
from rosld.server.resources.parameters import ParameterResource, ParameterTree
from rosld.server.resources.property_action import MemberResource
from rosld.server.resources.topics import TopicResource
from rosld.server.resources.types import TypeResource
from rosld.server.rest.resource import Resource
from rosld.server.rest.state import State
from rosld.server.routing.graph_descriptions import GraphDescriptions, document_ntriples
from rosld.server.runtime.tasks import loop_time
from rosld.server.runtime.version_cache import IdentityKey, VersionCache
from rosld.server.sparql.materializer import GraphEntry, LiveDocument, LiveGraphs
from rosld.server.sparql.needs import Constants, Needs, StatedTerms
from rosld.shapes.value import MessageShape

_MAX_CACHED = 256
"""Maximum number of needs whose documents are cached."""
OTHER_ROUTES = frozenset({stored_queries.ROUTE, active_limits.ROUTE})
"""Containers of stored documents that have other members too, and so are described here completely."""
_AT_ONCE = 64
"""Number of reads started before the loop may run."""
_TURNS = 4
"""Maximum number of attempts to read the values of all topics at the same moment."""


_MESSAGE = frozenset(
    term.value for term in (rdf.type, ros.received, ros.sequence, ros.sentBy, ros.dateTime, ros.elidedLength, ros.bytes)
)
"""Predicates of any message, in addition to its fields."""
_LISTS = frozenset({rdf.first.value, rdf.rest.value})
_CLASSES = frozenset({ros.Message.value, ros.Elided.value})
_TOPIC = frozenset(term.value for term in (ros.latest, ros.latestFrom, ros.unreadable, ros.words))
_PROPERTY = frozenset(term.value for term in (rdf.value, ros.unreadable, ros.words, ros.readsFrom))
_READ_AT_ONCE = (TopicResource, NamespaceContainer)
_RATE = StatedTerms(frozenset({ros.rate.value}), frozenset())
_BRIEF = StatedTerms(frozenset({ros.briefValue.value, ros.rate.value}), frozenset())
_PARAMETER = StatedTerms(frozenset({ros.value.value}), frozenset())
_BODY = StatedTerms(describe_body.PREDICATES, describe_body.CLASSES)
_BODY_ALONE = StatedTerms(describe_body.PREDICATES - {ros.name.value, rdfs.label.value}, describe_body.CLASSES)
_OBSERVATIONS = StatedTerms(PREDICATES, CLASSES)
_ANYTHING = StatedTerms()
_OBSERVED_SECONDS = 60.0
"""Seconds after a query for observations in which they remain in the dataset, also for queries that do not need them.

A query that is waiting for its values must not find them removed by another one.
"""


class _Candidate(NamedTuple):
    """A document with values: its URL, the terms of the values, and the factory of its resource.

    One that reads pictures or point clouds has values only `by_name`. Queries with terms outside of `own` alone do not
    need current values.
    """

    url: str
    terms: StatedTerms
    make: Callable[[], Resource]
    by_name: bool = False
    own: StatedTerms | None = None


class RobotGraphs:
    """The graphs of one robot: the `GraphSource` of its SPARQL endpoint."""

    def __init__(self, services: Services) -> None:
        self._services = services
        self._affordances = services.affordances
        self._session = services.session
        self._descriptions = GraphDescriptions(services)
        self._cached = VersionCache[Sequence[LiveDocument]](_MAX_CACHED)
        self._changing: Sequence[Resource] = ()
        self._observed_until = 0.0

    def add(self, fixed: Mapping[str, Callable[[], Document]], changing: Iterable[Resource]) -> None:
        """Add constant documents, by URL, and resources whose state is read for each query that may match them."""
        self._descriptions.add(fixed)
        self._changing = tuple(changing)

    @property
    def revision(self) -> Hashable:
        """Revision that changes whenever a description may have changed."""
        return self._descriptions.revision

    @property
    def writes(self) -> int:
        """Number of completed writes to the robot."""
        return self._session.interlock.writes

    def descriptions(self) -> Mapping[str, GraphEntry]:
        """Return every graph without values, by IRI."""
        return self._descriptions.entries()

    async def prepare(self, needs: Needs) -> None:
        """Make the descriptions of the resources below `/resources/` and of the types in a query available."""
        await self._affordances.tree()
        for location in map(self._session.space.location, needs.documents):
            match location:
                case Location("types" | "shapes", (_, _, _) as path, False) if not self._is_known("/".join(path)):
                    await self._read_type("/".join(path))

    def _is_known(self, type: str) -> bool:
        return self._session.schemas.find_cached_by_name(type) is not None

    async def _read_type(self, name: str) -> None:
        try:
            await TypeResource(self._services, name).state()
        except (Problem, RosError):  # the query finds nothing there, as a GET does
            pass

    # --- needs

    def wanted(self, needs: Needs, permissions: Permissions) -> Sequence[LiveDocument]:
        """Return the documents whose values a query can match and the permissions allow to read."""
        if not needs.patterns and not needs.asks_graphs:
            return ()
        tree = self._affordances.cached_tree() or self._affordances.last_tree
        graph = self._session.graph
        version = (IdentityKey(graph), self._session.schemas.count, IdentityKey(tree))
        known = self._cached.get_or_make(needs, version, lambda: list(self._documents(graph, tree, needs)))
        changing = (LiveDocument(one.url, one) for one in self._changing if needs.may_match(one.url, _ANYTHING))
        found = [*known, *changing, *self._recorded_messages(needs)]
        if rated := list(self._rates(needs)):
            read = {one.url for one in found}
            found += [one for one in rated if one.url not in read]
        return found if permissions.may_read_all else [one for one in found if permissions.may_read(one.url)]

    def _documents(self, graph: Graph, tree: ResourceTree | None, needs: Needs) -> Iterator[LiveDocument]:
        yield from self._topics(graph, needs)
        by_term = replace(needs, patterns=frozenset(one for one in needs.patterns if one.predicates is not None))
        others = chain(self._parameters(graph), self._listings(graph), self._bodies(graph), self._below(tree))
        for url, terms, make, by_name, own in others:
            if needs.may_match(url, terms):
                is_named = url in needs.documents
                yield LiveDocument(
                    url, make(), is_named or by_term.may_match(url, own or terms), is_named or not by_name
                )
        plans = () if tree is None else map(tree.complex, tree.paths)
        for plan in plans:
            if plan is not None and not plan.is_conditional:
                yield from self._with_members(plan, needs, by_term)

    def _with_members(self, plan: ComplexPlan, needs: Needs, by_term: Needs) -> Iterator[LiveDocument]:
        """Yield an unconditional complex resource, with the values of the members that the needs can match."""
        space = self._session.space
        url = url_of(plan.path, space)
        is_named = url in needs.documents
        matched = [(one, terms) for one in plan.members if needs.may_match(url, terms := _terms_of_member(one, space))]
        names = [one.source.name for one, _ in matched if is_named or not _is_bulky(one.source)]
        if matched:
            is_named |= any(by_term.may_match(url, terms) for _, terms in matched)
            yield LiveDocument(url, ComplexResource(self._services, plan.path), is_named, members=frozenset(names))

    def _topics(self, graph: Graph, needs: Needs) -> Iterator[LiveDocument]:
        space = self._session.space
        by_type = replace(needs, patterns=frozenset(one for one in needs.patterns if _names_type(one, space.types)))
        asks = needs.may_match_below(space.container("topics"), _OBSERVATIONS)
        for topic in _named_topics(space, graph, needs):
            url, (terms, bulky) = space.topic(topic.name), self._terms_of_topic(topic)
            observed = asks and needs.may_match(url, _OBSERVATIONS) and self._is_observed(topic, graph)
            if observed or needs.may_match(url, terms):
                is_named = url in needs.documents or by_type.may_match(url, terms)
                subscribes = is_named or not bulky
                found = TopicResource(self._services, topic.name)
                yield LiveDocument(url, found, is_named, subscribes, observed=observed)

    def _is_observed(self, topic: Topic, graph: Graph) -> bool:
        return role_of(topic, graph, self._session.schemas.find_message(topic.type)) is not None

    def _parameters(self, graph: Graph) -> Iterator[_Candidate]:
        space, services = self._session.space, self._services
        for name in graph.parameters:
            yield _Candidate(space.parameter(name), _PARAMETER, partial(ParameterResource, services, name))
        for path in namespaces(graph, "parameters"):
            yield _Candidate(space.container("parameters", path), _PARAMETER, partial(ParameterTree, services, path))

    def _listings(self, graph: Graph) -> Iterator[_Candidate]:
        for path in namespaces(graph, "topics"):
            url = self._session.space.container("topics", path)
            yield _Candidate(url, _BRIEF, partial(NamespaceContainer, self._services, "topics", path))

    def _bodies(self, graph: Graph) -> Iterator[_Candidate]:
        if describe_body.body_sources(graph):
            url = describe_body.body_url(self._session.space)
            yield _Candidate(url, _BODY, partial(BodyResource, self._services), own=_BODY_ALONE)

    def _below(self, tree: ResourceTree | None) -> Iterator[_Candidate]:
        """Yield the resources below `/resources/`, except actions that are always offered."""
        space, services = self._session.space, self._services
        if tree is None:
            return
        for path in tree.paths:
            plan = tree.complex(path)
            if plan is not None and plan.is_conditional:
                by_name = any(map(_is_bulky, plan.reads))
                yield _Candidate(url_of(path, space), _ANYTHING, partial(ComplexResource, services, path), by_name)
        for name in (*tree.properties, *tree.actions):
            found, action = tree.property(name), tree.action(name)
            if found is not None:
                terms = _ANYTHING if found.is_conditional else _terms_of_member(found.member, space)
            elif action is not None and (action.exists_when or action.conditions):
                terms = _ANYTHING
            else:
                continue
            bulky = found is not None and any(map(_is_bulky, found.reads))
            yield _Candidate(url_of(name, space), terms, partial(MemberResource, services, name), bulky)

    def _terms_of_topic(self, topic: Topic) -> tuple[StatedTerms, bool]:
        """Return the terms of a topic's values, and whether its messages are pictures, point clouds or the like."""
        schemas, space = self._session.schemas, self._session.space
        found: list[StatedTerms] = [StatedTerms(_TOPIC | _MESSAGE, _CLASSES)]
        bulky = False
        for ref in topic.types:
            schema = schemas.find_similar(ref)
            if not isinstance(schema, MessageSchema):
                return _ANYTHING, False
            bulky |= is_bulky(schema)
            found.append(_terms_of_messages(schema, space))
        return reduce(StatedTerms.__or__, found), bulky

    def _rates(self, needs: Needs) -> Iterator[LiveDocument]:
        """Yield the subscribed topics whose rates a query can match: a rate is no reason to subscribe."""
        if not any(one.predicates is not None and ros.rate.value in one.predicates for one in needs.patterns):
            return
        for name in self._session.topics.subscribed():
            if needs.may_match(url := self._session.space.topic(name), _RATE):
                yield LiveDocument(url, TopicResource(self._services, name), is_named=True, subscribes=False)

    def _recorded_messages(self, needs: Needs) -> Iterator[LiveDocument]:
        """Yield the recorded messages that a query names: all others are selected by `ros:past`."""
        for url in needs.documents:
            match self._session.space.location(url):
                case Location("bags", (bag, "messages", index), False) if index.isdecimal():
                    recording = self._services.recordings.readable.get(bag)
                    if recording is not None and recording.first <= int(index) < recording.first + recording.count:
                        yield LiveDocument(url, BagMessage(self._services, recording, int(index)), is_named=True)

    # --- reading

    async def read(self, documents: Sequence[LiveDocument], *, deadline: float) -> LiveGraphs:
        """Return documents with their current values, waiting until `deadline` (loop time) at most for first values.

        A document that does not exist now has no entry; unreadable ones are returned with the reason.
        """
        if any(one.observed for one in documents):
            self._observed_until = loop_time() + _OBSERVED_SECONDS
        topics = [one for one in documents if isinstance(one.resource, TopicResource)]
        listings = [one for one in documents if one.subscribes and isinstance(one.resource, NamespaceContainer)]
        due = [one for one in documents if one.subscribes and not isinstance(one.resource, _READ_AT_ONCE)]
        parameters = [one for one in due if isinstance(one.resource, ParameterResource | ParameterTree)]
        others = [one for one in due if not isinstance(one.resource, ParameterResource | ParameterTree)]
        found = LiveGraphs({one.url: None for one in documents if not one.subscribes}, {})
        await self._read_others(topics, others, deadline, found)
        await self._read_parameters(parameters, deadline, found)
        await self._read_at_once([*topics, *listings], found)
        return found

    async def _read_others(
        self, topics: Sequence[LiveDocument], others: Sequence[LiveDocument], deadline: float, found: LiveGraphs
    ) -> None:
        """Read `others` after waiting for the first values of topics, which they need."""
        live, budget = self._session.topics, self._session.settings.subscription_budget
        wanted = [one for one in topics if one.subscribes]
        new = [one for one in wanted if not live.is_settled(_name(one))]
        if len(wanted) > budget:
            words = f"{len(wanted)} topics must be subscribed to, and the setting subscription_budget is {budget}"
            found.unread.update((one.url, words) for one in wanted)
            new = []
        await self._wait_for([(one, self._first(one, found)) for one in new], deadline, found)
        await self._wait_for([(one, self._entry(one, found)) for one in others], deadline, found)

    async def _wait_for(
        self, reads: Sequence[tuple[LiveDocument, Coroutine[object, object, None]]], deadline: float, found: LiveGraphs
    ) -> None:
        tasks: dict[asyncio.Task[None], LiveDocument] = {}
        try:
            for one, coming in reads:
                tasks[asyncio.ensure_future(coming)] = one
                if len(tasks) % _AT_ONCE == 0:
                    await asyncio.sleep(0)
            if tasks:
                await asyncio.wait(tasks, timeout=max(0.0, deadline - loop_time()))
        finally:
            for task, one in tasks.items():
                if not task.done():
                    task.cancel()
                    found.unread[one.url] = "the query ran out of time"

    async def _first(self, one: LiveDocument, found: LiveGraphs) -> None:
        try:
            await self._session.topics.read(_name(one))
        except (Problem, RosError) as error:
            found.unread[one.url] = str(error)

    async def _entry(self, one: LiveDocument, found: LiveGraphs) -> None:
        try:
            if one.members is not None and isinstance(one.resource, ComplexResource):
                state = await one.resource.state_with(one.members)
            else:
                state = await one.resource.state()
        except Problem as problem:
            if problem.status >= 500:
                found.unread[one.url] = problem.detail
            else:  # it does not exist now
                found.entries[one.url] = None
        except RosError as error:
            found.unread[one.url] = str(error)
        else:
            found.entries[one.url] = _entry_of(one.url, state)

    async def _read_parameters(self, documents: Sequence[LiveDocument], deadline: float, found: LiveGraphs) -> None:
        """Read parameters and trees of parameters in one request."""
        if not documents:
            return
        session = self._session
        until = min(deadline, loop_time() + session.settings.call_deadline)
        try:
            values = await session.adapter.get_parameters(list(map(_name, documents)), deadline=until)
        except RosError as error:
            found.unread.update((one.url, str(error)) for one in documents)
            return
        for one in documents:
            if (entry := _of_parameter(one.resource, values.get(_name(one)))) is not None:
                found.entries[one.url] = entry

    async def _read_at_once(self, documents: Sequence[LiveDocument], found: LiveGraphs) -> None:
        """Read topics and their listings in one iteration of the loop, in which no message arrives: both have rates.

        If something must be fetched first (the type of a message), all of them are read again.
        """
        known = self._session.topics.current_view
        for _ in range(_TURNS):
            turns: list[None] = []
            asyncio.get_running_loop().call_soon(turns.append, None)
            for one in documents:
                resource = one.resource
                try:
                    if isinstance(resource, TopicResource):
                        state = await resource.state_of(known(resource.name))
                    else:
                        state = await resource.state()
                    observed = isinstance(resource, TopicResource) and loop_time() < self._observed_until
                    found.entries[one.url] = _entry_of(one.url, state, observed)
                except (Problem, RosError):  # it no longer exists
                    found.entries.pop(one.url, None)
            if turns:
                continue
            return


def _name(one: LiveDocument) -> str:
    assert isinstance(one.resource, TopicResource | ParameterResource | ParameterTree)
    return one.resource.name


def _names_type(pattern: Constants, types: str) -> bool:
    """Whether a pattern names a document, a message type or one of its fields."""
    named = (*(pattern.predicates or ()), pattern.type or "")
    return pattern.graph is not None or pattern.document is not None or any(each.startswith(types) for each in named)


def _named_topics(space: Space, graph: Graph, needs: Needs) -> Iterable[Topic]:
    """Return the topics that the patterns name, or all if a pattern names none."""
    named = needs.dataset or {pattern.graph or pattern.document for pattern in needs.patterns}
    if None in named:
        return graph.topics.values()
    places = (space.location(url) for url in named if url is not None)
    names = (place.name for place in places if place is not None and place.kind == "topics")
    return [graph.topics[name] for name in names if name in graph.topics]


@lru_cache(maxsize=4096)
def _terms_of_messages(schema: MessageSchema, space: Space) -> StatedTerms:
    """Return the fields and classes of a message and of all nested ones."""
    kinds, is_placed = schema.types.values(), geometry.has_place(schema)
    fields = {space.property_of(kind.name, field.name) for kind in kinds for field in kind.fields}
    has_lists = any(
        isinstance(field.type, Array) and isinstance(field.type.element, Nested)
        for kind in kinds
        for field in kind.fields
    )
    return StatedTerms(
        frozenset(fields)
        | _MESSAGE
        | (_LISTS if has_lists else frozenset())
        | (geometry.TERMS if is_placed else set()),
        _CLASSES | {space.class_of(kind.name) for kind in kinds} | (geometry.CLASSES if is_placed else set()),
    )


def _terms_of_property(own: Property, space: Space) -> StatedTerms:
    if any(isinstance(reader, TopicSource) and reader.schema is None for reader in own.readers):
        return _ANYTHING
    terms = StatedTerms(_PROPERTY, frozenset())
    return terms | _terms_of_messages(own.shape.schema, space) if isinstance(own.shape, MessageShape) else terms


def _is_bulky(own: Property) -> bool:
    sources = (reader for reader in own.readers if isinstance(reader, TopicSource))
    return any(source.schema is not None and is_bulky(source.schema) for source in sources)


def _terms_of_member(member: MemberPlan, space: Space) -> StatedTerms:
    terms = _terms_of_property(member.source, space)
    relation = member.mapped.predicate.value if member.mapped is not None else None
    return terms if relation is None else terms | StatedTerms(frozenset({relation}), frozenset())


def _of_parameter(resource: Resource, value: ParameterValue | None) -> GraphEntry | None:
    """Return the graph of a parameter or a tree, None without a value that can be represented."""
    assert isinstance(resource, ParameterResource | ParameterTree)
    if value is None or isinstance(value, dict) == isinstance(resource, ParameterResource):
        return None
    try:
        return _entry_of(resource.url, resource.state_of(value))
    except Problem:
        return None


def _entry_of(iri: str, state: State, observed: bool = False) -> GraphEntry:
    return GraphEntry(iri, state.tag, lambda: document_ntriples(state.document, observed=observed), observed)
