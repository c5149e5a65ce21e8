"""Router: from a path to its resource, one line for each URL template."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from typing import TypeAlias

from starlette.types import Scope

from rosld.ontology.urls import Location, locate
from rosld.server.html import StoredQueryLink
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.resource_tree import path_of
from rosld.server.openapi.openapi_resource import OpenApiResource
from rosld.server.resources import listings
from rosld.server.resources.actions import ActionResource, GoalResource
from rosld.server.resources.activities import ActivityContainer, ActivityResource
from rosld.server.resources.bag_routes import bag_route
from rosld.server.resources.context import Robot
from rosld.server.resources.diagnostics import DiagnosticsResource
from rosld.server.resources.entry_point import EntryResource
from rosld.server.resources.find import FindResource
from rosld.server.resources.finder import Finder
from rosld.server.resources.graph import GraphResource
from rosld.server.resources.graph_store import GraphStore
from rosld.server.resources.guide import GuideResource
from rosld.server.resources.holds import HoldResource
from rosld.server.resources.ldp.routes import stored_route
from rosld.server.resources.namespaces import NamespaceContainer
from rosld.server.resources.nodes import NodeResource
from rosld.server.resources.ontology import ontology_room
from rosld.server.resources.parameters import ParameterResource, ParameterTree
from rosld.server.resources.past_resources import ComplexTimeGate, MemberTimeGate
from rosld.server.resources.queries import QueryRunner, query_route
from rosld.server.resources.services import CallResource, ServiceResource
from rosld.server.resources.sparql_endpoint import SparqlResource
from rosld.server.resources.static_assets import FILES
from rosld.server.resources.stop import StopResource
from rosld.server.resources.things import RobotThing
from rosld.server.resources.topics import TopicResource
from rosld.server.resources.types import shape_route, type_route
from rosld.server.rest.pages import PageRenderer
from rosld.server.rest.resource import Resource, permanent_redirect
from rosld.server.sparql.query_service import QueryService
from rosld.server.sparql.update.base import UpdateRunner

Route: TypeAlias = Callable[[Robot, Location], Resource]
_MAX_CACHED = 8192
_SHORT = 256
"""Characters of a path up to which it is remembered where it leads."""
_located = lru_cache(_MAX_CACHED)(locate)
_EXAMPLES = 100
"""Kept queries that the page of the endpoint lists."""


def _named(kind: str, leaf: Callable[[Robot, str], Resource]) -> Route:
    """A room of things with ROS names: leaves, and the containers of their namespaces."""

    def room(robot: Robot, location: Location) -> Resource:
        if location.is_container:
            return NamespaceContainer(robot, kind, location.segments)
        if not location.segments:
            raise permanent_redirect(robot.space.container(kind))
        return leaf(robot, location.name)

    return room


def _parameters(robot: Robot, location: Location) -> Resource:
    name = location.name
    if "" in location.segments:
        raise Problem(404, f"No parameter is called {name}: none has a part that is empty.")
    if location.is_container:
        return ParameterTree(robot, location.segments)
    if not location.segments:
        raise permanent_redirect(robot.space.container("parameters"))
    return ParameterResource(robot, name)


def _resources(robot: Robot, location: Location) -> Resource:
    if location.is_container:
        return ComplexTimeGate(robot, path_of(location.segments))
    if not location.segments:
        raise permanent_redirect(robot.space.container("resources"))
    if not location.segments[-1]:
        raise Problem(404, f"No resource is called {location.name}: its own name would be empty.")
    return MemberTimeGate(robot, location.name)


def _well_known(robot: Robot, location: Location) -> Resource:
    if location.segments != ("wot",) or location.is_container:
        raise Problem(404, f"It is not among what is well known here: {robot.space.base}.well-known/ lists that.")
    return RobotThing(robot)


def _flat(what: str, container: Callable[[Robot], Resource], leaf: Callable[[Robot, str], Resource]) -> Route:
    """A room of things without namespaces, all directly in it; `what` one of them is called, with its article."""

    def room(robot: Robot, location: Location) -> Resource:
        if location.is_container and not location.segments:
            return container(robot)
        if not location.segments:
            raise permanent_redirect(robot.space.container(location.kind))
        if len(location.segments) > 1 or location.is_container:
            raise Problem(404, f"{what} lies directly under /{location.kind}/.")
        return leaf(robot, location.segments[0])

    return room


def _holds(find: Callable[[str], Resource] | None) -> Route:
    return _flat("A hold", listings.holds_listing, lambda robot, id: HoldResource(robot, id, find))


def _single(make: Callable[[Robot], Resource]) -> Route:
    def room(robot: Robot, location: Location) -> Resource:
        if location.segments or (location.is_container and location.kind):
            raise Problem(404, f"There is nothing below /{location.kind}.")
        return make(robot)

    return room


ROUTES: Mapping[str, Route] = {
    "": _single(EntryResource),
    "nodes": _named("nodes", NodeResource),
    "topics": _named("topics", TopicResource),
    "services": _named("services", ServiceResource),
    "calls": _flat("A call", listings.calls_listing, CallResource),
    "actions": _named("actions", ActionResource),
    "goals": _flat("A goal", listings.goals_listing, GoalResource),
    "activity": _flat("A receipt", ActivityContainer, ActivityResource),
    "holds": _holds(None),
    "parameters": _parameters,
    "types": type_route,
    "shapes": shape_route,
    "bags": bag_route,
    "resources": _resources,
    "data": stored_route,
    "mappings": stored_route,
    ".well-known": _well_known,
    "stop": _single(StopResource),
    "graph": _single(GraphResource),
    "diagnostics": _single(DiagnosticsResource),
    "llms.txt": _single(GuideResource),
    "ontology": ontology_room,
} | {name: _single(make) for name, make in FILES.items()}


def _holding(at: Callable[[str], Resource]) -> Mapping[str, Route]:
    """The rooms where a request may name the URL of a message."""
    return {
        "topics": _named("topics", lambda robot, name: TopicResource(robot, name, at)),
        "holds": _holds(at),
        "bags": lambda robot, location: bag_route(robot, location, at),
    }


def _examples(robot: Robot) -> list[StoredQueryLink]:
    """Questions to start from: all that come with rosld, and some of those that clients keep."""
    found = robot.queries.all(limit=_EXAMPLES)
    return [StoredQueryLink(url, query.name, query.purpose, query.text) for url, query in found]


class Router:
    """Resolves paths; the resources of the last few thousand are kept, as they hold no state of their own."""

    def __init__(
        self,
        robot: Robot,
        service: QueryService,
        pages: PageRenderer,
        updates: Callable[[Callable[[str], Resource]], UpdateRunner] | None = None,
    ) -> None:
        """`updates` makes what carries updates out, given what finds resources by their paths (`at`)."""
        self._robot = robot
        described = OpenApiResource(robot, self.at)
        self.search = FindResource(robot, Finder(robot))
        changes = None if updates is None or robot.settings.read_only else updates(self.at)
        self.graphs = GraphStore(robot, service, self.resolve, changes)
        self.endpoint = SparqlResource(robot, service, pages, partial(_examples, robot), changes)
        runner = QueryRunner(service, pages, robot.space.base)
        self._rooms: dict[str, Route] = {
            **ROUTES,
            **_holding(self.at),
            "sparql": _single(lambda robot: self.endpoint),
            "queries": partial(query_route, runner=runner),
            "openapi.json": _single(lambda robot: described),
            "find": _single(lambda robot: self.search),
            "graphs": _single(lambda robot: self.graphs),
        }
        self._base = robot.space.path.rstrip("/")
        self._kept: dict[bytes, Resource] = {}

    def add(self, rooms: Mapping[str, Route]) -> None:
        """Add rooms, in place of those of the same names."""
        self._rooms.update(rooms)

    @property
    def route_names(self) -> frozenset[str]:
        """The first segments of all paths that lead anywhere; the entry's is empty."""
        return frozenset(self._rooms)

    def resolve(self, scope: Scope) -> Resource:
        """The resource at the path of a request; raises Problems: 400 malformed, 404 no such room, 308 moved.

        A resource is read at its own URL, so that it has one: who spells that in another way (`a:b` for `a%3Ab`) is
        told (308). What is written that way arrives all the same.
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
        """Whether a path is as the URL of the resource has it."""
        own = resource.url.partition("?")[0]
        return own[len(self._robot.space.base) - 1 :] == raw.decode("ascii").removeprefix(self._base)

    def _find(self, raw: bytes) -> Resource:
        try:
            return self.at(raw.decode("ascii").removeprefix(self._base))
        except UnicodeDecodeError as error:
            raise Problem(400, "The path is not ASCII: percent-encode it.") from error
        except ValueError as error:
            raise Problem(400, f"{error}.") from error

    def at(self, path: str) -> Resource:
        """The resource at a path below the base; raises Problems (404, 308), ValueError where it is malformed."""
        location = _located(path) if len(path) <= _SHORT else locate(path)
        room = self._rooms.get(location.kind)
        if room is None:
            raise Problem(404, f"There is nothing at {path}; begin at {self._robot.space.base}")
        return room(self._robot, location)
