"""Router from paths to resources, with one line for each URL template."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import TypeAlias

from starlette.types import Scope

from rosld.ontology.urls import Location, Space, locate
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.resource_tree import path_of
from rosld.server.openapi.asyncapi import AsyncApiResource
from rosld.server.openapi.openapi_resource import OpenApiResource
from rosld.server.resources.actions import ActionResource, GoalResource
from rosld.server.resources.bag_routes import bag_route
from rosld.server.resources.base import Services
from rosld.server.resources.body import BodyResource
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
from rosld.server.resources.listings import (
    ActivityContainer,
    ActivityResource,
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
from rosld.server.resources.things import RobotThing
from rosld.server.resources.topics import TopicResource
from rosld.server.resources.types import ontology_route, shape_route, type_route
from rosld.server.rest.pages import PageRenderer
from rosld.server.rest.resource import Resource, permanent_redirect
from rosld.server.sparql.update.base import UpdateRunner


def _member(services: Services, name: str) -> MemberResource:
    """Return the member of a complex resource at a URL. Raises a 404 Problem for a name that ends with a slash."""
    if name.endswith("/"):
        raise Problem(404, f"{name} is not a resource name: its last segment is empty.")
    return MemberResource(services, name)


Route: TypeAlias = Callable[[Location], Resource]
_MAX_CACHED = 8192


def _nested(space: Space, container: Callable[[tuple[str, ...]], Resource], leaf: Callable[[str], Resource]) -> Route:
    """Return a route of resources whose names have parts, and of the containers of these."""

    def route(location: Location) -> Resource:
        if location.is_container:
            return container(location.segments)
        if not location.segments:
            raise permanent_redirect(space.container(location.kind))
        return leaf(location.name)

    return route


def _flat(
    services: Services,
    what: str,
    container: Callable[[Services], Resource],
    leaf: Callable[[Services, str], Resource],
) -> Route:
    """Return a route of resources without namespaces; `what` is their singular with its article."""

    def route(location: Location) -> Resource:
        if location.is_container and not location.segments:
            return container(services)
        if not location.segments:
            raise permanent_redirect(services.space.container(location.kind))
        if len(location.segments) > 1 or location.is_container:
            raise Problem(404, f"{what} lies directly under /{location.kind}/.")
        return leaf(services, location.segments[0])

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


def _well_known_route(services: Services, location: Location) -> Resource:
    """The descriptions at `/.well-known/wot` and `/.well-known/void`; 404 at other locations below `/.well-known/`."""
    if location.segments == ("void",) and not location.is_container:
        return DatasetResource(services)
    if location.segments != ("wot",) or location.is_container:
        raise Problem(404, f"There is no such well-known resource: see {services.space.base}.well-known/.")
    return RobotThing(services.space, services.things)


class Router:
    """Resolver of paths; the last few thousand resources are cached, because they have no state of their own."""

    def __init__(self, services: Services, pages: PageRenderer, updates: Callable[[], UpdateRunner]) -> None:
        """Initialize; `updates` returns the update runner, once resources can be found."""
        services.find = self.at
        space = self._space = services.space
        self.updates = changes = None if services.settings.read_only else updates()
        self.search = FindResource(services, Finder(services))
        self.graphs = GraphStore(services, self.resolve, changes)
        self.endpoint = SparqlResource(services, pages, changes)
        described = OpenApiResource(services)
        channels = AsyncApiResource(described)
        stored = partial(stored_route, services.documents)

        def nested(name: str, leaf: Callable[[str], Resource]) -> Route:
            """Return a route of names of the computation graph."""
            return _nested(space, partial(NamespaceContainer, services, name), leaf)

        def single(make: Callable[[Services], Resource]) -> Route:
            return single_route(partial(make, services))

        parameters = _nested(space, partial(ParameterTree, services), partial(ParameterResource, services))
        self.routes: dict[str, Route] = {
            "": single(EntryResource),
            "nodes": nested("nodes", partial(NodeResource, services)),
            "topics": nested("topics", partial(TopicResource, services)),
            "services": nested("services", partial(ServiceResource, services)),
            "actions": nested("actions", partial(ActionResource, services)),
            "calls": _flat(services, "A call", calls_listing, CallResource),
            "goals": _flat(services, "A goal", goals_listing, GoalResource),
            "activity": _flat(services, "A receipt", ActivityContainer, ActivityResource),
            "holds": _flat(services, "A hold", holds_listing, HoldResource),
            "faults": _flat(services, "A fault", faults_listing, FaultResource),
            "parameters": partial(_parameter_route, parameters),
            "types": partial(type_route, services),
            "shapes": partial(shape_route, services),
            "bags": partial(bag_route, services),
            "resources": _nested(
                space, lambda path: ComplexResource(services, path_of(path)), partial(_member, services)
            ),
            "data": stored,
            "mappings": stored,
            ".well-known": partial(_well_known_route, services),
            "stop": single(StopResource),
            "graph": single(GraphResource),
            "body": single(BodyResource),
            "diagnostics": single(DiagnosticsResource),
            "llms.txt": single_route(
                lambda: GuideResource(space, services.session.name, read_only=services.settings.read_only)
            ),
            "ontology": partial(ontology_route, services),
            "docs": partial(documentation_route, space, pages),
            "sparql": single_route(lambda: self.endpoint),
            "queries": partial(query_route, services, QueryRunner(services.sparql, pages, space.base)),
            "cockpit": partial(cockpit_route, services),
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
