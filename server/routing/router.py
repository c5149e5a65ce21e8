"""Router from paths to resources, with one line for each URL template."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import TypeAlias, TypeVar

from starlette.types import Scope

from rosld.ontology.urls import Location, Space, locate
from rosld.server.html.page import StoredQueryLink
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.brief_value import LatestValues
from rosld.server.hypermedia.resource_tree import path_of
from rosld.server.openapi.asyncapi import AsyncApiResource
from rosld.server.openapi.openapi_resource import OpenApiResource
from rosld.server.policies.stored_queries import StoredQueries
from rosld.server.resources.actions import ActionResource, GoalResource
from rosld.server.resources.bag_routes import bag_route
from rosld.server.resources.bags import Bags
from rosld.server.resources.body import BodyResource
from rosld.server.resources.cockpit_panels import CockpitSources, QueryTables
from rosld.server.resources.cockpits import cockpit_route
from rosld.server.resources.complex_resource import ComplexResource
from rosld.server.resources.datasets import DatasetResource
from rosld.server.resources.diagnostics import DiagnosticsResource
from rosld.server.resources.documentation import documentation_route
from rosld.server.resources.entry_point import FILES, EntryResource, GuideResource
from rosld.server.resources.faults import FaultResource, faults_listing
from rosld.server.resources.find import Finder, FindResource
from rosld.server.resources.graph import GraphResource
from rosld.server.resources.graph_store import GraphStore
from rosld.server.resources.holds import HoldResource
from rosld.server.resources.ldp.routes import stored_route
from rosld.server.resources.limit_checks import LimitChecks
from rosld.server.resources.listings import (
    ActivityContainer,
    ActivityResource,
    ListingResource,
    calls_listing,
    goals_listing,
    holds_listing,
)
from rosld.server.resources.namespaces import NamespaceContainer
from rosld.server.resources.nodes import NodeResource
from rosld.server.resources.parameters import ParameterResource, ParameterTree
from rosld.server.resources.property_action import MemberResource
from rosld.server.resources.queries import QueryRunner, query_route
from rosld.server.resources.services import CallResource, ServiceResource
from rosld.server.resources.sparql_endpoint import SparqlResource
from rosld.server.resources.stop import StopResource
from rosld.server.resources.things import RobotThing, ThingDescriptions
from rosld.server.resources.topics import TopicResource
from rosld.server.resources.types import ontology_route, shape_route, type_route
from rosld.server.rest.pages import PageRenderer
from rosld.server.rest.resource import Find, Resource, permanent_redirect
from rosld.server.rest.state import State
from rosld.server.robot.diagnostic_states import LevelTimes
from rosld.server.robot.session import Session
from rosld.server.routing.services import Services
from rosld.server.runtime.version_cache import VersionCache
from rosld.server.sparql.query_service import QueryService
from rosld.server.sparql.update.base import UpdateRunner

R = TypeVar("R")


class ResourceFactory:
    """Factory of the resources of one robot that several callers need."""

    find: Find
    """Finds the resource at a path below the base; set by the router."""

    def __init__(self, services: Services) -> None:
        self.services = services
        self.session = services.session
        self.states = services.states
        self.affordances = services.affordances
        self.history = services.recordings.history
        session = self.session
        self.limit_checks = LimitChecks(session, services.affordances, services.active_limits)
        self.things = ThingDescriptions(session, services.affordances, services.software_stop, services.instance_id)
        self.bags = Bags(session, self.states, services.recordings, services.pictures)
        self.latest_values = LatestValues(session.topics, session.schemas)

    def named(self, kind: Callable[[Session, LimitChecks, VersionCache[State], str], R], name: str) -> R:
        """Return a node, a service, an action or a parameter."""
        return kind(self.session, self.limit_checks, self.states, name)

    def topic(self, name: str) -> TopicResource:
        services = self.services
        return TopicResource(
            self.session,
            self.limit_checks,
            self.states,
            self.history,
            services.holds,
            services.pictures,
            name,
            self.find,
        )

    def parameter_tree(self, path: tuple[str, ...]) -> ParameterTree:
        return ParameterTree(self.session, self.limit_checks, self.states, path)

    def namespace(self, kind: str, path: tuple[str, ...]) -> NamespaceContainer:
        return NamespaceContainer(self.session, self.states, self.latest_values, kind, path)

    def body(self) -> BodyResource:
        return BodyResource(self.session, self.states)

    def dataset(self) -> DatasetResource:
        return DatasetResource(self.session, self.states, self.services.recordings)

    def graph(self) -> GraphResource:
        return GraphResource(self.session, self.services.instance_id)

    def call(self, id: str) -> CallResource:
        return CallResource(self.session, self.states, id)

    def goal(self, id: str) -> GoalResource:
        return GoalResource(self.session, self.states, id)

    def hold(self, id: str) -> HoldResource:
        return HoldResource(self.session, self.limit_checks, self.states, self.services.holds, id, self.find)

    def calls(self) -> ListingResource:
        return calls_listing(self.session.space, self.session.calls, self.states)

    def goals(self) -> ListingResource:
        return goals_listing(self.session.space, self.session.goals, self.states)

    def holds(self) -> ListingResource:
        return holds_listing(self.session.space, self.states, self.services.holds)

    def fault(self, id: str) -> FaultResource:
        return FaultResource(self.session, self.states, self.services.faults, self.history, id)

    def faults(self) -> ListingResource:
        return faults_listing(self.session.space, self.services.faults, self.states)

    def stop(self) -> StopResource:
        return StopResource(self.session.space, self.states, self.services.software_stop)

    def complex(self, path: str) -> ComplexResource:
        return ComplexResource(
            self.session, self.affordances, self.limit_checks, self.things, self.states, self.history, path
        )

    def member(self, name: str) -> MemberResource:
        return MemberResource(
            self.session, self.affordances, self.limit_checks, self.things, self.states, self.history, name
        )


def _member(factory: ResourceFactory, name: str) -> MemberResource:
    """Return the member of a complex resource at a URL. Raises a 404 Problem for a name that ends with a slash."""
    if name.endswith("/"):
        raise Problem(404, f"{name} is not a resource name: its last segment is empty.")
    return factory.member(name)


Route: TypeAlias = Callable[[Location], Resource]
_MAX_CACHED = 8192
_EXAMPLES = 100
"""Stored queries that the page of the endpoint lists."""


def _nested(space: Space, container: Callable[[tuple[str, ...]], Resource], leaf: Callable[[str], Resource]) -> Route:
    """Return a route of resources whose names have parts, and of the containers of these."""

    def route(location: Location) -> Resource:
        if location.is_container:
            return container(location.segments)
        if not location.segments:
            raise permanent_redirect(space.container(location.kind))
        return leaf(location.name)

    return route


def _flat(space: Space, what: str, container: Callable[[], Resource], leaf: Callable[[str], Resource]) -> Route:
    """Return a route of resources without namespaces; `what` is their singular with its article."""

    def route(location: Location) -> Resource:
        if location.is_container and not location.segments:
            return container()
        if not location.segments:
            raise permanent_redirect(space.container(location.kind))
        if len(location.segments) > 1 or location.is_container:
            raise Problem(404, f"{what} lies directly under /{location.kind}/.")
        return leaf(location.segments[0])

    return route


def single_route(make: Callable[[], Resource]) -> Route:
    """Return a route to one resource, which raises a 404 Problem for every path below it."""

    def route(location: Location) -> Resource:
        if location.segments or (location.is_container and location.kind):
            raise Problem(404, f"There is nothing below /{location.kind}.")
        return make()

    return route


def _parameter_route(route: Route, location: Location) -> Resource:
    """Return what a route of parameters leads to. Raises a 404 Problem for a name with an empty part."""
    name = location.name
    if "" in location.segments:
        raise Problem(404, f"{name} is not a parameter name: it has an empty segment.")
    return route(location)


def _well_known_route(factory: ResourceFactory, location: Location) -> Resource:
    """The descriptions at `/.well-known/wot` and `/.well-known/void`; 404 at other locations below `/.well-known/`."""
    space = factory.session.space
    if location.segments == ("void",) and not location.is_container:
        return factory.dataset()
    if location.segments != ("wot",) or location.is_container:
        raise Problem(404, f"There is no such well-known resource: see {space.base}.well-known/.")
    return RobotThing(space, factory.affordances, factory.things)


def _examples(queries: StoredQueries) -> list[StoredQueryLink]:
    """Return example queries: all that come with rosld, and some of the stored ones."""
    found = queries.all(limit=_EXAMPLES)
    return [StoredQueryLink(url, query.name, query.purpose, query.text) for url, query in found]


class Router:
    """Resolver of paths; the last few thousand resources are cached, because they have no state of their own."""

    def __init__(
        self,
        factory: ResourceFactory,
        service: QueryService,
        pages: PageRenderer,
        updates: Callable[[Callable[[str], Resource]], UpdateRunner],
    ) -> None:
        """Initialize; `updates` returns the update runner, given a function that finds resources by path (`at`)."""
        factory.find = self.at
        services, session, states = factory.services, factory.session, factory.states
        affordances, settings, history = factory.affordances, session.settings, factory.history
        documents, queries, recordings = services.documents, services.queries, services.recordings
        space = self._space = session.space
        self.updates = changes = None if settings.read_only else updates(self.at)
        finder = Finder(session, affordances, documents, queries, services.faults)
        self.search = FindResource(session, affordances, factory.latest_values, services.property_reader, finder)
        self.graphs = GraphStore(space, settings, states, service, self.resolve, changes)
        examples = partial(_examples, queries)
        self.endpoint = SparqlResource(space, settings, states, service, pages, examples, changes)
        described = OpenApiResource(
            session,
            affordances,
            documents.workers,
            queries,
            services.mappings,
            recordings,
            services.instance_id,
            self.at,
        )
        channels = AsyncApiResource(described)
        cockpits = CockpitSources(
            session,
            affordances,
            documents,
            queries,
            history,
            services.faults,
            services.software_stop,
            service,
            self.at,
            QueryTables(),
        )
        runner, level_times, receipts = QueryRunner(service, pages, space.base), LevelTimes(), services.receipts
        stored = partial(stored_route, documents)
        parameters = _nested(space, factory.parameter_tree, partial(factory.named, ParameterResource))
        self.routes: dict[str, Route] = {
            "": single_route(lambda: EntryResource(session, states, recordings, services.problems)),
            "nodes": _nested(space, partial(factory.namespace, "nodes"), partial(factory.named, NodeResource)),
            "topics": _nested(space, partial(factory.namespace, "topics"), factory.topic),
            "services": _nested(space, partial(factory.namespace, "services"), partial(factory.named, ServiceResource)),
            "calls": _flat(space, "A call", factory.calls, factory.call),
            "actions": _nested(space, partial(factory.namespace, "actions"), partial(factory.named, ActionResource)),
            "goals": _flat(space, "A goal", factory.goals, factory.goal),
            "activity": _flat(
                space,
                "A receipt",
                lambda: ActivityContainer(space, states, receipts),
                lambda id: ActivityResource(space, settings, states, receipts, id),
            ),
            "holds": _flat(space, "A hold", factory.holds, factory.hold),
            "faults": _flat(space, "A fault", factory.faults, factory.fault),
            "parameters": partial(_parameter_route, parameters),
            "types": partial(type_route, session, states),
            "shapes": partial(shape_route, factory.limit_checks, documents),
            "bags": partial(bag_route, factory.bags),
            "resources": _nested(space, lambda path: factory.complex(path_of(path)), partial(_member, factory)),
            "data": stored,
            "mappings": stored,
            ".well-known": partial(_well_known_route, factory),
            "stop": single_route(factory.stop),
            "graph": single_route(factory.graph),
            "body": single_route(factory.body),
            "diagnostics": single_route(lambda: DiagnosticsResource(session, history, level_times)),
            "llms.txt": single_route(lambda: GuideResource(space, session.name, read_only=settings.read_only)),
            "ontology": partial(ontology_route, space, states),
            "docs": partial(documentation_route, space, pages),
            "sparql": single_route(lambda: self.endpoint),
            "queries": partial(query_route, documents, queries, runner),
            "cockpit": partial(cockpit_route, cockpits),
            "openapi.json": single_route(lambda: described),
            "asyncapi.json": single_route(lambda: channels),
            "find": single_route(lambda: self.search),
            "graphs": single_route(lambda: self.graphs),
            **{name: single_route(partial(make, space)) for name, make in FILES.items()},
        }
        self._base = space.path.rstrip("/")
        self._cache: dict[str, Resource] = {}

    def add(self, routes: Mapping[str, Route]) -> None:
        """Add routes, replacing those of the same names."""
        self.routes |= routes

    @property
    def route_names(self) -> frozenset[str]:
        """First segments of all valid paths; that of the entry point is empty."""
        return frozenset(self.routes)

    def resolve(self, scope: Scope) -> Resource:
        """Return the resource at the path of a request.

        Raises Problem 400 for malformed paths, 404 for unknown ones, and 308 for a read with another spelling of the
        resource's URL (`a:b` for `a%3Ab`), so that each resource has one URL. Writes are accepted with any spelling.
        """
        try:
            path = scope["raw_path"].decode("ascii").removeprefix(self._base)
            resource = self._cache.get(path) or self.at(path)
        except UnicodeDecodeError as error:
            raise Problem(400, "The path is not ASCII: percent-encode it.") from error
        except ValueError as error:
            raise Problem(400, f"{error}.") from error
        if path not in self._cache and scope["method"] in ("GET", "HEAD") and not self._is_spelt(resource, path):
            query = scope["query_string"].decode("latin-1")
            raise permanent_redirect(f"{resource.url}?{query}" if query else resource.url)
        return resource

    def _is_spelt(self, resource: Resource, path: str) -> bool:
        """Whether a path is spelled as in the URL of the resource."""
        return resource.url.partition("?")[0][len(self._space.base) - 1 :] == path

    def at(self, path: str) -> Resource:
        """Return the resource at a path below the base. Raises Problems (404, 308), ValueError if it is malformed."""
        resource = self._cache.get(path)
        if resource is not None:
            return resource
        location = locate(path)
        route = self.routes.get(location.kind)
        if route is None:
            raise Problem(404, f"There is nothing at {path}; begin at {self._space.base}")
        resource = route(location)
        if resource.is_cacheable and self._is_spelt(resource, path):
            if len(self._cache) >= _MAX_CACHED:
                self._cache.pop(next(iter(self._cache)))
            self._cache[path] = resource
        return resource
