"""Router from paths to resources, with one line for each URL template."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from typing import TypeAlias

from starlette.types import Scope

from rosld.ontology.urls import Location, Space, locate
from rosld.server.http.problem import Problem
from rosld.server.resources.queries import QueryRunner
from rosld.server.resources.static_assets import FILES
from rosld.server.rest.pages import PageRenderer
from rosld.server.rest.resource import Resource, permanent_redirect
from rosld.server.routing.resource_factory import ResourceFactory
from rosld.server.sparql.query_service import QueryService
from rosld.server.sparql.update.base import UpdateRunner

Route: TypeAlias = Callable[[Location], Resource]
_MAX_CACHED = 8192
_SHORT = 256
"""Maximum number of characters of a path whose location is cached."""
_located = lru_cache(_MAX_CACHED)(locate)


def _named_route(factory: ResourceFactory, kind: str, leaf: Callable[[str], Resource]) -> Route:
    """Return a route of resources with ROS names: leaves, and the containers of their namespaces."""

    def route(location: Location) -> Resource:
        if location.is_container:
            return factory.namespace(kind, location.segments)
        if not location.segments:
            raise permanent_redirect(factory.session.space.container(kind))
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


def robot_routes(factory: ResourceFactory) -> Mapping[str, Route]:
    """Return the routes of the robot and related resources by the first segments of their paths."""
    space = factory.session.space
    return {
        "": single_route(factory.entry),
        "nodes": _named_route(factory, "nodes", factory.node),
        "topics": _named_route(factory, "topics", factory.topic),
        "services": _named_route(factory, "services", factory.service),
        "calls": _flat(space, "A call", factory.calls, factory.call),
        "actions": _named_route(factory, "actions", factory.action),
        "goals": _flat(space, "A goal", factory.goals, factory.goal),
        "activity": _flat(space, "A receipt", factory.activities, factory.activity),
        "holds": _flat(space, "A hold", factory.holds, factory.hold),
        "parameters": factory.parameter_at,
        "types": factory.type_at,
        "shapes": factory.shape_at,
        "bags": factory.bag_at,
        "resources": factory.resource_at,
        "data": factory.document_at,
        "mappings": factory.document_at,
        ".well-known": factory.robot_thing,
        "stop": single_route(factory.stop),
        "graph": single_route(factory.graph),
        "diagnostics": single_route(factory.diagnostics),
        "llms.txt": single_route(factory.guide),
        "ontology": factory.ontology_at,
    } | {name: single_route(partial(make, space)) for name, make in FILES.items()}


def _finding(factory: ResourceFactory, at: Callable[[str], Resource]) -> Mapping[str, Route]:
    """Return the routes whose requests may contain the URL of a message, with the function that finds it."""
    return {
        "topics": _named_route(factory, "topics", partial(factory.topic, find=at)),
        "holds": _flat(factory.session.space, "A hold", factory.holds, partial(factory.hold, find=at)),
    }


class Router:
    """Resolver of paths; the last few thousand resources are cached, because they have no state of their own."""

    def __init__(
        self,
        factory: ResourceFactory,
        routes: Mapping[str, Route],
        service: QueryService,
        pages: PageRenderer,
        updates: Callable[[Callable[[str], Resource]], UpdateRunner] | None = None,
    ) -> None:
        """Initialize; `updates` returns the update runner, given a function that finds resources by path (`at`)."""
        self._space = factory.session.space
        described = factory.openapi(self.at)
        self.search = factory.search()
        changes = None if updates is None or factory.session.settings.read_only else updates(self.at)
        self.graphs = factory.graph_store(service, self.resolve, changes)
        self.endpoint = factory.sparql_endpoint(service, pages, changes)
        runner = QueryRunner(service, pages, self._space.base)
        self._routes: dict[str, Route] = {
            **routes,
            **_finding(factory, self.at),
            "sparql": single_route(lambda: self.endpoint),
            "queries": partial(factory.query_at, runner=runner),
            "cockpit": partial(factory.cockpit_at, service=service, find=self.at),
            "openapi.json": single_route(lambda: described),
            "find": single_route(lambda: self.search),
            "graphs": single_route(lambda: self.graphs),
        }
        self._base = self._space.path.rstrip("/")
        self._kept: dict[bytes, Resource] = {}

    def add(self, routes: Mapping[str, Route]) -> None:
        """Add routes, replacing those of the same names."""
        self._routes.update(routes)

    @property
    def route_names(self) -> frozenset[str]:
        """First segments of all valid paths; that of the entry point is empty."""
        return frozenset(self._routes)

    def resolve(self, scope: Scope) -> Resource:
        """Return the resource at the path of a request. Raises Problem 400 for malformed paths, 404, and 308.

        A read with another spelling of the resource's URL (`a:b` for `a%3Ab`) is redirected (308), so that each
        resource has one URL. Writes are accepted with any spelling.
        """
        raw: bytes = scope["raw_path"]
        resource = self._kept.get(raw)
        if resource is None:
            resource = self._find(raw)
            is_spelt = self._is_spelt(resource, raw)
            if not is_spelt and scope["method"] in ("GET", "HEAD"):
                query = scope["query_string"].decode("latin-1")
                raise permanent_redirect(f"{resource.url}?{query}" if query else resource.url)
            if not resource.is_cacheable or not is_spelt:
                return resource
            if len(self._kept) >= _MAX_CACHED:
                self._kept.pop(next(iter(self._kept)))
            self._kept[raw] = resource
        return resource

    def _is_spelt(self, resource: Resource, raw: bytes) -> bool:
        """Whether a path is spelled as in the URL of the resource."""
        own = resource.url.partition("?")[0]
        return own[len(self._space.base) - 1 :] == raw.decode("ascii").removeprefix(self._base)

    def _find(self, raw: bytes) -> Resource:
        try:
            return self.at(raw.decode("ascii").removeprefix(self._base))
        except UnicodeDecodeError as error:
            raise Problem(400, "The path is not ASCII: percent-encode it.") from error
        except ValueError as error:
            raise Problem(400, f"{error}.") from error

    def at(self, path: str) -> Resource:
        """Return the resource at a path below the base. Raises Problems (404, 308), ValueError if it is malformed."""
        location = _located(path) if len(path) <= _SHORT else locate(path)
        route = self._routes.get(location.kind)
        if route is None:
            raise Problem(404, f"There is nothing at {path}; begin at {self._space.base}")
        return route(location)
